"""RTKLIB's .pos: solutions in text, `%` before comments and the header."""

from __future__ import annotations

import datetime as dt
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..checks import rows_of
from ..gnss_values import epochs, to_yaw, unix_seconds, utc_of_gps_time
from ..manifest import Gps, Sensor
from ..raw import Floats, RawError, RawGnss
from ..streams import Warn
from ..tables import read_text

if TYPE_CHECKING:
    import pandas as pd

GPS_EPOCH = 315964800.0  # 1980-01-06, Unix s
WEEK = 604800.0
QUALITY = {1.0: 4.0, 2.0: 5.0, 3.0: 2.0, 4.0: 2.0, 5.0: 1.0, 6.0: 2.0}  # RTKLIB's Q -> GGA's
POSITION = ("latitude(deg)", "longitude(deg)", "height(m)")


def reads(sensor: Sensor, path: Path, head: bytes) -> bool:
    """Whether this format is for that sensor's file."""
    del path
    return isinstance(sensor, Gps) and head.lstrip().startswith(b"%")


def read(path: Path, sensor: Sensor, name: str, date: dt.date) -> RawGnss:
    """The solutions of a .pos file; lines that cannot be used are counted and dropped.

    Raises RawError : no header, or positions in another form than degrees.
    """
    del sensor, date
    lines = read_text(path).decode("utf-8", "replace").splitlines()
    header = next((line for line in lines if line.startswith("%") and "Q" in line.split()), None)
    names = header.lstrip("% ").split() if header else []
    if not names or not set(POSITION) <= set(names):
        raise RawError(
            f"{path.name}: no header with {', '.join(POSITION)}; write solutions as lat/lon/height"
        )
    if len(set(names)) < len(names):
        raise RawError(f"{path.name}: two columns of the header have one name")
    numbers = [k for k, line in enumerate(lines, start=1) if line.strip() and not line.startswith("%")]
    cells = [re.split(r"[\s,;]+", lines[k - 1].strip()) for k in numbers]
    width = len(names) + 1  # the time takes two cells
    good = [k for k, row in enumerate(cells) if len(row) == width]
    if not good:
        raise RawError(f"{path.name}: no line has the header's {width} values")
    import pandas as pd  # half a second to import, and few files need it

    frame = pd.DataFrame([cells[k] for k in good], columns=["date", "clock", *names[1:]], dtype=object)
    rows = np.array([numbers[k] for k in good], dtype=np.int64)
    values = {key: _numbers(frame, column) for key, column in _COLUMNS.items() if column in frame}
    gnss = epochs(_utc(frame, names[0]), None, rows, _converted(values, frame), path.name, name)
    warnings = list(gnss.warnings)
    if len(good) < len(cells):
        bad = next(numbers[k] for k, row in enumerate(cells) if len(row) != width)
        warnings.append(
            Warn(f"{rows_of(len(cells) - len(good))} of another length", "dropped", name, path.name, bad)
        )
    if any(line.startswith("%") and "geodetic" in line for line in lines[:40]):
        warnings.append(Warn("heights above the geoid", "taken as ellipsoidal", name, path.name))
    return RawGnss(
        gnss.utc, None, gnss.rows, gnss.values, len(good), len(cells) - len(good), (), tuple(warnings)
    )


_COLUMNS = {
    "lat": "latitude(deg)",
    "lon": "longitude(deg)",
    "alt": "height(m)",
    "quality": "Q",
    "satellites": "ns",
    "sd_north": "sdn(m)",
    "sd_east": "sde(m)",
    "sd_up": "sdu(m)",
}


def _numbers(frame: pd.DataFrame, column: str) -> Floats:
    import pandas as pd

    return np.asarray(pd.to_numeric(frame[column], errors="coerce"), dtype=np.float64)


def _utc(frame: pd.DataFrame, scale: str) -> Floats:
    """Time of each solution; the header's first name says whether it is UTC or GPS time."""
    import pandas as pd

    if "/" in str(frame["date"].iloc[0]):
        moment = pd.to_datetime(
            frame["date"].astype(str) + " " + frame["clock"].astype(str),
            format="%Y/%m/%d %H:%M:%S.%f",
            errors="coerce",
            utc=True,
        )
        time = unix_seconds(moment)
    else:
        time = GPS_EPOCH + WEEK * _numbers(frame, "date") + _numbers(frame, "clock")
    return time if scale.startswith("UTC") else utc_of_gps_time(time)


def _converted(values: dict[str, Floats], frame: pd.DataFrame) -> dict[str, Floats]:
    """Qualities as GGA counts them; speed and course where velocities were written."""
    quality = values.get("quality")
    if quality is not None:
        values["quality"] = np.array([QUALITY.get(q, 0.0) for q in quality.tolist()])
    if {"vn(m/s)", "ve(m/s)"} <= set(frame.columns):
        north, east = _numbers(frame, "vn(m/s)"), _numbers(frame, "ve(m/s)")
        values["speed"] = np.hypot(north, east)
        compass = np.degrees(np.arctan2(east, north))
        values["course"] = np.where(values["speed"] > 0.0, to_yaw(compass), np.nan)
    return values
