"""Effects of design parameters on straightness: blocks, aliasing, least squares, and a random field effect.

The unit is the pass, the response an index's logarithm, so an effect is a factor. Fields and directions
are blocks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.stats import f as fisher
from scipy.stats import t as student

Floats = NDArray[np.float64]

ALIASED = 1e-8  # share of a factor's variance left over when the others explain it
LEAST_FIELDS = 5  # for a random field effect


class EffectsError(ValueError):
    """A table from which no effect can be computed: one line, what is missing."""


@dataclass(frozen=True)
class Effect:
    """One factor's effect on a log index, for a change by `step` in the factor's unit.

    ratio : e^β, by which the index changes; low, high : its interval; p : two-sided
    """

    factor: str
    step: float
    ratio: float
    low: float
    high: float
    p: float


@dataclass(frozen=True)
class JointTest:
    """Fisher's F of adding columns to a design, with its degrees of freedom and probability."""

    f: float
    dof_between: int
    dof_within: int
    p: float


@dataclass(frozen=True)
class Effects:
    """Effects of one index.

    aliased : groups of factors that changed together, whose effects cannot be told apart (each group
    enters once,
    by its first member); constant : factors that never changed
    model : "blocks" (fixed field and direction) or "random field"
    joint : whether the factors matter at all, all together (with fixed blocks; aliased ones are in it too)
    """

    index: str
    effects: tuple[Effect, ...]
    aliased: tuple[tuple[str, ...], ...]
    constant: tuple[str, ...]
    model: str
    passes: int
    dof: int
    residual_sd: float
    note: str = ""
    joint: JointTest | None = None


@dataclass(frozen=True)
class Fit:
    """Least squares: β (p,), its covariance (p, p), residual variance and degrees of freedom.

    group_variance : of a random intercept, 0 without one
    """

    beta: Floats
    covariance: Floats
    variance: float
    dof: int
    group_variance: float = 0.0


def least_squares(x: Floats, y: Floats) -> Fit:
    """Ordinary least squares by QR; y is centred first, which keeps digits when its mean dwarfs its spread.

    Raises EffectsError without a degree of freedom or with dependent columns.
    """
    count, columns = x.shape
    if np.linalg.matrix_rank(x) < columns:
        raise EffectsError("the design's columns depend on each other")
    if count <= columns:
        raise EffectsError(f"{count} passes cannot tell {columns} coefficients and a residual")
    q, r = np.linalg.qr(x)
    inverse = np.linalg.inv(r)
    constant = inverse @ (q.T @ np.ones(count))
    # Only where the columns hold a constant does taking off the mean leave the fit as it is.
    shift = float(y.mean()) if np.abs(x @ constant - 1.0).max() < 1e-9 else 0.0
    beta = inverse @ (q.T @ (y - shift))
    residual = (y - shift) - x @ beta
    variance = float(residual @ residual) / (count - columns)
    return Fit(beta + shift * constant, variance * inverse @ inverse.T, variance, count - columns)


def nested_f(small: Floats, large: Floats, y: Floats) -> JointTest:
    """F = [(RSS₀ − RSS₁)/(p₁ − p₀)] / [RSS₁/(N − p₁)] of a design within a larger one (analysis of
    variance)."""
    first, second = least_squares(small, y), least_squares(large, y)
    between, within = first.dof - second.dof, second.dof
    gained = first.variance * first.dof - second.variance * within
    f = gained / between / second.variance if second.variance > 0.0 else float("inf")
    return JointTest(f, between, within, float(fisher.sf(f, between, within)))


def block_columns(labels: Sequence[Sequence[str]]) -> Floats:
    """(N, b) a constant and indicators of every block's levels but the first; dependent columns are left
    out."""
    count = len(labels[0])
    columns = [np.ones(count)]
    for block in labels:
        for level in list(dict.fromkeys(block))[1:]:
            columns.append(np.array([float(value == level) for value in block]))
            if np.linalg.matrix_rank(np.column_stack(columns)) < len(columns):
                columns.pop()
    return np.column_stack(columns)


def left_over(column: Floats, others: Floats) -> float:
    """Share of a column's sum of squares that the others do not explain."""
    beta, *_ = np.linalg.lstsq(others, column, rcond=None)
    residual = column - others @ beta
    return float(residual @ residual) / max(float(column @ column), 1e-300)


def standardised(values: Floats) -> Floats:
    """(values − mean) / sd."""
    return np.asarray((values - values.mean()) / values.std())


def aliases(factors: Mapping[str, Floats], blocks: Floats) -> tuple[tuple[str, ...], ...]:
    """Groups of factors of which the design tells fewer effects than there are members.

    A factor that blocks alone explain forms a group with the word "blocks". Each further group is a
    factor and the
    kept ones that explain it together with the blocks: those with a coefficient.
    """
    kept: dict[str, Floats] = {}
    groups: list[tuple[str, ...]] = []
    for name, values in factors.items():
        column = standardised(values)
        base = np.column_stack([blocks, *kept.values()])
        if left_over(column, blocks) < ALIASED:
            groups.append(("blocks", name))
        elif left_over(column, base) < ALIASED:
            beta, *_ = np.linalg.lstsq(base, column, rcond=None)
            partners = [k for k, b in zip(kept, beta[blocks.shape[1] :], strict=True) if abs(b) > 1e-6]
            groups.append((*partners, name))
        else:
            kept[name] = column
    return tuple(groups)


def effects_of(
    index: str,
    values: Floats,
    factors: Mapping[str, Floats],
    fields: Sequence[str],
    directions: Sequence[str],
    steps: Mapping[str, float],
    alpha: float = 0.05,
) -> Effects:
    """Effects of the factors on an index's logarithm, by fixed blocks, or a random field with five or
    more fields.

    values : (N,) positive, one a pass; factors : (N,) each; steps : the change for which an effect is stated
    """
    constant = tuple(n for n, v in factors.items() if not float(np.ptp(v)) > 0.0)
    moving = {n: v for n, v in factors.items() if n not in constant}
    random = len(set(fields)) >= LEAST_FIELDS
    blocks = block_columns([directions] if random else [fields, directions])
    found = aliases(moving, blocks)
    dropped = {group[-1] for group in found}
    kept = {n: v for n, v in moving.items() if n not in dropped}
    model = "random field" if random else "blocks"
    if not kept:
        return Effects(
            index, (), found, constant, model, values.size, 0, float("nan"), "no factor to estimate"
        )
    design = np.column_stack([blocks, *[v / steps[n] for n, v in kept.items()]])
    try:
        fit = (
            random_intercept(design, np.log(values), fields)
            if random
            else least_squares(design, np.log(values))
        )
    except EffectsError as error:
        return Effects(index, (), found, constant, model, values.size, 0, float("nan"), str(error))
    effects = tuple(_effect(n, steps[n], fit, blocks.shape[1] + i, alpha) for i, n in enumerate(kept))
    joint = None if random else nested_f(blocks, design, np.log(values))
    spread = float(np.sqrt(fit.variance))
    return Effects(index, effects, found, constant, model, values.size, fit.dof, spread, "", joint)


def _effect(name: str, step: float, fit: Fit, column: int, alpha: float) -> Effect:
    beta, sd = float(fit.beta[column]), float(np.sqrt(fit.covariance[column, column]))
    width = float(student.ppf(1.0 - alpha / 2.0, fit.dof)) * sd
    p = 2.0 * float(student.sf(abs(beta) / sd, fit.dof)) if sd > 0.0 else 0.0
    return Effect(
        name, step, float(np.exp(beta)), float(np.exp(beta - width)), float(np.exp(beta + width)), p
    )


def random_intercept(x: Floats, y: Floats, groups: Sequence[str]) -> Fit:
    """y = X·β + u_group + ε by restricted maximum likelihood, profiled over the ratio θ = σ_u²/σ².

    For a ratio, group g of size n_g is whitened by taking off (1 − 1/√(1 + n_g·θ)) of its mean, then β
    is ordinary
    least squares; −2·REML = (N − p)·ln σ² + ln|XᵀV⁻¹X| + Σ ln(1 + n_g·θ) + const (Pinheiro and Bates
    2000, ch. 2).
    """
    labels = list(dict.fromkeys(groups))
    if len(labels) < 2:
        raise EffectsError("a random field effect needs two or more fields")
    members = [np.flatnonzero(np.array([g == label for g in groups])) for label in labels]
    shift = float(y.mean())

    def fitted(log_ratio: float) -> tuple[float, Fit]:
        ratio = float(np.exp(log_ratio))
        white_x, white_y = whitened(x, members, ratio), whitened(y - shift, members, ratio)
        fit = least_squares(white_x, white_y)
        _, log_det = np.linalg.slogdet(white_x.T @ white_x)
        spread = sum(np.log1p(m.size * ratio) for m in members)
        return fit.dof * np.log(fit.variance) + float(log_det) + float(spread), fit

    best = minimize_scalar(lambda value: fitted(value)[0], bounds=(-16.0, 10.0), method="bounded")
    fit = fitted(float(best.x))[1]
    unit, *_ = np.linalg.lstsq(x, np.ones(y.size), rcond=None)
    # Fields are the independent units: their number less one is a cautious count of degrees of freedom.
    dof = max(min(fit.dof, len(labels) - 1), 1)
    group_variance = float(np.exp(best.x)) * fit.variance
    return Fit(fit.beta + shift * unit, fit.covariance, fit.variance, dof, group_variance)


def whitened(values: Floats, members: Sequence[NDArray[np.intp]], ratio: float) -> Floats:
    """Each group's values less (1 − 1/√(1 + n·θ)) of their mean."""
    out = np.array(values, dtype=np.float64)
    for m in members:
        out[m] -= (1.0 - 1.0 / np.sqrt(1.0 + m.size * ratio)) * out[m].mean(axis=0)
    return out
