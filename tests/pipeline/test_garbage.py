"""Garbage is looked for seldom while a pass is computed, and as before afterwards."""

from __future__ import annotations

import gc
import subprocess
import sys

import pytest
from smts_validate.pipeline.garbage import seldom_collected


def test_garbage_in_circles_goes_still_and_the_setting_comes_back() -> None:
    before = gc.get_threshold()
    with pytest.raises(ZeroDivisionError), seldom_collected():
        assert gc.isenabled()
        runs = gc.get_stats()[0]["collections"]
        for _ in range(2 * gc.get_threshold()[0]):
            circle: list[object] = []
            circle.append(circle)
        assert gc.get_stats()[0]["collections"] > runs
        raise ZeroDivisionError
    assert gc.get_threshold() == before


def test_a_command_that_ends_leaves_nothing_to_be_searched() -> None:
    code = (
        "import atexit, gc, sys\n"
        "from smts_validate.pipeline import cli\n"
        "atexit.register(lambda: print(gc.get_freeze_count() > 1000, len(gc.get_objects()) < 1000))\n"
        "sys.argv = ['smts-validate', '--version']\n"
        "cli.main()\n"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines()[-1] == "True True"
