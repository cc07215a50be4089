"""Do the readings fit the manifest? Gravity against mounting, spin against speed, clock against clock.

Where they do not, the likely cause is told: what in run.toml would make them fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .formats.speed_csv import SPEED_UNITS, TURN_UNITS
from .manifest import GRAVITY, Imd, Machine, Manifest, Speed, Wds
from .mounting import rotation_matrix, to_body
from .streams import Floats, GnssStream, ImuStream, SpeedStream, SteerStream, Stream
from .turning import TO_DEGREES, TO_RADIANS, turning_ratio, unit_hints

TILTED = 20.0  # deg: no slope, so a wrong mounting
MISMATCH = 0.15  # of gravity or of a wheel's radius
LIKENESS = 0.3  # so near must a ratio be to that of two units
SPINNING = 0.5  # rad/s
DRIVING = 0.5  # m/s
ON_AXLE = 0.9  # share of a turning wheel's rotation that must be about its axle
GRID = 0.02  # s
LONGEST = 900.0  # s, of the middle of two recordings: more would only cost time
FARTHEST = 1.0  # s: larger offsets between clocks are not looked for
ALIKE = 0.8  # correlation from which an offset means something
OFF = 0.15  # s: a worse offset between two streams is worth telling
OFF_GNSS = 0.3  # s: nothing that a receiver's unknown latency explains
STEERED = 0.02  # rad/s: a pass that turns less says nothing of the steering sensor
STEER_FACTOR = 2.0  # by which a steering angle may differ from what the turning needs
DEGREES = 180.0 / np.pi
UPRIGHT = ((0, 0), (180, 0), (90, 0), (-90, 0), (0, 90), (0, -90))  # roll, pitch


@dataclass(frozen=True)
class Finding:
    """Figures about one sensor, and what they suggest is wrong."""

    facts: Mapping[str, Any]
    hints: tuple[str, ...] = ()


def findings(manifest: Manifest, streams: Mapping[str, Stream]) -> dict[str, Finding]:
    """What the readings say about each inertial unit, by its name."""
    found = {}
    for name, stream in streams.items():
        sensor = manifest.sensors.get(name)
        if isinstance(stream, ImuStream) and stream.t.size > 1:
            if isinstance(sensor, Imd):
                parts = (_gravity(stream, sensor), _gyro_unit(manifest, stream, sensor, streams))
                found[name] = _joined(*parts, _same_body(manifest, streams, name))
            elif isinstance(sensor, Wds):
                found[name] = _wheel(stream, sensor, manifest.machine, streams)
        elif isinstance(stream, SpeedStream) and isinstance(sensor, Speed) and stream.t.size > 1:
            found[name] = _speed(stream, sensor, manifest.machine, streams)
        elif isinstance(stream, SteerStream) and stream.t.size > 1:
            found[name] = _steering(manifest, stream, streams)
    return found | _latency(manifest, found)


def _latency(manifest: Manifest, found: Mapping[str, Finding]) -> dict[str, Finding]:
    """The receiver's least latency that makes wheels' spin and speed over ground agree in time."""
    name, receiver = next(iter(manifest.of_kind("gps").items()))
    checks = [finding.facts.get("clock_check", {}) for finding in found.values()]
    spun = [c for c in checks if c.get("by") == "spin"]  # a bus's speed is late itself
    late = [c["offset_s"] for c in spun if c["correlation"] > ALIKE]
    if not late:
        return {}
    return {name: Finding({"latency_by_wheels_s": float(receiver.latency - np.median(late))})}


def _joined(*parts: Finding) -> Finding:
    facts = {key: value for part in parts for key, value in part.facts.items()}
    return Finding(facts, tuple(hint for part in parts for hint in part.hints))


def _gravity(stream: ImuStream, sensor: Imd) -> Finding:
    """Mean specific force of a unit on a body: 9.8 m/s² upward, but for slopes."""
    force, _ = to_body(stream, sensor)
    mean = force.mean(axis=0)
    size = float(np.linalg.norm(mean))
    tilt = float(np.degrees(np.arccos(np.clip(mean[2] / size, -1.0, 1.0)))) if size > 0.0 else 0.0
    hints = _unit_hints(size)
    if not hints and tilt > TILTED:
        hints = (_mounting_hint(stream.specific_force.mean(axis=0), tilt),)
    return Finding({"gravity_m_s2": size, "tilt_deg": tilt}, hints)


def _unit_hints(size: float) -> tuple[str, ...]:
    for unit, scale, cure in (
        ("g", 1.0 / GRAVITY, 'set units = { accel = "g" }'),
        ("mg", 1.0e3 / GRAVITY, "convert them to m/s²"),
        ("m/s² taken for g", GRAVITY, 'remove accel = "g" from units'),
    ):
        if abs(size / (GRAVITY * scale) - 1.0) < MISMATCH:
            return (f"accelerations look like {unit}: {cure}",)
    if abs(size / GRAVITY - 1.0) > MISMATCH:
        return (f"mean specific force is {size:.2f} m/s², not {GRAVITY:.2f}: check units and calibration",)
    return ()


def _gyro_unit(manifest: Manifest, stream: ImuStream, sensor: Imd, streams: Mapping[str, Stream]) -> Finding:
    """A body's gyro against the course of the receiver on the tractor: the ratio of their turning."""
    against = next((name for name, gps in manifest.of_kind("gps").items() if gps.body == "tractor"), "")
    gnss = streams.get(against)
    seeder, late = manifest.machine.seeder, 0.0
    if sensor.body == "seeder" and seeder is not None:
        late = (seeder.hitch_to_com + float(np.mean(seeder.axles))) / manifest.operating.speed
    yaw_rate = to_body(stream, sensor)[1][:, 2]
    drove, ratio = False, None
    if isinstance(gnss, GnssStream):
        drove, ratio = turning_ratio(stream.t, yaw_rate, gnss, late)
    hints = unit_hints(drove, ratio, stream.angular_velocity, sensor.units.gyro == "deg/s")
    return Finding({"turning_check": {"against": against, "ratio": ratio}}, hints)


def best_upright(mean: Floats) -> tuple[int, int]:
    """Roll and pitch (deg, quarter turns) of the mounting that puts the mean specific force upward."""
    radians = np.radians(UPRIGHT)
    upward = [float((rotation_matrix(roll, pitch, 0.0) @ mean)[2]) for roll, pitch in radians.tolist()]
    return UPRIGHT[int(np.argmax(upward))]


def _mounting_hint(mean: Floats, tilt: float) -> str:
    axis = int(np.argmax(np.abs(mean)))
    sign = "+" if mean[axis] > 0.0 else "-"
    roll, pitch = best_upright(mean)
    return (
        f"gravity is {tilt:.0f}° off the body's vertical, along the sensor's {sign}{'xyz'[axis]}: "
        f"rotation_deg = [{roll}, {pitch}, yaw] would fit"
    )


def _same_body(manifest: Manifest, streams: Mapping[str, Stream], name: str) -> Finding:
    """Offset of a unit's clock against the first unit on the same body, by their yaw rates."""
    units: dict[str, Imd] = manifest.of_kind("imd")
    first = next((key for key, imd in units.items() if imd.body == units[name].body), name)
    reference, stream = streams.get(first), streams[name]
    if first == name or not isinstance(reference, ImuStream) or not isinstance(stream, ImuStream):
        return Finding({"clock_offset": None})
    mine = to_body(stream, units[name])[1][:, 2]
    theirs = to_body(reference, units[first])[1][:, 2]
    return _offset(first, "yaw rate", stream.t, mine, reference.t, theirs)


def _offset(
    against: str, of: str, t: Floats, x: Floats, t_ref: Floats, x_ref: Floats, off: float = OFF
) -> Finding:
    lag, alike = time_offset(t, x, t_ref, x_ref)
    facts: dict[str, Any] = {
        "clock_check": {"against": against, "by": of, "offset_s": lag, "correlation": alike}
    }
    if abs(alike) > ALIKE:
        facts["clock_offset"] = f"{1.0e3 * lag:+.0f} ms to {against}"
    if alike > ALIKE and abs(lag) > off:
        return Finding(facts, (f"its {of} comes {lag:.2f} s after that of {against}: check the clocks",))
    if alike < -ALIKE:
        return Finding(facts, (f"its {of} is opposite to that of {against}: check rotation_deg",))
    return Finding(facts)


def time_offset(t: Floats, x: Floats, t_ref: Floats, x_ref: Floats) -> tuple[float, float]:
    """By how much x(t) lags behind x_ref (s), at the strongest correlation of either sign, and that one.

    (0, 0) where the recordings have too little in common.
    """
    start, stop = max(t[0], t_ref[0]), min(t[-1], t_ref[-1])
    if stop - start < 4.0 * FARTHEST:
        return 0.0, 0.0
    spare = max(0.5 * (stop - start - LONGEST), 0.0)
    grid = np.arange(start + spare, stop - spare, GRID)
    a, b = np.interp(grid, t, x), np.interp(grid, t_ref, x_ref)
    reach = round(FARTHEST / GRID)
    scores = _correlations(a, b[reach:-reach])
    best = int(np.argmax(np.abs(scores)))
    move = 0.0
    if 0 < best < scores.size - 1:
        before, here, after = scores[best - 1 : best + 2] * np.sign(scores[best])
        bend = before - 2.0 * here + after
        move = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float((best - reach + move) * GRID), float(scores[best])


def _correlations(long: Floats, short: Floats) -> Floats:
    """Correlation coefficient of `short` (M,) with each window of its length in `long` (N,): (N - M + 1,)."""
    centred, even = short - short.mean(), long - long.mean()
    from scipy.signal import correlate  # late: half a second that only a pass's own reading needs

    products = correlate(even, centred, mode="valid", method="fft")
    sums, squares = (np.concatenate([[0.0], np.cumsum(v)]) for v in (even, even**2))
    total, power = sums[short.size :] - sums[: -short.size], squares[short.size :] - squares[: -short.size]
    scatter = np.maximum(power - total**2 / short.size, 0.0) * float(np.sum(centred**2))
    floor = 1.0e-18 * float(squares[-1]) * float(np.sum(centred**2))  # what rounding leaves of a constant
    return np.asarray(np.where(scatter > floor, products / np.sqrt(np.maximum(scatter, 1.0e-300)), 0.0))


def _wheel(stream: ImuStream, sensor: Wds, machine: Machine, streams: Mapping[str, Stream]) -> Finding:
    """A wheel's unit: how much of its rotation is about the axle, and the radius that the speed implies."""
    _, turn = to_body(stream, sensor)
    size = np.linalg.norm(turn, axis=1)
    turning = size > SPINNING
    gnss = next((s for s in streams.values() if isinstance(s, GnssStream)), None)
    if np.count_nonzero(turning) < 100:
        return Finding({"share_on_axle": None}, _slow_spin(stream.t, size, sensor, machine, gnss))
    share = float((turn[turning, 1] ** 2).sum() / (size[turning] ** 2).sum())
    facts: dict[str, Any] = {"share_on_axle": share}
    if share < ON_AXLE:
        axis = int(np.argmax((stream.angular_velocity[turning] ** 2).sum(axis=0)))
        about = f"{100.0 * share:.0f} % of its rotation is about the axle"
        hint = f"only {about}, most about the sensor's {'xyz'[axis]}"
        return Finding(facts, (f"{hint}: check rotation_deg",))
    return _joined(Finding(facts), _rolling(stream.t, turn[:, 1], sensor, machine, gnss))


def _rolling(t: Floats, spin: Floats, sensor: Wds, machine: Machine, gnss: GnssStream | None) -> Finding:
    """Spin against the speed over ground."""
    if gnss is None or np.count_nonzero(gnss.speed > DRIVING) < 20:
        return Finding({})
    known = np.isfinite(gnss.speed)
    at, speed = gnss.t[known], gnss.speed[known]
    turning = np.interp(at, t, spin)
    driving = (speed > DRIVING) & (np.abs(turning) > SPINNING) & (at > t[0]) & (at < t[-1])
    if np.count_nonzero(driving) < 20:
        return Finding({})
    radius, stated = float(np.median(speed[driving] / turning[driving])), _radius(sensor, machine)
    part = _offset("gps", "spin", t, np.abs(spin), at, speed, OFF_GNSS)
    return _joined(Finding({"rolling_radius_m": radius}, _radius_hints(radius, stated)), part)


def _slow_spin(
    t: Floats, spin: Floats, sensor: Wds, machine: Machine, gnss: GnssStream | None
) -> tuple[str, ...]:
    """Whether a wheel that hardly turns while the machine drives does so by a factor of 180/pi."""
    if gnss is None or np.count_nonzero(gnss.speed > DRIVING) < 20:
        return ()
    driving = (gnss.speed > DRIVING) & (gnss.t > t[0]) & (gnss.t < t[-1])
    share = np.interp(gnss.t[driving], t, spin) * _radius(sensor, machine) / gnss.speed[driving]
    fits = share.size >= 20 and abs(float(np.median(share)) * DEGREES - 1.0) < LIKENESS
    return (TO_RADIANS,) if fits else ()


def _radius(sensor: Wds, machine: Machine) -> float:
    """Stated rolling radius of a sensor's wheel, m."""
    tractor = machine.tractor
    return tractor.front_wheel_radius if sensor.wheel.startswith("front") else tractor.rear_wheel_radius


def _speed(stream: SpeedStream, sensor: Speed, machine: Machine, streams: Mapping[str, Stream]) -> Finding:
    """A bus's speed against the speed over ground: their ratio, and by how much it is late."""
    gnss = next((s for s in streams.values() if isinstance(s, GnssStream)), None)
    if gnss is None:
        return Finding({})
    known = np.isfinite(gnss.speed) & (gnss.t > stream.t[0]) & (gnss.t < stream.t[-1])
    at, speed = gnss.t[known], gnss.speed[known]
    told = np.abs(np.interp(at, stream.t, stream.speed))
    driving = (speed > DRIVING) & (told > 0.0)
    if np.count_nonzero(driving) < 20:
        return Finding({})
    ratio = float(np.median(told[driving] / speed[driving]))
    part = _offset("gps", "speed", stream.t, np.abs(stream.speed), at, speed, OFF_GNSS)
    return _joined(Finding({"speed_ratio": ratio}, _speed_hints(ratio, sensor, machine)), part)


def _speed_hints(ratio: float, sensor: Speed, machine: Machine) -> tuple[str, ...]:
    """The unit that would make a speed fit. ratio : of what was read, in the stated unit, to the true speed."""
    if abs(ratio - 1.0) < MISMATCH:
        return ()
    front = sensor.wheel is not None and sensor.wheel.startswith("front")
    radius = machine.tractor.front_wheel_radius if front else machine.tractor.rear_wheel_radius
    sizes = SPEED_UNITS | {unit: size * radius for unit, size in TURN_UNITS.items()}
    fits = {unit: abs(sizes[sensor.units.speed] / ratio / size - 1.0) for unit, size in sizes.items()}
    best = min(fits, key=lambda unit: fits[unit])
    if fits[best] < MISMATCH:
        return (f'its speeds look like {best}, not {sensor.units.speed}: set units = {{ speed = "{best}" }}',)
    return (f"it reads {ratio:.2f} times the speed over ground: check its column, units and wheel",)


def _steering(manifest: Manifest, stream: SteerStream, streams: Mapping[str, Stream]) -> Finding:
    """The steering angle against the turning that it explains, yaw rate = speed·angle/wheelbase."""
    gnss = next((s for s in streams.values() if isinstance(s, GnssStream)), None)
    units: dict[str, Imd] = manifest.of_kind("imd")
    name = next(key for key, imd in units.items() if imd.body == "tractor")
    unit = streams.get(name)
    known = np.isfinite(gnss.speed) if gnss is not None else np.zeros(0, dtype=np.bool_)
    if gnss is None or known.sum() < 20 or not isinstance(unit, ImuStream) or unit.t.size < 2:
        return Finding({})
    tractor = manifest.machine.tractor
    speed = np.interp(stream.t, gnss.t[known], gnss.speed[known])
    expected = speed * stream.angle / (tractor.front_axle + tractor.rear_axle)
    turning = to_body(unit, units[name])[1][:, 2]
    there = np.interp(stream.t, unit.t, turning)
    if there.std() < STEERED:
        return Finding({"steering_ratio": None})
    part = _offset(name, "steering", stream.t, expected, unit.t, turning, OFF_GNSS)
    alike = float(part.facts["clock_check"]["correlation"])
    if abs(alike) < ALIKE:
        return part
    ratio = float(expected.std() / there.std())
    if alike < 0.0:
        part = Finding(part.facts, ("its angle is opposite to the turning: it must be positive to the left",))
    return _joined(part, Finding({"steering_ratio": ratio}, _steer_hints(ratio)))


def _steer_hints(ratio: float) -> tuple[str, ...]:
    if abs(ratio / DEGREES - 1.0) < LIKENESS:
        return ('its angles look like degrees: set units = { angle = "deg" }',)
    if abs(ratio * DEGREES - 1.0) < LIKENESS:
        return ('its angles look like radians: remove angle = "deg" from units',)
    if not 1.0 / STEER_FACTOR < ratio < STEER_FACTOR:
        what = f"its angle is {ratio:.2g} times what the turning needs"
        return (f"{what}: perhaps the steering wheel's or one sensor's, not the front wheels'",)
    return ()


def _radius_hints(radius: float, stated: float) -> tuple[str, ...]:
    if abs(radius / stated * DEGREES - 1.0) < LIKENESS:
        return (TO_DEGREES,)
    if abs(abs(radius) / stated - 1.0) > MISMATCH:
        return (
            f"speed and spin imply a rolling radius of {abs(radius):.2f} m, run.toml says {stated:.2f} m",
        )
    if radius < 0.0:
        return ("turns backwards while the machine drives: rotation_deg is off by 180°, unless it reversed",)
    return ()
