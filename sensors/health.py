"""What a person needs to trust a log: rates, gaps, latency, fix quality. Plain JSON values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .manifest import Manifest
from .plausibility import Finding, findings
from .streams import FieldLog, Floats, GnssStream, Stream, Warn

FIXES = {0: "none", 1: "single", 2: "differential", 4: "fixed", 5: "float", 6: "estimated"}
MOST_CHANGES = 100
GAP = 2.5  # nominal intervals: longer is a gap


def health_of(log: FieldLog, clock_facts: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Findings by sensor name (and `clock`: the logger against UTC), as JSON values.

    clock_facts : by sensor what the clock reconstruction found; what is only known when raw files are read
        (drift, wraps, lost samples). Without them those of `log.health` are kept.
    """
    known = log.health if clock_facts is None else clock_facts
    told = findings(log.manifest, log.streams)
    found: dict[str, Any] = {}
    for name, stream in log.streams.items():
        timing = _timing(stream, _rate(log.manifest, name))
        finding = told.get(name, Finding({}))
        found[name] = timing | _by_kind(stream) | dict(finding.facts) | dict(known.get(name, {}))
        if finding.hints:
            found[name]["hints"] = list(finding.hints)
    if "clock" in known:
        found["clock"] = dict(known["clock"])
    return found


def hint_warnings(health: Mapping[str, Any], files: Mapping[str, str | None]) -> tuple[Warn, ...]:
    """What the readings suggest is wrong in run.toml, as warnings. files : by sensor."""
    return tuple(
        Warn(hint, "kept as it is; check run.toml", name, files.get(name))
        for name, entry in health.items()
        for hint in entry.get("hints", ())
    )


def _rate(manifest: Manifest, name: str) -> float:
    return float(manifest.sensors[name].rate)


def _timing(stream: Stream, rate: float) -> dict[str, Any]:
    """Count, span, rate and gaps of a stream."""
    if stream.t.size < 2:
        return {"samples": int(stream.t.size), "rate_hz": None, "gaps": 0, "longest_gap_s": None}
    step = np.diff(stream.t)
    return {
        "samples": int(stream.t.size),
        "start": float(stream.t[0]),
        "duration_s": float(stream.t[-1] - stream.t[0]),
        "rate_hz": float(1.0 / np.median(step)),
        "nominal_rate_hz": rate,
        "gaps": int(np.count_nonzero(step > GAP / rate)),
        "longest_gap_s": float(step.max()),
    }


def _by_kind(stream: Stream) -> dict[str, Any]:
    if isinstance(stream, GnssStream):
        return _fixes(stream)
    return {}


def _fixes(stream: GnssStream) -> dict[str, Any]:
    """Share of epochs by fix quality, and the least and median delay of sentences."""
    codes, counts = np.unique(stream.quality, return_counts=True)
    delay = stream.t_arrival - stream.t
    return {
        "fix": _shares(codes, counts),
        "quality": {str(int(code)): int(count) for code, count in zip(codes, counts, strict=True)},
        "quality_over_time": _changes(stream),
        "without_position": int(np.isnan(stream.lat).sum()),
        "median_sd_m": _median(np.hypot(stream.sd_east, stream.sd_north)),
        "delay_s": {"least": float(delay.min()), "median": float(np.median(delay))},
    }


def _shares(codes: Floats, counts: NDArray[np.int64]) -> str:
    """`fixed 92 %, float 8 %`, the commonest first."""
    whole = float(counts.sum())
    order = np.argsort(-counts, kind="stable")
    return ", ".join(
        f"{FIXES.get(int(codes[k]), f'quality {int(codes[k])}')} {100.0 * counts[k] / whole:.0f} %"
        for k in order
    )


def _changes(stream: GnssStream) -> list[list[float]]:
    """[seconds since the first epoch, fix quality] wherever the quality changes; the first MOST_CHANGES."""
    edges = np.flatnonzero(np.diff(stream.quality, prepend=np.nan) != 0.0)[:MOST_CHANGES]
    return [[float(stream.t[k] - stream.t[0]), float(stream.quality[k])] for k in edges]


def _median(values: Floats) -> float | None:
    known = values[~np.isnan(values)]
    return float(np.median(known)) if known.size else None
