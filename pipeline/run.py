"""One pass: the stages in order, from a raw folder or a log to a results folder."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ..sensors.streams import FieldLog
from . import findings
from .adequacy import judge_pass
from .compare import compare
from .fusion.fuse import fuse
from .garbage import seldom_collected
from .result import PassResult, write_result
from .run_settings import RunSettings, with_engine
from .source import machine_of, read_source
from .spectra import spectra_of

Say = Callable[[str], None]
PACKAGES = ("smts-validate", "numpy", "scipy", "numba", "pandas", "pyarrow", "filterpy", "pymap3d", "mcap")


def silent(message: str) -> None:
    """Say nothing."""


def run_pass(log: FieldLog, settings: RunSettings = RunSettings(), say: Say = silent) -> PassResult:
    """The chain for one pass: fuse, replay and compare, judge.

    Raises the stages' own errors, each one line: what, where, how to mend.
    """
    manifest, machine = log.manifest, machine_of(log)  # first: it may be refused
    say("fusing the sensors")
    motion = fuse(log, settings.fusion)
    say("replaying the model")
    comparison = compare(motion, machine, manifest, settings.replay)
    spectra = spectra_of(motion, comparison, machine)
    left_out = [row.reason for row in comparison.excluded] + [one.reason for one in comparison.passed_over]
    verdict = judge_pass(comparison.statistics, settings.rules, left_out)
    return PassResult(
        manifest=manifest,
        manifest_text=log.manifest_text,
        motion=motion,
        rows=comparison.found,
        simulated=findings.simulated_columns(motion, comparison),
        comparison=findings.comparison_columns(comparison),
        plots=spectra.plots,
        metrics=findings.metrics_of(
            manifest,
            motion,
            comparison,
            verdict,
            warnings=log.warnings,
            health=log.health,
            spectra=spectra.values,
            provenance=provenance(log, settings),
        ),
    )


def provenance(log: FieldLog, settings: RunSettings) -> dict[str, Any]:
    """What a result came from: digests of inputs, versions, options; nothing that two runs differ in."""
    return {
        "source": Path(log.source).name,
        "command": f"smts-validate run {Path(log.source).name}",
        "source_sha256": log.sha256,
        "date": log.manifest.run.date.isoformat(),
        "manifest_sha256": hashlib.sha256(log.manifest_text.encode()).hexdigest(),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
        "options": asdict(settings),
    }


@seldom_collected()
def compute(
    source: Path,
    out: Path,
    manifest: Path | None = None,
    settings: RunSettings = RunSettings(),
    fingerprint: str | None = None,
    say: Say = silent,
) -> PassResult:
    """Run a pass from its files to its results folder, which appears whole or not at all.

    Parameters
    ----------
    source : a raw pass's folder, or a log
    out : results folder
    manifest : run.toml for a log that carries none
    fingerprint : digest of inputs, options and program, kept in the result for a batch that goes on
    """
    say(f"reading {source}")
    result = run_pass(read_source(source, manifest), settings, say)
    if fingerprint is not None:
        result = with_provenance(result, {"fingerprint": fingerprint})
    say("writing the reports")
    write_result(out, result, _finish)
    return result


def _finish(folder: Path) -> None:
    # Late: where another process makes the reports, nothing of them is imported here.
    from .report import finish

    finish(folder)


def with_provenance(result: PassResult, more: Mapping[str, Any]) -> PassResult:
    """The same result with more said about where it came from."""
    known = {**result.metrics.get("provenance", {}), **more}
    return replace(result, metrics={**result.metrics, "provenance": known})


def run_to_folder(
    source: Path,
    out: Path | None = None,
    manifest: Path | None = None,
    engine: str = "compiled",
    finish: Callable[[Path], None] | None = None,
    say: Say = silent,
    before: Callable[[], None] | None = None,
) -> dict[str, Any]:
    """Run one pass into `out` (results/<run.id> by default); the head of its metrics, and its report.

    engine : of the fusion, "compiled" or "filterpy"
    finish : makes log and reports of the result's folder; None: this process makes them
    before : done between reading and computing, such as compiling what is not on disk
    """
    say(f"reading {source}")
    log = read_source(source, manifest)
    if before is not None:
        before()
    folder = Path("results") / log.manifest.run.id if out is None else out
    result = run_pass(log, with_engine(RunSettings(), engine), say)
    say("writing the reports")
    write_result(folder, result, finish or _finish)
    return {**headline(result.metrics), "out": str(folder), "report": str(folder / "report.html")}


def headline(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """What a person or a script wants first of metrics.json."""
    return {key: metrics[key] for key in ("schema", "run", "verdict", "discrepancy", "warnings")}
