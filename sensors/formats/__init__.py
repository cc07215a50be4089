"""Raw formats, one file each. A new one: a module with `reads` and `read`, and its line in FORMATS.

`reads(sensor, path, head)` says whether the format is for a sensor's file, whose first bytes are `head`;
`read(path, sensor, name, date)` returns its samples (`sensors.raw`) or raises RawError. The first that
reads wins.
"""

from __future__ import annotations

from types import ModuleType

from . import gcsv, gnss_csv, imu_csv, nmea, rtklib_pos, sensor_logger, speed_csv, steer_csv, ubx

FORMATS: tuple[ModuleType, ...] = (
    gcsv,
    sensor_logger,
    imu_csv,
    steer_csv,
    speed_csv,
    ubx,
    rtklib_pos,
    gnss_csv,
    nmea,
)
