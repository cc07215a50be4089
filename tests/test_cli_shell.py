"""The command line as a shell sees it: start-up, help, errors, exit codes, completion."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = ("numpy", "pandas", "scipy", "matplotlib", "numba", "pyarrow")
COMMAND = [sys.executable, "-m", "smts_validate.pipeline.cli"]


def smts(*words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **variables}
    return subprocess.run(
        [*COMMAND, *words], capture_output=True, text=True, timeout=120, env=environment, check=False
    )


def commands() -> list[str]:
    lines = smts("--help").stdout.split("Commands:")[1].splitlines()
    return [line.split()[0] for line in lines if line.startswith("  ") and line.strip()]


def test_help_lists_the_commands_and_exits_with_zero() -> None:
    ran = smts("--help")
    assert ran.returncode == 0
    for name in ("ingest", "inspect", "run", "batch"):
        assert f"\n  {name} " in ran.stdout


def test_help_imports_none_of_the_heavy_packages() -> None:
    code = (
        "import sys; sys.argv = ['smts-validate', '--help']\n"
        "from smts_validate.pipeline.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        f"print('heavy:', [name for name in {HEAVY} if name in sys.modules])"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert ran.stdout.splitlines()[-1] == "heavy: []"


def test_every_command_has_help_json_and_debug() -> None:
    found = commands()
    assert len(found) >= 4
    for name in found:
        ran = smts(name, "--help")
        assert ran.returncode == 0, ran.stderr
        assert "--json" in ran.stdout, name
        assert "--debug" in ran.stdout, name


@pytest.mark.parametrize(
    "words",
    [("--nonsense",), ("run",), ("run", "a", "--nonsense"), ("nonsense",), ("batch", "a", "-j", "-1")],
    ids=" ".join,
)
def test_wrong_use_is_one_line_on_stderr_and_exits_with_two(words: tuple[str, ...]) -> None:
    ran = smts(*words)
    assert ran.returncode == 2
    assert ran.stdout == ""
    assert len(ran.stderr.splitlines()) == 1
    assert "--help" in ran.stderr


def test_no_command_at_all_shows_the_help_and_counts_as_wrong_use() -> None:
    ran = smts()
    assert ran.returncode == 2
    assert "Commands:" in ran.stderr


@pytest.mark.parametrize("command", ["run", "inspect", "report", "batch"])
def test_a_path_that_is_not_there_is_one_line_that_names_it_and_exits_with_one(
    command: str, tmp_path: Path
) -> None:
    ran = smts(command, str(tmp_path / "absent"))
    assert ran.returncode == 1
    assert len(ran.stderr.splitlines()) == 1
    assert "absent" in ran.stderr
    assert "Traceback" not in ran.stderr


def test_debug_shows_where_an_error_comes_from(tmp_path: Path) -> None:
    ran = smts("run", str(tmp_path / "absent"), "--debug")
    assert ran.returncode == 1
    assert "Traceback" in ran.stderr


def test_the_version_is_that_of_the_installed_package() -> None:
    from importlib.metadata import version

    assert smts("--version").stdout.split()[-1] == version("smts-validate")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_scripts_are_made_for_the_usual_shells(shell: str) -> None:
    ran = smts(_SMTS_VALIDATE_COMPLETE=f"{shell}_source")
    assert ran.returncode == 0
    assert "smts-validate" in ran.stdout


def test_completion_offers_commands_and_options() -> None:
    ran = smts(_SMTS_VALIDATE_COMPLETE="bash_complete", COMP_WORDS="smts-validate in", COMP_CWORD="1")
    assert {line.split(",")[-1] for line in ran.stdout.split()} >= {"ingest", "inspect"}
    ran = smts(_SMTS_VALIDATE_COMPLETE="bash_complete", COMP_WORDS="smts-validate run --req", COMP_CWORD="2")
    assert "--require-adequate" in ran.stdout


def test_a_reader_that_leaves_early_is_no_reason_for_a_traceback() -> None:
    shell = f"'{sys.executable}' -m smts_validate.pipeline.cli --help | true"
    ran = subprocess.run(["sh", "-c", shell], capture_output=True, text=True, timeout=60, check=False)
    assert "Traceback" not in ran.stderr
