"""Geodetic coordinates and the local East-North-Up plane; lines in it. The only importer of pymap3d."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pymap3d
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


class Place(Protocol):
    """Anything with lat, lon in degrees and ellipsoidal alt in m."""

    @property
    def lat(self) -> float: ...
    @property
    def lon(self) -> float: ...
    @property
    def alt(self) -> float: ...


def _own(values: ArrayLike) -> Floats:
    """A fresh copy: some of pymap3d's functions change the caller's arrays."""
    return np.array(values, dtype=np.float64)


def to_enu(lat: ArrayLike, lon: ArrayLike, alt: ArrayLike, origin: Place) -> tuple[Floats, Floats, Floats]:
    """East, north, up (m) of WGS-84 positions in the tangent plane at `origin`; NaN stays NaN."""
    found = pymap3d.geodetic2enu(_own(lat), _own(lon), _own(alt), origin.lat, origin.lon, origin.alt)
    e, n, u = (np.asarray(length, dtype=np.float64) for length in found)
    return e, n, u


def to_geodetic(e: ArrayLike, n: ArrayLike, u: ArrayLike, origin: Place) -> tuple[Floats, Floats, Floats]:
    """Latitude, longitude (degrees), ellipsoidal altitude (m) of ENU coordinates; inverse of `to_enu`."""
    lat, lon, alt = pymap3d.enu2geodetic(_own(e), _own(n), _own(u), origin.lat, origin.lon, origin.alt)
    return (
        np.asarray(lat, dtype=np.float64),
        np.asarray(lon, dtype=np.float64),
        np.asarray(alt, dtype=np.float64),
    )


@dataclass(frozen=True)
class Line:
    """A straight line in the plane, travelled from a to b: (2,) each, m, ENU.

    Raises ValueError when a and b are not two distinct finite points.
    """

    a: Floats
    b: Floats

    def __post_init__(self) -> None:
        for name in ("a", "b"):
            point = np.array(getattr(self, name), dtype=np.float64)
            point.flags.writeable = False
            object.__setattr__(self, name, point)
        if self.a.shape != (2,) or self.b.shape != (2,) or not self.length > 0.0:
            raise ValueError("a line needs two distinct finite points of the plane")

    @property
    def length(self) -> float:
        """Distance from a to b, m."""
        return float(math.dist(self.a, self.b))

    @property
    def direction(self) -> Floats:
        """Unit vector from a to b, (2,)."""
        return np.asarray((self.b - self.a) / self.length)

    @property
    def heading(self) -> float:
        """Direction of travel, rad counter-clockwise from East."""
        return math.atan2(self.b[1] - self.a[1], self.b[0] - self.a[0])

    def project(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Path coordinates of points: s along the line from a, n to its left, m."""
        east, north = self.direction
        dx, dy = np.asarray(x) - self.a[0], np.asarray(y) - self.a[1]
        return np.asarray(dx * east + dy * north), np.asarray(dy * east - dx * north)
