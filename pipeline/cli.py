"""The command line: parses, prints, exits; the only module that does.

Every import of the stages happens inside the command that needs it, so that `--help` stays quick.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar

import click

from .cores import cores
from .garbage import leave_the_rest, seldom_collected

FAILED = 1
WRONG_USE = 2
NOT_ADEQUATE = 3
INTERRUPTED = 130
CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}

Command = TypeVar("Command", bound=Callable[..., Any])


@click.group(context_settings=CONTEXT)
@click.version_option(package_name="smts-validate", prog_name="smts-validate")
def app() -> None:
    """Is a tractor-and-seeder model adequate? From raw field logs to a verdict with its uncertainty."""


def common(command: Command) -> Command:
    """Give a command the options that every command has: --json and --debug."""

    @click.option("--json", "as_json", is_flag=True, help="Print one JSON document instead of text.")
    @click.option("--debug", is_flag=True, help="Show the traceback of an error.")
    @wraps(command)
    def with_common_options(*args: Any, debug: bool, **options: Any) -> Any:
        if debug:
            os.environ["SMTS_DEBUG"] = "1"
        return command(*args, **options)

    return with_common_options  # type: ignore[return-value]


def emit(document: Any, as_json: bool, text: Callable[[Any], str]) -> None:
    """Print a command's result: JSON for machines, or the text that `text` makes of it."""
    click.echo(json_of(document) if as_json else text(document))


def json_of(document: Any) -> str:
    """One line of JSON; numbers that are not finite become null."""
    try:
        return json.dumps(document, ensure_ascii=False, allow_nan=False)
    except ValueError:
        from .result import plain

        return json.dumps(plain(document), ensure_ascii=False, allow_nan=False)


def progress(message: str) -> None:
    """Say what is going on, for a person only: on stderr, when it is a terminal."""
    if sys.stderr.isatty():
        click.echo(message, err=True)


@app.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--force", is_flag=True, help="Write over a run.toml that is there.")
@common
def init(folder: Path, force: bool, as_json: bool) -> None:
    """Draft a run.toml for a FOLDER of raw files, and say what was guessed and why."""
    from .source import draft_pass

    document = draft_pass(folder, force)
    emit(document, as_json, lambda made: "\n".join([f"wrote {made['manifest']}", *made["reasons"]]))


@app.command()
@click.argument("passes", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("-o", "logs", required=True, type=click.Path(path_type=Path), help="Folder for the logs.")
@common
def ingest(passes: tuple[Path, ...], logs: Path, as_json: bool) -> None:
    """Turn raw PASSES (folders with a run.toml) into logs, <run.id>.mcap in the folder of -o."""
    from . import console
    from .source import ingest_pass

    tables = []
    for folder in passes:
        progress(f"reading {folder}")
        tables.append(ingest_pass(folder, logs))
    emit({"logs": tables}, as_json, console.ingested)


@app.command()
@click.argument("log", type=click.Path(path_type=Path))
@click.option("--manifest", type=click.Path(path_type=Path), help="run.toml for a log that carries none.")
@common
def inspect(log: Path, manifest: Path | None, as_json: bool) -> None:
    """Show what is in a LOG: rates, gaps, clock drift, fix quality."""
    from . import console
    from .source import inspect_log

    emit(inspect_log(log, manifest), as_json, console.inspected)


@app.command()
@click.argument("log", type=click.Path(path_type=Path))
@click.option("-o", "out", type=click.Path(path_type=Path), help="Results folder (results/<run.id>).")
@click.option("--manifest", type=click.Path(path_type=Path), help="run.toml for a log that carries none.")
@click.option("--engine", type=click.Choice(["compiled", "filterpy"]), default="compiled", show_default=True)
@click.option("--figures", is_flag=True, help="Also each figure as SVG, PDF and PNG in figures/.")
@click.option("--require-adequate", is_flag=True, help="Exit with 3 when the verdict is not `adequate`.")
@common
def run(
    log: Path, out: Path | None, manifest: Path | None, engine: str, figures: bool, require_adequate: bool,
    as_json: bool,
) -> None:  # fmt: skip
    """Run the whole chain for one pass: LOG is an MCAP log or a raw pass's folder."""
    from .kernels_beside import absent, kernels_beside
    from .report_beside import reports_beside

    missing = absent()
    with (
        kernels_beside(missing) as compiled,
        reports_beside(figures, compiled if missing else None) as (before, finish),
    ):
        from . import console
        from .run import run_to_folder

        summary = run_to_folder(log, out, manifest, engine, finish, progress, before)
    emit(summary, as_json, console.ran)
    _leave_unless_adequate(require_adequate, summary["verdict"]["value"])


@app.command()
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option("-o", "out", default="results", show_default=True, help="Folder or URL for the results.")
@click.option("-j", "workers", type=click.IntRange(0), help="Processes [one a core]; 0: in this process.")
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler (tcp://HOST:8786) in place of -j.")
@click.option("--no-resume", is_flag=True, help="Compute every pass again.")
@click.option("--campaign", metavar="FILE", help="campaign.toml, when none lies in a given path.")
@click.option("--time-limit", type=click.FloatRange(0, min_open=True), help="Seconds that one pass may take.")
@click.option("--memory-limit", metavar="SIZE", help="Memory of one pass's process, like 2G.")
@click.option("--no-campaign", is_flag=True, help="Passes only (a task of a job array).")
@click.option("--print-commands", is_flag=True, help="One command a pass, for a job array; runs nothing.")
@click.option("--require-adequate", is_flag=True, help="Exit with 3 when the verdict is not `adequate`.")
@common
def batch(paths: tuple[str, ...], as_json: bool, print_commands: bool, **options: Any) -> None:
    """Run every pass under the PATHs (raw folders, logs, URLs), then the campaign."""
    from . import batch_view, console
    from .batch import commands, run_batch

    required = options.pop("require_adequate")
    request = _request(paths, **options)
    if print_commands:
        emit({"commands": commands(request)}, as_json, lambda document: "\n".join(document["commands"]))
        return
    with _watching(as_json, batch_view) as watch:
        summary = run_batch(request, watch)
    emit({"event": "end", **summary} if as_json else summary, as_json, console.batched)
    if summary["failed"]:
        sys.exit(FAILED)
    _leave_unless_adequate(required, (summary["verdict"] or {}).get("value", ""))


def _request(paths: tuple[str, ...], **options: Any) -> Any:
    from .batch import Request
    from .batch_limits import Limits, parse_bytes

    try:
        memory = parse_bytes(options["memory_limit"]) if options["memory_limit"] else None
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--memory-limit") from None
    workers = options["workers"]
    return Request(
        paths=paths,
        out=options["out"],
        workers=cores() if workers is None else workers,
        scheduler=options["scheduler"],
        resume=not options["no_resume"],
        campaign=options["campaign"],
        limits=Limits(options["time_limit"], memory),
        summarise=not options["no_campaign"],
    )


@contextmanager
def _watching(as_json: bool, view: Any) -> Iterator[Callable[[Any], None]]:
    """Show a batch's progress: JSON lines, a live table on a terminal, or plain lines on stderr."""
    if as_json:
        yield lambda progress: _echo_if(json.dumps(event) if (event := view.event(progress)) else "", False)
    elif not sys.stderr.isatty():
        yield lambda progress: _echo_if(view.line(progress), True)
    else:
        from rich.console import Console
        from rich.live import Live

        with Live(console=Console(stderr=True), refresh_per_second=4, transient=True) as live:

            def show(progress: Any) -> None:
                if progress.note or (progress.last and progress.last.status == "failed"):
                    live.console.print(view.line(progress), markup=False, highlight=False)
                live.update(view.live_table(progress))

            yield show


def _echo_if(text: str, err: bool) -> None:
    if text:
        click.echo(text, err=err)


def _leave_unless_adequate(required: bool, verdict: str) -> None:
    if required and verdict != "adequate":
        sys.exit(NOT_ADEQUATE)


@app.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--open", "show", is_flag=True, help="Open the report in the browser.")
@click.option("--figures", is_flag=True, help="Also each figure as SVG, PDF and PNG in figures/.")
@click.option("--csv", is_flag=True, help="Also each table as CSV in tables/.")
@click.option("--latex", is_flag=True, help="Also each table as LaTeX in tables/.")
@common
def report(out: Path, show: bool, figures: bool, csv: bool, latex: bool, as_json: bool) -> None:
    """Make the reports in OUT again from its stored results."""
    from .remake import Exports, remake

    kinds = tuple(kind for kind, wanted in (("csv", csv), ("tex", latex)) if wanted)
    page = remake(out, Exports(figures, kinds), progress)
    emit({"report": str(page)}, as_json, lambda made: f"report: {made['report']}")
    if show:
        click.launch(str(page))


@app.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--preset", metavar="NAME", help="A ready plan: benign, bad_sensors, outage, headland, ...")
@click.option("--plan", type=click.Path(path_type=Path), help="The pass's plan, a TOML file.")
@click.option("--campaign", type=click.Path(path_type=Path), help="A campaign's plan, a TOML file.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of a single pass.")
@click.option("--id", "run_id", metavar="ID", help="run.id of a single pass.")
@common
def synth(
    out: Path, preset: str | None, plan: Path | None, campaign: Path | None, seed: int, run_id: str | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Make synthetic raw passes with known truth in the folder OUT."""
    from .twin_campaign import synth as make

    folders = make(out, named=preset, plan=plan, campaign=campaign, seed=seed, run_id=run_id)
    document = {"passes": [str(folder) for folder in folders]}
    emit(document, as_json, lambda made: "\n".join(made["passes"]))


@app.command()
@click.option("--variant", "variants", multiple=True, metavar="a|b|c|FILE", help="Repeatable [all three].")
@click.option("-o", "out", type=click.Path(path_type=Path), default="study", show_default=True)
@common
def simulate(variants: tuple[str, ...], out: Path, as_json: bool) -> None:
    """The theoretical study: versions a, b, c (or a TOML) over random soils, beside the paper's figures."""
    from . import console
    from .study_run import make_study

    made = make_study(out, variants, progress=progress)
    emit(console.study_values(out, made.files, (made.table,)), as_json, console.studied)


@app.command()
@click.option("--range", "ranges", multiple=True, metavar="NAME=LOW:HIGH", help="Repeatable [v, l5, Pw].")
@click.option("--sampler", type=click.Choice(["grid", "latin", "sobol"]), default="sobol", show_default=True)
@click.option("--count", type=click.IntRange(2), default=256, show_default=True, help="Designs.")
@click.option("--soils", type=click.IntRange(2), default=16, show_default=True, help="Soils for each design.")
@click.option("--base", default="b", show_default=True, metavar="a|b|c|FILE", help="Version that is changed.")
@click.option("--index", default="r95_1", show_default=True, help="What counts as straight.")
@click.option("-j", "workers", type=click.IntRange(1), help="Threads [one a core].")
@click.option("-o", "out", type=click.Path(path_type=Path), default="sweep", show_default=True)
@common
def sweep(ranges: tuple[str, ...], out: Path, workers: int | None, as_json: bool, **options: Any) -> None:
    """Sweep parameters of the model: which design runs the straightest, and by how much."""
    from . import console
    from .study_run import make_sweep

    def say(done: int, total: int) -> None:
        progress(f"{done} of {total} designs")

    made = make_sweep(out, ranges, workers=workers or cores(), progress=say, **options)
    emit(console.study_values(out, made.files, made.tables), as_json, console.studied)


@app.command()
@click.argument("passes", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--free", multiple=True, required=True, metavar="NAME[=LOW:HIGH],...",
    help="What to estimate, like cornering_stiffness.front; `help` lists the names.",
)  # fmt: skip
@click.option("--bound", "bounds", multiple=True, metavar="NAME=LOW:HIGH", help="Repeatable; SI units.")
@click.option("--prior", "priors", multiple=True, metavar="NAME=MEAN:SD", help="What is known before.")
@click.option(
    "--manifest", "manifests", multiple=True, type=click.Path(path_type=Path),
    help="run.toml for logs that carry none, one a pass, in order.",
)  # fmt: skip
@click.option("--priors", "file", type=click.Path(path_type=Path), help="TOML of priors and bounds.")
@click.option(
    "--folds", type=click.Choice(["cell", "field", "direction", "pass"]), default="cell", show_default=True,
    help="What is held out at a time; cell: a field and direction.",
)  # fmt: skip
@click.option("-o", "out", type=click.Path(path_type=Path), default="identified", show_default=True)
@click.option("--require-adequate", is_flag=True, help="Exit with 3 when the held-out verdict is another.")
@common
def identify(
    passes: tuple[Path, ...], free: tuple[str, ...], bounds: tuple[str, ...], priors: tuple[str, ...],
    manifests: tuple[Path, ...], file: Path | None, folds: str, out: Path, require_adequate: bool,
    as_json: bool,
) -> None:  # fmt: skip
    """Estimate parameters from PASSES (logs, raw folders), judged on passes that were not used."""
    from . import console
    from .identify import identify_to_folder, names_of
    from .identify_parameter import WrongUseError
    from .identify_wishes import asked

    if free == ("help",):
        emit({"parameters": names_of(passes[0], *manifests[:1])}, as_json, console.parameter_names)
        return
    try:
        wanted = asked(free, bounds, priors, file)
        document = identify_to_folder(passes, wanted, folds, out, progress, manifests)
    except WrongUseError as error:
        raise click.UsageError(str(error), click.get_current_context()) from None
    emit(document, as_json, console.identified)
    _leave_unless_adequate(require_adequate, document["verdict"]["value"])


@app.command()
@click.argument("campaign", type=click.Path(path_type=Path))
@click.option("-o", "out", type=click.Path(path_type=Path), default="plan", show_default=True)
@click.option("--repeats", "repeats", multiple=True, type=click.IntRange(1), help="Repeats to try.")
@click.option("--pilots", type=click.IntRange(2), default=6, show_default=True, help="Passes a version.")
@click.option("-j", "workers", type=click.IntRange(0), help="Processes [one a core]; 0: in this process.")
@common
def plan(
    campaign: Path, out: Path, repeats: tuple[int, ...], pilots: int, workers: int | None, as_json: bool
) -> None:
    """Forecast a CAMPAIGN plan (TOML, as for synth): each verdict's chance, each parameter's uncertainty."""
    from . import console
    from .planning import REPEATS
    from .planning_report import plan_to_folder

    count = cores() if workers is None else workers
    document = plan_to_folder(campaign, out, repeats or REPEATS, pilots, count, progress)
    emit(document, as_json, console.planned)


def main() -> None:
    """Entry point of `smts-validate`: an error is one line on stderr and an exit status."""
    try:
        with seldom_collected():
            sys.exit(app.main(prog_name="smts-validate", standalone_mode=False))
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.ctx.get_help() if error.ctx else "", err=True)
        sys.exit(WRONG_USE)
    except click.ClickException as error:
        _complain(error.format_message(), error)
        sys.exit(WRONG_USE)
    except (KeyboardInterrupt, click.Abort):
        _complain("interrupted; nothing half-written is left")
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(FAILED)
    except Exception as error:
        if os.environ.get("SMTS_DEBUG"):
            raise
        _complain(describe(error))
        sys.exit(FAILED)
    finally:
        leave_the_rest()


def describe(error: BaseException) -> str:
    """One line for an error: its message, and its class where the message would mean nothing without it."""
    message = " ".join(str(error).split())
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or 'input or output'}: {error.strerror}"
    if type(error) in (ValueError, RuntimeError) or type(error).__module__.startswith("smts_validate"):
        return message or type(error).__name__
    return f"{type(error).__name__}: {message} (unexpected: run again with --debug for the traceback)"


def _complain(message: str, error: click.ClickException | None = None) -> None:
    context = getattr(error, "ctx", None)
    where = context.command_path if context else "smts-validate"
    hint = f" (see `{where} --help`)" if error else ""
    click.echo(f"{where}: error: {' '.join(message.split())}{hint}", err=True)


if __name__ == "__main__":
    main()
