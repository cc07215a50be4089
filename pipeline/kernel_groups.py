"""The kernels of a pass with the types they are called with, in groups that several processes can compile at once."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any

from .garbage import seldom_collected

Kernels = list[tuple[Any, tuple[Any, ...]]]  # compiled functions, and the types of their arguments

# numba colours every message of its search for a function that fits, most of which nobody sees.
QUIET = "NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING"


def compile_group(name: str) -> None:
    """Compile one group of GROUPS into numba's cache on disk, or load it from there."""
    os.environ.setdefault(QUIET, "1")  # read when numba is imported
    with seldom_collected():
        for kernel, types in GROUPS[name]():
            kernel.compile(types)


def forward_filter() -> Kernels:
    """The fusion's forward pass."""
    from .fusion.filtering import forward

    t = _Types()
    given = (t.f1, t.f2, t.f2, t.f2, t.f, t.i1, t.i1, t.f1, t.f1, t.f1, t.f2, t.f1, t.f2, t.b)
    return [(forward, (*given, t.f2, t.f2, t.f2, t.f2, t.f1, t.f1, t.b1, t.b))]


def smoother() -> Kernels:
    """The fusion's backward pass."""
    from .fusion.filtering import backward

    t = _Types()
    return [
        (backward, (t.f2, t.f, t.i1, t.f1, t.f2, t.f2, t.f2, t.f2, t.f2, t.f1, t.f1, t.b1, t.f2, t.f3)),
    ]


def draws_forward() -> Kernels:
    """Posterior draws, forward."""
    import numpy as np

    from .fusion.draws_kernels import simulate

    t = _Types()
    rng = t.of(np.random.default_rng())
    given = (t.f2, t.f2, t.f, t.i1, t.f1, t.f2, t.f1, t.f2, t.f2, t.f2, t.b1)
    return [(simulate, (*given, rng, t.i, t.f3, t.f2))]


def draws_backward() -> Kernels:
    """Posterior draws, backward."""
    from .fusion.draws_kernels import smooth

    t = _Types()
    return [(smooth, (t.f2, t.f, t.i1, t.f1, t.f2, t.f2, t.f2, t.f2, t.f1, t.b1, t.i, t.f3, t.f2))]


def model_runs() -> Kernels:
    """Runs of the model."""
    from ..model._integrators import run_batch

    t = _Types()
    tables, options = _model_types(t)
    given = (t.f2, t.f2, t.f2, t.f2, tables, options)
    return [(run_batch, (*given, t.f, t.i, t.f2, t.f3, t.f1))]


def lesser() -> Kernels:
    """All that is small."""
    from ..model._linear import straight_jacobian
    from .fusion.filtering import unpack
    from .metrics._warping import trace_back, warp_costs
    from .wheel_series import _backward, _doubt, _forward

    t = _Types()
    tables, options = _model_types(t)
    return [
        (_forward, (t.f2, t.f1, t.f1, t.f, t.i)),
        (_backward, (t.f2, t.f1, t.f1)),
        (_doubt, (t.f2, t.f2)),
        (warp_costs, (t.f1, t.f1, t.i, t.steps)),
        (trace_back, (t.steps, t.i2)),
        (unpack, (t.f1, t.f2, t.i)),
        (straight_jacobian, (t.f, t.f1, tables, options)),
    ]


# By the last kernel of each, as `package/module.function`. Longest first.
GROUPS: Mapping[str, Callable[[], Kernels]] = {
    "model/_integrators.run_batch": model_runs,
    "pipeline/fusion/filtering.forward": forward_filter,
    "model/_linear.straight_jacobian": lesser,
    "pipeline/fusion/filtering.backward": smoother,
    "pipeline/fusion/draws_kernels.simulate": draws_forward,
    "pipeline/fusion/draws_kernels.smooth": draws_backward,
}


class _Types:
    """Types by short names: f, i, b numbers; f1, f2, ... arrays of so many axes, as they lie in memory."""

    def __init__(self) -> None:
        import numba

        numbers: Any = numba  # typed in part
        self.of = numbers.typeof
        self.f, self.i, self.b = numbers.float64, numbers.int64, numbers.boolean
        self.f1, self.f2, self.f3 = self.f[::1], self.f[:, ::1], self.f[:, :, ::1]
        self.i1, self.i2, self.b1 = self.i[::1], self.i[:, ::1], self.b[::1]
        self.steps = numbers.int8[:, ::1]


def _model_types(t: _Types) -> tuple[Any, Any]:
    """Types of the model's tables and options."""
    import numpy as np

    from ..model._layout import Options, Tables

    one, two, three = np.empty(0), np.empty((0, 0)), np.empty((0, 0, 0))
    tables = Tables(0.0, two, one, one, three, 0.0, three, 0.0, two)
    return t.of(tables), t.of(Options(0, 0, 0, 0, 0, 0.0, 0.0, 0.0))
