"""Compiled code on disk never outlives the sources that it was made from."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from smts_validate.model.fresh import drop_stale

CALLEE = """from numba import njit

@njit(cache=True)
def size(x):
    return {value} * x
"""
CALLER = """from numba import njit
from .callee import size

@njit(cache=True)
def total(x):
    return size(x) + 1.0
"""
PACKAGE = """from pathlib import Path
from smts_validate.model.fresh import drop_stale

drop_stale(Path(__file__).parent)
"""


def total(folder: Path) -> float:
    """What a fresh process computes with the package."""
    code = "from kernels.caller import total; print(total(2.0))"
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | {
        "PYTHONPATH": str(folder)
    }
    inherited = os.environ.get("PYTHONPATH")
    if inherited:
        environment["PYTHONPATH"] += os.pathsep + inherited
    ran = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    return float(ran.stdout)


def test_a_change_in_the_file_of_a_called_kernel_reaches_its_callers(tmp_path: Path) -> None:
    package = tmp_path / "kernels"
    package.mkdir()
    (package / "__init__.py").write_text(PACKAGE)
    (package / "caller.py").write_text(CALLER)
    (package / "callee.py").write_text(CALLEE.format(value="3.0"))
    assert total(tmp_path) == 7.0
    (package / "callee.py").write_text(CALLEE.format(value="50.0"))
    assert total(tmp_path) == 101.0  # numba alone would say 7 again


def test_code_that_is_up_to_date_is_kept(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("a = 1\n")
    drop_stale(tmp_path)
    kept = tmp_path / "__pycache__" / "a.total-1.py311.nbi"
    kept.write_text("")
    drop_stale(tmp_path)
    assert kept.exists()
    (tmp_path / "b.py").write_text("b = 1\n")
    drop_stale(tmp_path)
    assert not kept.exists()
    assert len(list((tmp_path / "__pycache__").glob("sources-*"))) == 1
