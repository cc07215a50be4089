"""What follows the measurement: fusion, replay, comparison, verdict, reports, and the shell around them."""

from pathlib import Path

from ..model.fresh import drop_stale

drop_stale(Path(__file__).parent)
