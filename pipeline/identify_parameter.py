"""A free parameter: its bounds, its prior, and the scale on which it is searched."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ..model.machine import Machine, MachineError

WIDEST = 10.0  # default bounds: a tenth of the stated value to ten times it
STIFFNESS = "cornering_stiffness"  # acts by its inverse


class IdentifyError(ValueError):
    """An identification that cannot be made: one line with what, where and how to mend it."""


class WrongUseError(IdentifyError):
    """What was asked for cannot be asked: an option to write differently."""


@dataclass(frozen=True)
class Parameter:
    """A free parameter by its dotted name: stated value, scale of its changes, bounds, standard deviation of
    its prior (None: none) and its mean (None: the stated value), all in the parameter's own unit.

    It is searched by a relative change z, 0 at the stated value, on the scale on which the motion answers it most
    nearly in proportion, so that an interval straight in z holds what it says: a cornering stiffness by its inverse,
    z = 1 − stated/value (slip = force/stiffness); others that can only be positive by z = ln(value/stated); the rest
    by z = (value − stated)/scale.
    """

    name: str
    stated: float
    scale: float
    low: float
    high: float
    prior_sd: float | None
    prior_mean: float | None = None

    @property
    def positive(self) -> bool:
        """Whether it can only be positive."""
        return self.stated > 0.0 and self.low > 0.0

    @property
    def reciprocal(self) -> bool:
        """Whether the relative change is that of the inverse."""
        return self.positive and self.name.rsplit(".", 1)[-1] == STIFFNESS

    def value(self, z: float) -> float:
        """The parameter's value at a relative change z (of an inverse: under 1)."""
        if self.reciprocal:
            return self.stated / (1.0 - z)
        return self.stated * math.exp(z) if self.positive else self.stated + z * self.scale

    def change(self, value: float) -> float:
        """The relative change z that leads to a value."""
        if self.reciprocal:
            return 1.0 - self.stated / value
        return math.log(value / self.stated) if self.positive else (value - self.stated) / self.scale

    def spread(self, z: float, sd: float) -> float:
        """Standard deviation of the value for that of z, to first order."""
        if self.reciprocal:
            return sd * self.value(z) ** 2 / self.stated
        return sd * (self.value(z) if self.positive else self.scale)

    def end(self, z: float) -> float | None:
        """The value at an interval's end z; None where the parameter's bound comes first."""
        return self.value(z) if self.change(self.low) < z < self.change(self.high) else None

    @property
    def centre(self) -> float:
        """The prior's mean as a relative change."""
        return 0.0 if self.prior_mean is None else self.change(self.prior_mean)

    @property
    def information(self) -> float:
        """The prior's information on the relative change, 1/sd²; 0 without one."""
        return 0.0 if self.prior_sd is None else (self.spread(self.centre, 1.0) / self.prior_sd) ** 2


def parameter_of(
    name: str,
    machines: Sequence[Machine],
    bounds: tuple[float, float] | None = None,
    prior_sd: float | None = None,
    prior_mean: float | None = None,
) -> Parameter:
    """A free parameter as the passes' machines state it.

    Raises IdentifyError for an unknown one, one that the passes state differently, or one without a scale.
    """
    try:
        stated = [machine.parameter(name) for machine in machines]
    except MachineError as error:
        raise WrongUseError(f"--free: {error}") from None
    except (TypeError, ValueError):
        raise WrongUseError(f"--free {name}: is not a number here; free a numeric key of [machine]") from None
    value = stated[0]
    if max(stated) - min(stated) > 1e-9 * max(abs(value), 1e-9):
        raise IdentifyError(
            f"--free {name}: the passes state {min(stated):g} and {max(stated):g}; identify one version at a time"
        )
    low, high = _bounds(name, value, bounds)
    _require_prior(name, low, high, prior_sd, prior_mean)
    scale = abs(value) if value != 0.0 else high - low
    return Parameter(name, value, scale, low, high, prior_sd or None, prior_mean)


def _bounds(name: str, value: float, bounds: tuple[float, float] | None) -> tuple[float, float]:
    if bounds is None:
        if value == 0.0:
            raise WrongUseError(f"--free {name}: is stated as 0; give its bounds as {name}=LOW:HIGH")
        bounds = (min(value / WIDEST, value * WIDEST), max(value / WIDEST, value * WIDEST))
    if not bounds[0] < bounds[1]:
        raise WrongUseError(f"--free {name}: {bounds[0]:g} is not below {bounds[1]:g}; write LOW:HIGH")
    return bounds


def _require_prior(name: str, low: float, high: float, sd: float | None, mean: float | None) -> None:
    if sd is not None and not sd > 0.0:
        raise WrongUseError(f"--prior {name}: its standard deviation is {sd:g}; it must be above 0")
    if mean is not None and not low <= mean <= high:
        raise WrongUseError(
            f"--prior {name}: its mean {mean:g} is outside the bounds {low:g} to {high:g}; give --bound too"
        )
