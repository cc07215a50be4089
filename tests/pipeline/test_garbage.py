"""Garbage is looked for seldom while a pass is computed, and as before afterwards."""

from __future__ import annotations

import gc

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
