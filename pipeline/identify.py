"""Parameters from passes, and the verdict from passes that were not used.

Every pass is fused once. The free parameters are estimated over all passes (what a researcher takes home), and again
for each fold without it; the verdict comes only from the folds' own passes, replayed with parameters they had
no part in.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ..model.machine import Machine
from ..sensors.manifest import Manifest
from .adequacy import Rules, Verdict, judge_campaign, judge_pass
from .campaign import WORST_FIRST
from .compare import Comparison, compare
from .findings import discrepancy_values, verdict_values
from .fusion.fuse import fuse
from .fusion.motion import Motion
from .identify_fit import LEVEL, Fit, fit
from .identify_names import listed
from .identify_parameter import IdentifyError, Parameter, WrongUseError, parameter_of
from .identify_problem import Stretch, changed, stretch_of
from .identify_profile import profile
from .identify_report import write_report
from .identify_wishes import Asked, Wish, wishes
from .replay_settings import ReplaySettings
from .result import dump_json
from .source import machine_of, read_source

Say = Callable[[str], None]

CELL, FIELD, DIRECTION, PASS = "cell", "field", "direction", "pass"
FOLDS = (CELL, FIELD, DIRECTION, PASS)
DOCUMENT = "identify.json"
SETTINGS = replace(ReplaySettings(), horizons=())  # the horizon curve is no part of an identification


@dataclass(frozen=True)
class Recording:
    """A pass fused once, with the machine as its manifest states it; sha256: of the log it came from."""

    manifest: Manifest
    motion: Motion
    machine: Machine
    sha256: str = ""

    @property
    def run(self) -> str:
        """The run's id."""
        return self.manifest.run.id

    def fold(self, kind: str) -> str:
        """The fold that the pass belongs to."""
        run = self.manifest.run
        named = {
            CELL: f"{run.field} {run.direction}",
            FIELD: run.field,
            DIRECTION: run.direction,
            PASS: run.id,
        }
        return named[kind]


@dataclass(frozen=True)
class Fold:
    """One fold: what was left out, and the parameters from the others (None, with the reason: stated ones)."""

    name: str
    runs: tuple[str, ...]
    fit: Fit | None
    reason: str


@dataclass(frozen=True)
class Identification:
    """Estimates over all passes, and each pass compared before, after, and held out.

    profiles : ends of the profile interval by parameter, None where a bound came first
    """

    recordings: tuple[Recording, ...]
    parameters: tuple[Parameter, ...]
    fit: Fit
    profiles: Mapping[str, tuple[float | None, float | None]]
    kind: str
    folds: tuple[Fold, ...]
    before: Mapping[str, Comparison]
    after: Mapping[str, Comparison]
    held_out: Mapping[str, Comparison]


def identify(
    recordings: Sequence[Recording],
    free: Mapping[str, Wish],
    kind: str = CELL,
    settings: ReplaySettings = SETTINGS,
    say: Say = lambda message: None,
) -> Identification:
    """Estimate the free parameters and compare every pass before, after and held out.

    free : by dotted name; a parameter without a prior of its own has that of the manifests' [uncertainty]
    kind : what a fold is: cell of field and direction, field, direction, or pass
    Raises IdentifyError.
    """
    _require(recordings, free, kind)
    parameters = tuple(_parameter(recordings, name, wish) for name, wish in free.items())
    before = {}
    for r in recordings:
        say(f"comparing {r.run} as stated")
        before[r.run] = compare(r.motion, r.machine, r.manifest, settings)
    _require_rows(before)
    stretches = [s for r in recordings for s in _stretches(r, before[r.run])]
    say("fitting all passes")
    found = fit(stretches, parameters, settings.seed)
    say("following the profiles")
    profiles = {p.name: profile(found, i) for i, p in enumerate(found.parameters)}
    after = {r.run: _compared(r, found, settings) for r in recordings}
    folds = _folds(recordings, stretches, parameters, kind, settings.seed, say)
    by_run = {run: fold.fit for fold in folds for run in fold.runs}
    held_out = {
        r.run: before[r.run] if (one := by_run[r.run]) is None else _compared(r, one, settings)
        for r in recordings
        if r.run in by_run
    }
    return Identification(
        tuple(recordings), parameters, found, profiles, kind, folds, before, after, held_out
    )


def _require(recordings: Sequence[Recording], free: Mapping[str, Wish], kind: str) -> None:
    runs = [r.run for r in recordings]
    twice = sorted({run for run in runs if runs.count(run) > 1})
    if twice:
        raise IdentifyError(f"{twice[0]}: two passes have this run.id; give each its own in run.toml")
    if not free:
        raise WrongUseError("--free: names no parameter; give one or more, like cornering_stiffness.front")
    if kind not in FOLDS:
        raise WrongUseError(f"--folds {kind}: is none of {', '.join(FOLDS)}")


def _require_rows(compared: Mapping[str, Comparison]) -> None:
    if any(c.rows for c in compared.values()):
        return
    left_out = [f"{run}: {why}" for run, c in compared.items() for why in _left_out(c)]
    why = "; ".join(left_out) or "nothing was driven straight at the nominal speed of run.toml"
    raise IdentifyError(f"no pass has a row that could be compared ({why})")


def _left_out(comparison: Comparison) -> tuple[str, ...]:
    return (*(e.reason for e in comparison.excluded), *(p.reason for p in comparison.passed_over))


def _parameter(recordings: Sequence[Recording], name: str, wish: Wish) -> Parameter:
    """A free parameter; unless asked otherwise its prior is the smallest sd that a manifest states for it."""
    sds = [one for r in recordings if (one := r.manifest.uncertainty.get(name, 0.0)) > 0.0]
    sd = min(sds, default=None) if wish.sd is None else wish.sd
    return parameter_of(name, [r.machine for r in recordings], wish.bounds, sd, wish.mean)


def _stretches(recording: Recording, comparison: Comparison) -> list[Stretch]:
    return [stretch_of(recording.run, recording.machine, row) for row in comparison.rows]


def _compared(recording: Recording, found: Fit, settings: ReplaySettings) -> Comparison:
    """A pass compared with the estimated parameters, their standard errors as what is not known of them."""
    known = {**recording.manifest.uncertainty, **found.spreads}
    manifest = recording.manifest.model_copy(update={"uncertainty": known})
    return compare(recording.motion, changed(recording.machine, found.values), manifest, settings)


def _folds(
    recordings: Sequence[Recording],
    stretches: Sequence[Stretch],
    parameters: Sequence[Parameter],
    kind: str,
    seed: int,
    say: Say,
) -> tuple[Fold, ...]:
    """Each fold with the parameters from all the others; none when there is one fold only."""
    names = list(dict.fromkeys(r.fold(kind) for r in recordings))
    found = []
    for name in names if len(names) > 1 else []:
        say(f"fitting without {name}")
        runs = tuple(r.run for r in recordings if r.fold(kind) == name)
        try:
            one = fit([s for s in stretches if s.run not in runs], parameters, seed)
            found.append(Fold(name, runs, one, ""))
        except IdentifyError as error:
            found.append(Fold(name, runs, None, str(error)))
    return tuple(found)


def verdict_of(found: Identification, compared: Mapping[str, Comparison], rules: Rules) -> Verdict:
    """The campaign's verdict over compared passes: the worst of the versions'."""
    variants: dict[str, list[Any]] = {}
    for r in found.recordings:
        if r.run in compared and (statistics := compared[r.run].statistics) is not None:
            variants.setdefault(r.manifest.run.variant, []).append(statistics)
    verdicts = [judge_campaign(members, rules) for members in variants.values()]
    if not verdicts:
        empty = judge_campaign((), rules)
        what = f"no pass is left to judge: all belong to one {found.kind}, and all were used"
        return replace(empty, reasons=(f"{what}; add passes, or --folds pass",))
    return min(verdicts, key=lambda v: WORST_FIRST.index(v.value))


def document_of(found: Identification, rules: Rules = Rules()) -> dict[str, Any]:
    """Plain JSON values: the held-out verdict first, then parameters, folds and passes."""
    stages = {"before": found.before, "after": found.after, "held_out": found.held_out}
    verdicts = {stage: verdict_of(found, compared, rules) for stage, compared in stages.items()}
    return {
        "schema": 1,
        "verdict": verdict_values(verdicts["held_out"]),
        "version": version("smts-validate"),
        "folds_by": found.kind,
        "stages": {
            stage: {
                "verdict": verdict_values(v),
                "discrepancy": discrepancy_values(v.responses),
                "decides": stage == "held_out",
            }
            for stage, v in verdicts.items()
        },
        "parameters": [_estimate(found, i) for i in range(len(found.fit.parameters))],
        "held": [vars(h) for h in found.fit.held],
        "correlation": {
            "parameters": [p.name for p in found.fit.parameters],
            "matrix": found.fit.correlation.tolist(),
        },
        "folds": [_fold_values(f) for f in found.folds],
        "passes": [
            {
                "run": r.run,
                "field": r.manifest.run.field,
                "direction": r.manifest.run.direction,
                "rows": len(found.before[r.run].rows),
                "sha256": r.sha256,
                **{s: _pass_discrepancy(compared.get(r.run), rules) for s, compared in stages.items()},
            }
            for r in found.recordings
        ],
    }


def _estimate(found: Identification, i: int) -> dict[str, Any]:
    one, p = found.fit, found.fit.parameters[i]
    z = float(one.z[i])
    value = p.value(z)
    return {
        "parameter": p.name,
        "stated": p.stated,
        "estimate": value,
        "standard_error": one.spreads[p.name],
        "standard_error_uncorrected": p.spread(z, float(one.bread[i, i]) ** 0.5),
        "interval": list(one.interval(i)),
        "profile_interval": list(found.profiles[p.name]),
        "level": LEVEL,
        "bounds": [p.low, p.high],
        "at_bound": bool(not p.low < value < p.high),
        "prior_mean": None if p.prior_sd is None else p.value(p.centre),
        "prior_sd": p.prior_sd,
        "steering_noise_pull": p.value(float(one.optimum[i])) - value,
    }


def _fold_values(fold: Fold) -> dict[str, Any]:
    one = fold.fit
    return {
        "left_out": fold.name,
        "runs": list(fold.runs),
        "estimates": {} if one is None else one.values,
        "standard_errors": {} if one is None else one.spreads,
        "held": [] if one is None else [vars(h) for h in one.held],
        "reason": fold.reason,
    }


def _pass_discrepancy(comparison: Comparison | None, rules: Rules) -> dict[str, Any] | None:
    if comparison is None or comparison.statistics is None:
        return None
    return discrepancy_values(judge_pass(comparison.statistics, rules).responses)


def identify_to_folder(
    sources: Sequence[Path],
    wanted: Asked,
    kind: str,
    out: Path,
    say: Say = lambda message: None,
    manifests: Sequence[Path] = (),
) -> dict[str, Any]:
    """Identify from passes as they lie (logs, raw folders); `identify.json` and a report land in `out`.

    manifests : one a source, for logs that carry none; empty: each has its own
    Gives its document. Raises IdentifyError, and the stages' own errors.
    """
    if manifests and len(manifests) != len(sources):
        raise WrongUseError(
            f"--manifest: {len(manifests)} for {len(sources)} passes; give one a pass, in order"
        )
    recordings, free = [], None
    given: Sequence[Path | None] = manifests or [None] * len(sources)
    for source, manifest in zip(sources, given, strict=True):
        say(f"reading and fusing {source}")
        log = read_source(source, manifest)
        machine = machine_of(log)
        free = _checked(wanted, machine) if free is None else free
        recordings.append(Recording(log.manifest, fuse(log), machine, log.sha256))
    document = document_of(identify(recordings, free or {}, kind, say=say))
    out.mkdir(parents=True, exist_ok=True)
    (out / DOCUMENT).write_text(dump_json(document), encoding="utf-8")
    page = write_report(document, out, max(r.manifest.run.date for r in recordings))
    return {**document, "out": str(out), "report": str(page)}


def _checked(wanted: Asked, machine: Machine) -> dict[str, Wish]:
    """What is asked, by the first pass's machine: a wrong name or bound is told before any pass is fused."""
    free = wishes(wanted, machine)
    for name, wish in free.items():
        parameter_of(name, [machine], wish.bounds, wish.sd, wish.mean)
    return free


def names_of(source: Path, manifest: Path | None = None) -> tuple[dict[str, Any], ...]:
    """Every parameter of a pass's machine that can be freed: name, short form, stated value."""
    return listed(machine_of(read_source(source, manifest)))
