"""Two-body filter and smoother: `fuse.fuse(log) -> motion.Motion`.

`prepare` and `known` bring the streams to one grid, `problem` states the estimation problem, `kernels` and
`filtering` are its compiled functions, two engines solve it, `tune` finds noise levels, `assemble` makes the result.
"""
