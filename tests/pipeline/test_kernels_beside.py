"""Compiling in several processes at once: everything once, nothing twice, nobody left behind."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from kernels_toy import FOLDER, MAIN, die_in_helpers, leave_a_file, take_forever
from smts_validate.pipeline import kernels_beside as beside
from smts_validate.pipeline.kernel_groups import GROUPS
from smts_validate.pipeline.kernels_beside import kernels_beside, on_disk

KERNELS = [f"model/toy.kernel{number}" for number in range(6)]
SAMPLE = Path(__file__).parents[2] / "data_samples" / "field1"
COMPILE = "from smts_validate.pipeline import kernel_groups as g\nfor one in g.GROUPS: g.compile_group(one)"
RUN = """
import sys, tempfile
from pathlib import Path
from numba.core.dispatcher import Dispatcher
from smts_validate.pipeline.run import compute
with tempfile.TemporaryDirectory() as out:
    compute(Path(sys.argv[1]), Path(out) / "result")
kernels = {
    id(kernel): kernel for name, module in list(sys.modules.items()) if name.startswith("smts_validate.")
    for kernel in vars(module).values() if isinstance(kernel, Dispatcher)
}
for kernel in kernels.values():
    stats = kernel.stats
    print(kernel.__name__, sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
"""


@pytest.fixture(autouse=True)
def empty_cache(tmp_path, monkeypatch):
    """A cache of numba's with nothing in it, three cores, and a folder for the files of toy work."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv(FOLDER, str(tmp_path))
    monkeypatch.setenv(MAIN, str(os.getpid()))
    monkeypatch.setenv(beside.QUIET, "1")
    monkeypatch.setattr(beside, "cores", lambda: 3)


def done(folder):
    """What toy work was done, and by which processes."""
    files = [path.name.rsplit("-", 1) for path in folder.glob("toy.*")]
    return sorted(name for name, _ in files), {int(process) for _, process in files}


def test_helpers_and_the_command_share_the_kernels_and_do_each_once(tmp_path):
    with kernels_beside(KERNELS, leave_a_file) as compiled:
        compiled()
        names, processes = done(tmp_path)
    assert names == sorted(kernel.rsplit("/", 1)[1] for kernel in KERNELS)
    assert len(processes) == 3
    assert os.getpid() in processes


def test_what_is_on_disk_is_not_compiled_again(tmp_path):
    version = f"py{sys.version_info[0]}{sys.version_info[1]}"
    (tmp_path / "cache" / "model_0").mkdir(parents=True)
    for number in range(4):
        (tmp_path / "cache" / "model_0" / f"toy.kernel{number}-7.{version}.nbi").touch()
    with kernels_beside(KERNELS, leave_a_file) as compiled:
        compiled()
    assert done(tmp_path)[0] == ["toy.kernel4", "toy.kernel5"]


@pytest.mark.parametrize(("cores", "kernels"), [(1, KERNELS), (3, []), (3, KERNELS[:1])])
def test_with_nothing_to_share_no_process_is_started(tmp_path, monkeypatch, cores, kernels):
    monkeypatch.setattr(beside, "cores", lambda: cores)
    monkeypatch.setattr(beside, "WorkerSlots", None)
    with kernels_beside(kernels, leave_a_file) as compiled:
        compiled()
    names, processes = done(tmp_path)
    assert len(names) == len(kernels)
    assert processes <= {os.getpid()}


def test_where_numba_compiles_nothing_nothing_is_absent(monkeypatch):
    assert beside.absent(KERNELS) == KERNELS
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    assert beside.absent(KERNELS) == []


def test_helpers_that_are_killed_do_not_hold_the_command_up(tmp_path):
    with kernels_beside(KERNELS, die_in_helpers) as compiled:
        compiled()
    assert done(tmp_path)[1] == {os.getpid()}


def test_an_interrupted_command_leaves_no_helper_behind(tmp_path):
    def interrupted():
        with kernels_beside(KERNELS, take_forever):
            deadline = time.monotonic() + 60.0
            while len(done(tmp_path)[1]) < 2 and time.monotonic() < deadline:
                time.sleep(0.02)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    helpers = done(tmp_path)[1]
    assert len(helpers) == 2
    for helper in helpers:
        with pytest.raises(ProcessLookupError):
            os.kill(helper, 0)


def test_beside_a_package_that_cannot_be_written_the_users_cache_is_looked_at(tmp_path, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(beside, "PACKAGE", tmp_path / "package")
    monkeypatch.setattr(beside.os, "access", lambda path, mode: False)
    kept = tmp_path / "numba" / "model_0"
    kept.mkdir(parents=True)
    assert not on_disk(KERNELS[0])
    (kept / f"toy.kernel0-7.py{sys.version_info[0]}{sys.version_info[1]}.nbi").touch()
    assert on_disk(KERNELS[0])


@pytest.mark.slow
def test_after_the_groups_are_compiled_another_process_compiles_nothing_for_a_pass():
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run([sys.executable, "-c", COMPILE], check=True, env=environment)
    assert all(on_disk(kernel) for kernel in GROUPS)
    run = subprocess.run(
        [sys.executable, "-c", RUN, str(SAMPLE)], check=True, env=environment, capture_output=True, text=True
    )
    used = {name: (int(hits), int(misses)) for name, hits, misses in map(str.split, run.stdout.splitlines())}
    assert {name: misses for name, (_, misses) in used.items() if misses} == {}
    assert all(used[kernel.rsplit(".", 1)[1]][0] for kernel in GROUPS)
