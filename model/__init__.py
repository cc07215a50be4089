"""What theory says: the planar two-mass dynamics of a tractor and a trailed seeder. Knows no files, logs or
plots.

`Machine` → `simulate(machine, controls, initial, t_out)` → `SimulatedRun`. Generalised coordinates
q = (x1, y1, yaw1, yaw2); SI units; world frame x East, y North; yaw counter-clockwise; body frame x forward,
y left. The second body is absent (None) for a tractor alone.

Modules, in the order of their imports: `machine` (parameters, static loads), `tyres` (lateral force laws),
`settings`, `inputs` (controls, driver, paths, disturbance), `dynamics` (M, h, Q in plain NumPy, to read and
to test against), `simulate` (runs and batches), `trailed` (the seeder behind an imposed tractor), `linear`
(eigenvalues, critical speed, frequency response); `fresh` (compiled code on disk). Modules with a leading
underscore are the compiled kernels behind them.
"""

from pathlib import Path

from .fresh import drop_stale

drop_stale(Path(__file__).parent)
