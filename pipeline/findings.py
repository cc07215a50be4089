"""What a pass came to, as plain values: the body of metrics.json, and the columns of its tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..sensors.manifest import Manifest
from ..sensors.streams import Warn
from . import grid as on_grid
from . import metrics as shelf
from .adequacy import Judged, Verdict
from .bounds import DEVIATION1, DEVIATION2, YAW1, YAW2
from .compare import Comparison, RowComparison, discrepancies, horizon_curve
from .fusion.motion import Motion
from .uncertainty import GROUPS

Floats = NDArray[np.float64]

PAPER = {"trajectory": 11.0, "yaw": 9.0}  # %, shown beside the headline
HEADLINES = {"trajectory": (DEVIATION1, DEVIATION2), "yaw": (YAW1, YAW2)}
UNITS = {DEVIATION1: "m", DEVIATION2: "m", YAW1: "rad", YAW2: "rad"}
WITHIN_U_VAL = 2.0
INDEPENDENCE = {
    "sensor": "independent of the body's motion: everything may be judged",
    "wheels": (
        "shares the tractor's gyro with the measured yaw: its slow error is bounded by the alignment, and the "
        "response of yaw rate to steering is shown with that caution only"
    ),
    None: (
        "no series that is independent of the body's yaw: the tractor and whatever combines both bodies are not "
        "judged, the seeder runs behind the measured tractor"
    ),
}
EXPLAINED_QUANTILE = 0.95


def metrics_of(
    manifest: Manifest,
    motion: Motion,
    comparison: Comparison,
    verdict: Verdict,
    *,
    warnings: Iterable[Warn] = (),
    health: Mapping[str, Any] | None = None,
    spectra: Mapping[str, Any] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The body of metrics.json: percentages as numbers, lengths in m, angles in rad unless the key says
    `_deg`.

    Values that are not finite are left for the writer to turn into null.
    """
    return {
        "schema": 1,
        "run": manifest.run.id,
        "verdict": verdict_values(verdict),
        "discrepancy": discrepancy_values(verdict.responses),
        "paper": dict(PAPER),
        "warnings": [warning_values(w) for w in (*warnings, *motion.warnings)],
        "health": dict(health or {}),
        "comparison": comparison_values(comparison),
        "responses": {n: response_values(j, n, comparison) for n, j in verdict.responses.items()},
        "disclosure": disclosure_table(comparison),
        "horizon_curve": curve_values(comparison),
        "companions": companion_values(comparison, "residual"),
        "companions_null": companion_values(comparison, "null"),
        "attribution": {n: attribution(comparison, n) for n in comparison.responses},
        "alignment": alignment_values(comparison),
        "straightness": straightness(manifest, motion, comparison),
        "steering": steering_values(motion),
        "spectra": dict(spectra or {}),
        "consistency": {
            "consistent": motion.consistent,
            "channels": [asdict(channel) for channel in motion.consistency],
        },
        "fusion": {"noise": dict(motion.noise), "calibration": dict(motion.calibration)},
        "provenance": dict(provenance or {}),
    }


def verdict_values(verdict: Verdict) -> dict[str, Any]:
    """The verdict as it stands in metrics.json and campaign.json."""
    return {
        "value": verdict.value,
        "scope": verdict.scope,
        "reasons": list(verdict.reasons),
        "codes": list(verdict.codes),
        "threshold_percent": verdict.rules.threshold_percent,
        "alpha": verdict.rules.alpha,
        "passes": verdict.passes,
        "passes_needed": verdict.passes_needed,
    }


def warning_values(warning: Warn) -> dict[str, Any]:
    """One warning in the order of the format page."""
    return {
        "sensor": warning.sensor,
        "file": warning.file,
        "row": warning.row,
        "what": warning.what,
        "effect": warning.effect,
    }


def discrepancy_values(found: Mapping[str, Judged]) -> dict[str, Any]:
    """The headline in percent: each body, both by quadratic mean, and the bounds combined alike."""
    return {kind: _headline([found.get(name) for name in names]) for kind, names in HEADLINES.items()}


def _headline(pair: Sequence[Judged | None]) -> dict[str, Any]:
    tractor, seeder = [None if j is None else _percent(j.d) for j in pair]
    present = [j for j in pair if j is not None]
    # Seeder only (the tractor is not testable): then nothing speaks for both, and `combined` stays null.
    testable = bool(present) and pair[0] is not None
    ends = [shown_interval(j) for j in present] if testable else []
    low, high = (_quadratic_mean([None if e is None else e[side] for e in ends]) for side in (0, 1))
    return {
        "body1": tractor,
        "body2": seeder,
        "combined": _percent(_quadratic_mean([j.d for j in present])) if testable else None,
        "interval": None if low is None or high is None else [_percent(low), _percent(high)],
    }


def shown_interval(judged: Judged) -> tuple[float, float] | None:
    """The interval as it is printed: from D_lo to D_hi, widened to hold D itself.

    D_hi and D_lo have known measuring error removed and D has not, so D may lie above both; an interval that does
    not hold its own figure would read as a mistake. The verdict uses D_hi and D_lo as they are.
    """
    if judged.d is None or judged.lo is None or judged.hi is None or not np.isfinite(judged.hi):
        return None
    return min(judged.lo, judged.d), max(judged.hi, judged.d)


def _quadratic_mean(values: Sequence[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    if not known or len(known) < len(values):
        return None
    return float(np.sqrt(np.mean(np.square(known))))


def _percent(value: float | None) -> float | None:
    return None if value is None else 100.0 * value


def comparison_values(comparison: Comparison) -> dict[str, Any]:
    """What was compared, what was left out and why, and the choices fixed beforehand."""
    settings = comparison.settings
    return {
        "mode": "seeder behind the measured tractor" if comparison.trailed else "replay",
        "horizon": settings.horizon,
        "grid_step": settings.grid_step,
        "draws": settings.draws,
        "rows": [_row_values(r) for r in comparison.rows],
        "excluded": [{"row": e.row.index, "reason": e.reason} for e in comparison.excluded],
        "passed_over": [asdict(p) for p in comparison.passed_over],
    }


def _row_values(row: RowComparison) -> dict[str, Any]:
    return {
        "row": row.row.index,
        "direction": row.row.direction,
        "line": row.row.source,
        "length": row.row.length,
        "coverage": row.grid.coverage,
        "windows": len(row.fits),
    }


def response_values(judged: Judged, name: str, comparison: Comparison) -> dict[str, Any]:
    """One response's numbers behind the headline, in percent and in its unit."""
    statistics = comparison.statistics
    own = None if statistics is None else statistics.responses.get(name)
    interval = shown_interval(judged)
    return {
        "unit": UNITS[name],
        "percent": _percent(judged.d),
        "percent_null": _percent(judged.d_null),
        "interval": None if interval is None else [_percent(end) for end in interval],
        "d_low": _percent(judged.lo),
        "d_high": _percent(judged.hi),
        "rmse": judged.rmse,
        "rmse_null": None if own is None else float(np.sqrt(own.null_mse)),
        "r95": judged.r95,
        "u": judged.u,
        "u_range": judged.u_range,
        "u_absolute": judged.u_absolute,
        "u_input": judged.u_input,
        "n_eff": None if own is None else own.n_eff,
        "n_eff_range": None if own is None else own.n_eff_range,
    }


def disclosure_table(comparison: Comparison) -> dict[str, Any]:
    """Discrepancy in percent by how much may move: nothing and in one piece, start only, bounded, free.

    `none`: the whole row in one run from its start; `start`: windows from the smoothed state; `bounded`: the
    headline; `free`: offset and heading of each window fitted without a prior; `null`: the straight
    line, bounded.
    """
    names = {"none": "unaligned", "start": "start", "bounded": "residual", "free": "free", "null": "null"}
    return {
        key: {n: 100.0 * d for n, d in discrepancies(comparison, arrays).items()}
        for key, arrays in names.items()
    }


def curve_values(comparison: Comparison) -> list[dict[str, Any]]:
    """Discrepancy in percent against the windows' length; the whole row has horizon null."""
    return [
        {"horizon": h if np.isfinite(h) else None} | {n: 100.0 * d for n, d in found.items()}
        for h, found in horizon_curve(comparison).items()
    ]


def companion_values(comparison: Comparison, arrays: str) -> dict[str, Any]:
    """Every metric of the shelf by response: the mean over rows, weighted by their points."""
    found: dict[str, Any] = {}
    for name in comparison.responses:
        tables, weights = [], []
        for row in comparison.rows:
            valid = row.valid[name]
            measured = row.measured[name][valid]
            simulated = measured + getattr(row, arrays)[name][valid]
            pair = shelf.Pair(measured, simulated, row.grid.step, _speed(row))
            tables.append(shelf.companions(pair))
            weights.append(float(measured.size))
        found[name] = _mean_tables(tables, np.array(weights))
    return found


def _speed(row: RowComparison) -> float:
    motion = row.context.motion
    return float(np.mean(motion.tractor.v[row.row.samples]))


def _mean_tables(tables: Sequence[Mapping[str, Mapping[str, float]]], weights: Floats) -> dict[str, Any]:
    return {
        key: {
            name: float(np.average([table[key][name] for table in tables], weights=weights))
            for name in tables[0][key]
        }
        for key in tables[0]
    }


def attribution(comparison: Comparison, name: str) -> dict[str, Any]:
    """Whether known uncertainty explains the residual, after ASME V&V 20: u_val² = u² + u_in², point by
    point.

    `explained`: M lies within the 95 % quantile of what draws of measuring error and inputs alone produce.
    """
    residual = comparison.pooled("residual", name)
    u2 = comparison.pooled("u2", name)
    groups = {g: _pooled_inputs(comparison, name, g) for g in GROUPS}
    u_val = np.sqrt(u2 + np.sum(list(groups.values()), axis=0))
    weights = [int(r.valid[name].sum()) for r in comparison.rows]
    # Draws are joined row by row: draw k of one row with draw k of the next.
    size = min(r.explained[name].size for r in comparison.rows)
    drawn = np.average([r.explained[name][:size] for r in comparison.rows], axis=0, weights=weights)
    mse, limit = float(np.mean(residual**2)), float(np.quantile(drawn, EXPLAINED_QUANTILE))
    return {
        "u_measuring": float(np.sqrt(np.mean(u2))),
        **{f"u_{g}": float(np.sqrt(np.mean(v))) for g, v in groups.items()},
        "u_val": float(np.sqrt(np.mean(u_val**2))),
        "share_within_2_u_val": float(np.mean(np.abs(residual) < WITHIN_U_VAL * u_val)),
        "rmse_known_uncertainty_q95": float(np.sqrt(limit)),
        "explained": bool(mse <= limit),
    }


def _pooled_inputs(comparison: Comparison, name: str, group: str) -> Floats:
    return np.concatenate([r.u2_input[name][group][r.valid[name]] for r in comparison.rows])


def alignment_values(comparison: Comparison) -> dict[str, Any]:
    """What moved: each window's θ with its χ² before the prior was raised, and the share within the bound."""
    windows = [
        {
            "row": row.row.index,
            "window": fit.window.index,
            "offset": float(fit.alignment.theta[0]),
            "heading_deg": float(np.rad2deg(fit.alignment.theta[1])),
            "steer_deg": float(np.rad2deg(fit.alignment.theta[2])) if fit.alignment.theta.size > 2 else None,
            "chi2": fit.chi2,
            "prior_weight": fit.alignment.weight,
        }
        for row in comparison.rows
        for fit in row.fits
    ]
    within = None if comparison.statistics is None else comparison.statistics.windows_within
    return {"windows_within_bound": within, "windows": windows}


def straightness(manifest: Manifest, motion: Motion, comparison: Comparison) -> dict[str, Any]:
    """Straightness indices of the measured motion of every body: greatest, range, R95, rms, in m or rad.

    Over every row found that is covered well enough, also where the model could not be tested on it. R95 and rms
    are of the rows centred, the range is the widest row's.
    """
    settings = comparison.settings
    gap = on_grid.longest_gap([g.rate for g in manifest.of_kind("gps").values()], settings.longest_gap)
    bodies = tuple(range(1, len(motion.bodies) + 1))
    grids = [on_grid.row_grid(motion, row, bodies, settings.grid_step, gap) for row in comparison.found]
    found: dict[str, list[Floats]] = {}
    for grid in grids:
        if grid.coverage >= settings.least_coverage:
            for body in grid.bodies:
                for name, values in body.channels:
                    found.setdefault(name, []).append(values[body.valid])
    return {name: _indices(rows) for name, rows in found.items()}


def _indices(rows: Sequence[Floats]) -> dict[str, float]:
    centred = np.concatenate([r - r.mean() for r in rows])
    low, high = np.quantile(centred, [0.025, 0.975])
    return {
        "max_abs": float(max(np.abs(r).max() for r in rows)),
        "range": float(max(np.ptp(r) for r in rows)),
        "r95": float(high - low),
        "rms": float(np.sqrt(np.mean(centred**2))),
    }


def steering_values(motion: Motion) -> dict[str, Any]:
    """What the series that drove the replay was made of, and its stated errors."""
    steer = motion.steer_input
    if steer is None:
        return {"source": None, "testable": False, "independence": INDEPENDENCE[None]}
    return {
        "source": steer.source,
        "testable": True,
        "independence": INDEPENDENCE[steer.source],
        "sd_deg": float(np.rad2deg(np.mean(steer.sd))),
        "correlation_time": steer.correlation_time,
        "zero_sd_deg": float(np.rad2deg(steer.zero_sd)),
        "scale_sd": steer.scale_sd,
    }


def simulated_columns(motion: Motion, comparison: Comparison) -> dict[str, Floats]:
    """Columns of simulation.parquet on motion.t: the headline's windows joined; NaN outside compared rows."""
    names = [f"{q}{b}" for b in range(1, len(motion.bodies) + 1) for q in ("x", "y", "yaw", "v", "yaw_rate")]
    columns = {name: np.full(motion.t.size, np.nan) for name in (*names, "steer", "window")}
    for row in comparison.rows:
        for fit in row.fits:
            _write_window(columns, motion, fit.window.start, fit.window.stop, fit, row, comparison.trailed)
    return columns


def _write_window(
    columns: dict[str, Floats],
    motion: Motion,
    start: int,
    stop: int,
    fit: Any,
    row: RowComparison,
    trailed: bool,
) -> None:
    """One window's run read at the motion's instants; trailed runs are moved rigidly by their alignment."""
    run, index, part = fit.run, fit.index, slice(start, stop)
    t = motion.t[part] - motion.t[start]
    own = run.t[index] - run.t[index][0]
    for name in columns:
        values = getattr(run, name, None)
        if values is not None and not (trailed and name == "steer"):
            columns[name][part] = np.interp(t, own, values[index])
    columns["window"][part] = float(fit.window.index)
    if trailed:
        _move_rigidly(columns, part, fit.alignment.theta, row)


def _move_rigidly(columns: dict[str, Floats], part: slice, theta: Floats, row: RowComparison) -> None:
    offset, turn = float(theta[0]), float(theta[1])
    heading = row.row.line.heading
    x0, y0 = columns["x1"][part][0], columns["y1"][part][0]
    for b in ("1", "2"):
        x, y = columns[f"x{b}"][part] - x0, columns[f"y{b}"][part] - y0
        columns[f"x{b}"][part] = x0 + np.cos(turn) * x - np.sin(turn) * y - offset * np.sin(heading)
        columns[f"y{b}"][part] = y0 + np.sin(turn) * x + np.cos(turn) * y + offset * np.cos(heading)
        columns[f"yaw{b}"][part] += turn


def comparison_columns(comparison: Comparison) -> dict[str, NDArray[Any]]:
    """Columns of comparison.parquet: one line a row and chainage, body b's quantities beside each other.

    row, s (m along the row's line), then for each body b: window{b}, valid{b}, t{b} (s, UTC), and for q
    in n (m),
    yaw (rad, relative to the line): {q}{b} measured, {q}{b}_simulated, {q}{b}_start (nothing moved),
    {q}{b}_null, sd_{q}{b} (of the residual by measuring error), sd_input_{q}{b}. NaN where a body was not.
    """
    tables = [_row_table(row) for row in comparison.rows]
    if not tables:
        return {}
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def _row_table(row: RowComparison) -> dict[str, NDArray[Any]]:
    step = row.grid.step
    first = min(round(b.s[0] / step) for b in row.grid.bodies)
    last = max(round(b.s[-1] / step) for b in row.grid.bodies)
    size = last - first + 1
    table: dict[str, NDArray[Any]] = {
        "row": np.full(size, row.row.index, dtype=np.int32),
        "s": step * np.arange(first, last + 1),
    }
    for body in row.grid.bodies:
        place = slice(round(body.s[0] / step) - first, round(body.s[0] / step) - first + body.s.size)
        for name, values in _body_values(row, body.body).items():
            column = np.full(size, np.nan)
            column[place] = values
            table[name] = column
    return table


def _body_values(row: RowComparison, b: int) -> dict[str, Floats]:
    body = next(g for g in row.grid.bodies if g.body == b)
    values: dict[str, Floats] = {f"t{b}": body.t, f"valid{b}": body.valid.astype(np.float64)}
    for quantity, (name, measured) in zip(("n", "yaw"), body.channels, strict=True):
        values[f"window{b}"] = row.window[name]
        values[f"{quantity}{b}"] = measured
        for suffix, arrays in (("simulated", row.residual), ("start", row.start), ("null", row.null)):
            values[f"{quantity}{b}_{suffix}"] = measured + arrays[name]
        values[f"sd_{quantity}{b}"] = np.sqrt(row.u2[name])
        values[f"sd_input_{quantity}{b}"] = np.sqrt(np.sum([row.u2_input[name][g] for g in GROUPS], axis=0))
    return values
