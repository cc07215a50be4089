"""Linear analysis about straight running at constant speed: modes, damping, critical speed, frequency
response."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from . import _layout as at
from ._linear import STATES, straight_jacobian
from ._packing import pack_controls, pack_machine, pack_options
from .inputs import Controls
from .machine import Machine, MachineError
from .settings import SimulationSettings

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
DEFAULT = SimulationSettings()
INPUT_NAMES = ("steer", "force1", "moment1", "force2", "moment2")
OUTPUT_NAMES = ("yaw_rate1", "yaw_rate2", "lateral_acceleration1", "lateral_acceleration2", "hitch_angle")
FASTEST = 60.0  # m/s, where the search for a critical speed ends


@dataclass(frozen=True)
class Mode:
    """One mode of free motion: eigenvalue 1/s; natural frequency |λ|/2π Hz; damping ratio −Re λ/|λ|."""

    eigenvalue: complex
    frequency: float
    damping: float

    @property
    def oscillates(self) -> bool:
        """Whether the mode is a damped or growing oscillation rather than a plain decay or growth."""
        return abs(self.eigenvalue.imag) > 1e-9 * max(abs(self.eigenvalue), 1e-9)


@dataclass(frozen=True)
class LinearModel:
    """ẋ = A·x + B·u, y = C·x + D·u about straight running at `speed` (m/s).

    x = (lateral velocity of O1 m/s, yaw_rate1, yaw_rate2 rad/s, hitch angle yaw1 − yaw2 rad, relaxed slip
    angles rad); u in INPUT_NAMES (rad, N, N·m); y in OUTPUT_NAMES (rad/s, m/s², rad). A tractor alone keeps
    only its own lateral velocity and yaw rate, inputs and outputs.
    """

    speed: float
    A: Floats
    B: Floats
    C: Floats
    D: Floats
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def modes(self) -> tuple[Mode, ...]:
        """Modes by falling real part; of each conjugate pair the one with positive frequency."""
        values = np.linalg.eigvals(self.A)
        kept = sorted((complex(v) for v in values if v.imag >= 0.0), key=lambda v: -v.real)
        return tuple(Mode(v, abs(v) / (2.0 * np.pi), -v.real / abs(v) if v != 0.0 else 0.0) for v in kept)

    def least_damping(self) -> float:
        """Smallest damping ratio of the modes; 1 when none oscillates, negative when one grows."""
        return min(mode.damping for mode in self.modes())

    def frequency_response(self, frequency: ArrayLike) -> Complexes:
        """G(f) = C·(i·2πf − A)⁻¹·B + D at frequencies in Hz, (n, outputs, inputs)."""
        omega = 2j * np.pi * np.atleast_1d(np.asarray(frequency, dtype=np.float64))
        resolvent = omega[:, None, None] * np.eye(len(self.A)) - self.A
        inner = np.linalg.solve(resolvent, np.broadcast_to(self.B, (len(omega), *self.B.shape)))
        return np.asarray(self.C @ inner + self.D, dtype=np.complex128)

    def steady_gain(self, output: str, source: str) -> float:
        """Ratio of an output to a constant input once all has settled."""
        gain = self.frequency_response(0.0)[0, self.outputs.index(output), self.inputs.index(source)]
        return float(gain.real)


def linearise(machine: Machine, speed: float, settings: SimulationSettings = DEFAULT) -> LinearModel:
    """The linear model at a speed, by central differences of the compiled right-hand side.

    Raises MachineError for a speed that is not above 0.
    """
    if not (speed > 0.0 and np.isfinite(speed)):
        raise MachineError(f"speed is {speed!r}; it must be a finite number above 0")
    return _model(machine, float(speed), *_straight(machine, settings)(float(speed)))


def _straight(machine: Machine, settings: SimulationSettings) -> Callable[[float], tuple[Floats, Floats]]:
    """Packed parameters and the Jacobian about straight running, as a function of speed."""
    p, options = pack_machine(machine, settings), pack_options(settings)
    empty = pack_controls(Controls(t=np.array([0.0, 1.0]), speed=np.zeros(2)), 1.0)
    return lambda speed: (p, straight_jacobian(speed, p, empty, options))


def _state_rows(machine: Machine, p: Floats) -> list[int]:
    """Rows of the Jacobian that are states of this machine: its bodies' and its relaxed wheels'."""
    wheels = np.arange(at.TRACTOR_WHEELS + int(p[at.SEEDER_WHEELS]))
    relaxed = wheels[p[at.WHEELS + wheels * at.WHEEL_SIZE + at.RELAXATION] > 0.0]
    return ([0, 1] if machine.seeder is None else [0, 1, 2, 3]) + [STATES + int(i) for i in relaxed]


def _model(machine: Machine, speed: float, p: Floats, jacobian: Floats) -> LinearModel:
    rows, alone, first = _state_rows(machine, p), machine.seeder is None, STATES + at.MAX_WHEELS
    core = ("lateral_velocity1", "yaw_rate1", "yaw_rate2", "hitch_angle")
    columns = [first + i for i in ((0, 1, 2) if alone else range(5))]
    unit = np.eye(jacobian.shape[1])
    full = np.stack([unit[1], unit[2], jacobian[-2], jacobian[-1], unit[3]])
    outputs = [0, 2] if alone else [0, 1, 2, 3, 4]
    return LinearModel(
        speed=speed,
        A=jacobian[np.ix_(rows, rows)],
        B=jacobian[np.ix_(rows, columns)],
        C=full[np.ix_(outputs, rows)],
        D=full[np.ix_(outputs, columns)],
        states=tuple(core[i] if i < STATES else f"slip{i - STATES}" for i in rows),
        inputs=INPUT_NAMES[: len(columns)],
        outputs=tuple(OUTPUT_NAMES[i] for i in outputs),
    )


def _growths(machine: Machine, settings: SimulationSettings) -> Callable[[float], float]:
    """Largest real part of the eigenvalues, 1/s, as a function of speed."""
    straight = _straight(machine, settings)

    def growth_at(speed: float) -> float:
        p, jacobian = straight(speed)
        rows = _state_rows(machine, p)
        return float(np.linalg.eigvals(jacobian[np.ix_(rows, rows)]).real.max())

    return growth_at


def growth(machine: Machine, speed: float, settings: SimulationSettings = DEFAULT) -> float:
    """Largest real part of the eigenvalues, 1/s: positive where straight running is unstable."""
    return _growths(machine, settings)(speed)


def critical_speed(
    machine: Machine, settings: SimulationSettings = DEFAULT, slowest: float = 0.5
) -> float | None:
    """Lowest speed, m/s, above which straight running is unstable (fixed steering); None up to 60 m/s.

    Found by a scan in steps of a fifth from `slowest` and Brent's method; `slowest` itself if unstable there.
    """
    growth_at = _growths(machine, settings)
    low = slowest
    if growth_at(low) > 0.0:
        return low
    while low < FASTEST:
        high = 1.2 * low
        if growth_at(high) > 0.0:
            return float(brentq(growth_at, low, high, xtol=1e-6))
        low = high
    return None


def require_stable(machine: Machine, speed: float, settings: SimulationSettings = DEFAULT) -> None:
    """Refuse a speed at or above the critical one. Raises MachineError naming the speed and the bound."""
    if growth(machine, speed, settings) <= 0.0:
        return
    bound = critical_speed(machine, settings)
    raise MachineError(
        f"speed is {speed:g} m/s, at which straight running is unstable; "
        f"it must be below the critical speed of {speed if bound is None else bound:.2f} m/s"
    )
