"""Weighted least squares over aligned residuals: estimate, standard errors, identifiability.

Standard errors are those of the sandwich A⁻¹BA⁻¹: A = JᵀWJ + P⁻¹ with the priors P, and B the scatter of the windows'
scores JᵀWe, so that autocorrelation inside a window and between the responses is paid for. What all windows
share (the scale of the steering sensor) cannot show in their scatter and is added by its stated standard deviation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import stdtrit

from ..model.inputs import coloured_noise
from .identify_parameter import IdentifyError, Parameter
from .identify_problem import (
    Layout,
    Stretch,
    aligned,
    bounds_of,
    in_parallel,
    inside,
    jacobian_of,
    layout_of,
    residual_of,
    values_at,
    weights_by_response,
)
from .replay import drive_of
from .uncertainty import SCALE_STEP
from .window_fit import coarse

Floats = NDArray[np.float64]

BLIND = 1e-12  # information under which a parameter does nothing at all
ROUNDS = 2  # weights from the residual of the round before
LEVEL = 0.95  # of the intervals
INSENSITIVE = 1.0  # relative standard deviation, all others known: the passes say nothing of the parameter
COLLINEAR = 0.98  # |correlation| over which two parameters cannot be told apart
UNCERTAIN = 1.0  # relative standard deviation with all others free: lost among several others
PAIRS = 4  # antithetic pairs of draws of the steering's error
NOISE_STEP = 0.02  # of a parameter's scale, forward difference under a draw


@dataclass(frozen=True)
class Held:
    """A parameter that was held at its stated value, and why; partner: the one it cannot be told from."""

    name: str
    reason: str
    partner: str = ""


@dataclass(frozen=True)
class Fit:
    """An estimate over training passes, on relative changes z (P,) of the parameters that stayed free.

    z : with the pull of the steering's noise taken off, `pull`; optimum : where the sum of squares is least
    covariance : (P, P) corrected for autocorrelation; bread : (P, P) A⁻¹, as if the samples' weights said all
    weights : (N,) of the residuals; dof : windows less parameters
    """

    parameters: tuple[Parameter, ...]
    held: tuple[Held, ...]
    stretches: tuple[Stretch, ...]
    layout: Layout
    z: Floats
    optimum: Floats
    pull: Floats
    covariance: Floats
    bread: Floats
    weights: Floats
    dof: int

    @property
    def values(self) -> dict[str, float]:
        """Estimates by name."""
        return values_at(self.parameters, self.z)

    @property
    def sd(self) -> Floats:
        """(P,) standard errors of the relative changes."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def spreads(self) -> dict[str, float]:
        """Standard errors by name, in the parameters' own units."""
        return {
            p.name: p.spread(float(z), float(sd))
            for p, z, sd in zip(self.parameters, self.z, self.sd, strict=True)
        }

    @property
    def correlation(self) -> Floats:
        """(P, P) correlation matrix of the estimates."""
        return np.asarray(self.covariance / np.outer(self.sd, self.sd))

    @property
    def quantile(self) -> float:
        """Student's t of the two-sided interval."""
        return float(stdtrit(self.dof, 0.5 + 0.5 * LEVEL))

    def interval(self, index: int) -> tuple[float | None, float | None]:
        """Ends of one parameter's interval by its standard error, in its own unit; None beyond its bound."""
        parameter, reach = self.parameters[index], self.quantile * float(self.sd[index])
        return parameter.end(float(self.z[index]) - reach), parameter.end(float(self.z[index]) + reach)


def fit(stretches: Sequence[Stretch], parameters: Sequence[Parameter], seed: int = 1) -> Fit:
    """Estimate the parameters that the passes can tell, holding the others at their stated values.

    Raises IdentifyError when there is nothing to fit, or nothing of it is identifiable.
    """
    if not stretches:
        raise IdentifyError("no row of the training passes could be compared; see `run` of each pass for why")
    layout = layout_of(stretches)
    free, held = list(parameters), list[Held]()
    _hold_blind(stretches, layout, free, held)
    while free:
        optimum, weights = _solve(stretches, layout, free)
        slopes = jacobian_of(stretches, free, optimum)
        found = worst(_information(slopes, weights), prior_information(free), free)
        if found is None:
            one = _finished(stretches, layout, free, held, optimum, weights, slopes, seed)
            if (found := lost(one)) is None:
                return one
        held.append(found)
        free = [p for p in free if p.name != found.name]
    raise IdentifyError(
        "none of the free parameters can be identified from these passes: "
        + "; ".join(f"{h.name} {h.reason}" for h in held)
    )


def _hold_blind(
    stretches: Sequence[Stretch], layout: Layout, free: list[Parameter], held: list[Held]
) -> None:
    """Hold, before any search, what does not move the residual at all or moves it just as another does."""
    start = inside(free, np.zeros(len(free)))
    weights = weights_by_response(residual_of(stretches, values_at(free, start)), layout)
    slopes = jacobian_of(stretches, free, start)
    size = np.einsum("np,n,np->p", slopes, weights, slopes)
    held += [Held(p.name, "does not act on the motion compared") for p in _those(free, size <= BLIND)]
    slopes, free[:] = slopes[:, size > BLIND], _those(free, size > BLIND)
    while (found := collinear(_information(slopes, weights), prior_information(free), free)) is not None:
        held.append(found)
        kept = np.array([p.name != found.name for p in free])
        slopes, free[:] = slopes[:, kept], _those(free, kept)


def _those(free: Sequence[Parameter], wanted: NDArray[np.bool_]) -> list[Parameter]:
    return [p for p, keep in zip(free, wanted, strict=True) if keep]


def _solve(stretches: Sequence[Stretch], layout: Layout, free: Sequence[Parameter]) -> tuple[Floats, Floats]:
    """(P,) the least weighted sum of squares, and the weights (N,) at it."""
    z = inside(free, np.zeros(len(free)))
    weights = weights_by_response(residual_of(stretches, values_at(free, z)), layout)
    for _ in range(ROUNDS):
        z = minimise(stretches, free, weights, z)
        weights = weights_by_response(residual_of(stretches, values_at(free, z)), layout)
    return minimise(stretches, free, weights, z), weights


def minimise(
    stretches: Sequence[Stretch], free: Sequence[Parameter], weights: Floats, start: Floats
) -> Floats:
    """(P,) z that minimises Σ w·e² + Σ ((z − prior mean)/prior sd)², within the bounds."""
    return searched(stretches, free, weights, start, {})[0]


def searched(
    stretches: Sequence[Stretch],
    free: Sequence[Parameter],
    weights: Floats,
    start: Floats,
    fixed: Mapping[str, float],
) -> tuple[Floats, float]:
    """What `minimise` finds with further parameters fixed at their values, and the least sum."""
    root, prior = np.sqrt(weights), np.sqrt(np.diag(prior_information(free)))
    centre = prior_centre(free)

    def residual(z: Floats) -> Floats:
        return np.concatenate(
            (root * residual_of(stretches, {**fixed, **values_at(free, z)}), prior * (z - centre))
        )

    def slopes(z: Floats) -> Floats:
        return np.vstack((root[:, None] * jacobian_of(stretches, free, z, fixed), np.diag(prior)))

    found = least_squares(
        residual, inside(free, start), jac=slopes, bounds=bounds_of(free), xtol=1e-4, ftol=1e-6, max_nfev=30
    )
    return np.asarray(found.x), 2.0 * float(found.cost)


def _information(slopes: Floats, weights: Floats) -> Floats:
    return np.asarray((slopes.T * weights) @ slopes)


def prior_information(free: Sequence[Parameter]) -> Floats:
    """(P, P) of the priors on relative changes; zero for a parameter without one."""
    return np.diag([p.information for p in free])


def prior_centre(free: Sequence[Parameter]) -> Floats:
    """(P,) the priors' means as relative changes; zero for a parameter without one."""
    return np.array([p.centre for p in free])


def worst(information: Floats, prior: Floats, free: Sequence[Parameter]) -> Held | None:
    """The parameter that is least identifiable, and why; None when all can be told.

    information : (P, P) of the passes on relative changes; prior : (P, P) that the priors add
    """
    alone = _alone(information + prior)
    if float(alone.max()) > INSENSITIVE:
        i = int(np.argmax(alone))
        return Held(
            free[i].name, f"hardly acts: its standard error is {_percent(alone[i])} with all else known"
        )
    if (found := collinear(information, prior, free)) is not None:
        return found
    sd, correlation = _joint(information + prior)
    i = int(np.argmax(sd))
    if not float(sd[i]) > UNCERTAIN:
        return None
    words = f"is lost among the others: standard error {_percent(sd[i])}, {_percent(alone[i])} with all else known"
    return Held(free[i].name, words, free[int(np.argmax(correlation[i]))].name if len(free) > 1 else "")


def lost(found: Fit) -> Held | None:
    """The parameter whose standard error, once autocorrelation is paid for, says nothing of it; None: all are told."""
    i = int(np.argmax(found.sd))
    if not float(found.sd[i]) > UNCERTAIN:
        return None
    others = np.abs(found.correlation[i])
    others[i] = -1.0
    partner = found.parameters[int(np.argmax(others))].name if len(found.parameters) > 1 else ""
    words = f"is lost in the scatter of the windows: standard error {_percent(found.sd[i])}"
    return Held(found.parameters[i].name, words, partner)


def collinear(information: Floats, prior: Floats, free: Sequence[Parameter]) -> Held | None:
    """The weaker of the two parameters that are the most alike, None when all can be told apart."""
    if len(free) < 2:
        return None
    _, correlation = _joint(information + prior)
    if not float(correlation.max()) > COLLINEAR:
        return None
    alone = _alone(information)
    pair = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    i, j = sorted((int(pair[0]), int(pair[1])), key=lambda k: float(alone[k]), reverse=True)
    words = f"cannot be told from {free[j].name} (correlation {correlation[i, j]:.3f})"
    return Held(free[i].name, words, free[j].name)


def _alone(information: Floats) -> Floats:
    """(P,) relative standard deviations with all else known."""
    return np.asarray(1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300)))


def _joint(total: Floats) -> tuple[Floats, Floats]:
    """(P,) relative standard deviations with all others free, (P, P) magnitudes of their correlations."""
    size = np.sqrt(np.diag(total))
    # A pair alike to the last digit has no inverse; a ridge of 1e-9 leaves its correlation at 1 to six digits.
    scaled = total / np.outer(size, size) + 1e-9 * np.eye(size.size)
    covariance = np.linalg.inv(scaled) / np.outer(size, size)
    sd = np.sqrt(np.diag(covariance))
    return sd, np.abs(covariance / np.outer(sd, sd)) - np.eye(size.size)


def _percent(share: float) -> str:
    return f"over {100.0 * 99.9:.0f} %" if share > 99.9 else f"{100.0 * share:.3g} %"


def _finished(
    stretches: Sequence[Stretch],
    layout: Layout,
    free: Sequence[Parameter],
    held: Sequence[Held],
    optimum: Floats,
    weights: Floats,
    slopes: Floats,
    seed: int,
) -> Fit:
    """The fit with its covariance, and with the pull of the steering's noise taken off."""
    total = _information(slopes, weights) + prior_information(free)
    bread = np.asarray(np.linalg.inv(total), dtype=np.float64)
    residual = residual_of(stretches, values_at(free, optimum))
    dof = max(layout.clusters - len(free), 1)
    meat = scores_scatter(slopes, weights * residual, layout) * layout.clusters / dof
    common = slopes.T @ (weights * scale_change(stretches, values_at(free, optimum)))
    meat = meat + np.outer(common, common) + prior_information(free)
    pull = steering_pull(stretches, free, optimum, weights, bread, seed)
    low, high = bounds_of(free)
    return Fit(
        tuple(free), tuple(held), tuple(stretches), layout, np.clip(optimum - pull, low, high), optimum, pull,
        bread @ meat @ bread, bread, weights, dof,
    )  # fmt: skip


def scores_scatter(slopes: Floats, weighted: Floats, layout: Layout) -> Floats:
    """(P, P) Σ over windows g·gᵀ of their scores g = Σ J·w·e (Liang and Zeger's cluster-robust middle)."""
    scores = np.zeros((layout.clusters, slopes.shape[1]))
    np.add.at(scores, layout.cluster, slopes * weighted[:, None])
    return np.asarray(scores.T @ scores)


def scale_change(stretches: Sequence[Stretch], values: dict[str, float]) -> Floats:
    """(N,) change of the residual by one standard deviation of the steering's scale, which all passes share."""
    found = []
    for stretch in stretches:
        steer = stretch.context.motion.steer_input
        nominal = aligned(stretch, values)
        if steer is None:
            found.append(np.zeros(nominal.size))
            continue
        more = aligned(stretch, values, steer_scale=1.0 + SCALE_STEP)
        found.append((more - nominal) * steer.scale_sd / SCALE_STEP)
    return np.concatenate(found)


def steering_pull(
    stretches: Sequence[Stretch],
    free: Sequence[Parameter],
    z: Floats,
    weights: Floats,
    bread: Floats,
    seed: int,
) -> Floats:
    """(P,) by how much the noise of the measured steering has pulled the estimate.

    Noise in a regressor attenuates its effect: the measured steering swings more than the true one. As in
    simulation-extrapolation (Cook and Stefanski 1994) as much noise again is added to it, and the step that
    the estimate would take, −A⁻¹·JᵀWe less that without the noise, is to first order the pull that is already there.
    Draws come in pairs of opposite sign, so that only what is even in the noise remains.
    """
    if any(s.context.motion.steer_input is None for s in stretches):
        return np.zeros(z.size)
    generator = np.random.default_rng(seed)
    tasks = []
    for stretch in stretches:
        noises = [steering_noise(stretch, generator) for _ in range(PAIRS)]
        draws = [None, *(sign * noise for noise in noises for sign in (1.0, -1.0))]
        tasks += [partial(_under, stretch, free, z, noise) for noise in draws]
    found = iter(in_parallel(tasks))
    total, first = np.zeros(z.size), 0
    for _ in stretches:
        base, base_slopes = next(found)
        weight = weights[first : first + base.size]
        first += base.size
        total -= base_slopes.T @ (weight * base)
        for _ in range(2 * PAIRS):
            residual, slopes = next(found)
            total += slopes.T @ (weight * residual) / (2.0 * PAIRS)
    return np.asarray(-bread @ total)


def steering_noise(stretch: Stretch, generator: np.random.Generator) -> Floats:
    """A draw (N,) of the steering series' stated error, rad, on the motion's grid."""
    motion = stretch.context.motion
    steer = motion.steer_input
    if steer is None:
        raise ValueError("this motion has no independent steering series")
    step, size = float(np.median(np.diff(motion.t))), motion.t.size
    if steer.correlation_time > 0.0:
        unit = coloured_noise(generator, size, step, 1.0, steer.correlation_time)
    else:
        unit = generator.standard_normal(size)
    return np.asarray(unit * steer.sd + steer.zero_sd * generator.standard_normal())


def _under(
    stretch: Stretch, free: Sequence[Parameter], z: Floats, noise: Floats | None
) -> tuple[Floats, Floats]:
    """Residual and slopes (forward differences) of a stretch with noise added to its steering."""
    drive = stretch.drive
    motion, steer = stretch.context.motion, stretch.context.motion.steer_input
    if noise is not None and steer is not None:
        row, settings = stretch.context.grid.row, stretch.context.settings
        drive = coarse(drive_of(motion, row, settings, steer.angle + noise))
    base = aligned(stretch, values_at(free, z), drive)
    columns = []
    for i in range(z.size):
        moved = z.copy()
        moved[i] += NOISE_STEP
        columns.append((aligned(stretch, values_at(free, moved), drive) - base) / NOISE_STEP)
    return base, np.column_stack(columns)
