"""Wheel-mounted inertial units: phase, spin, the wheel's yaw rate, and the front wheels' steering angle.

`wheel_motion` turns one unit's stream into its wheel's motion (method: wheel_phase.py, wheel_yaw.py),
`steer_from_wheels` the front wheels' yaw rates into a steering angle, `choose_steer_input` picks the series
that may drive the replay. How each is made, what it may and may not touch, and how large its error is:
docs/method-wheels.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from ..sensors.manifest import Imd, Machine, Steer, Tractor, Wds
from ..sensors.mounting import mounting_matrix, to_body
from ..sensors.streams import FieldLog, ImuStream, SteerStream, StreamError, Warn, WheelStream
from .fusion.motion import SteerInput
from .wheel_phase import estimate_phase
from .wheel_series import Floats
from .wheel_spin import hub_spin
from .wheel_steer import TurnedWheel, WheelSteer, sensor_angle, steering_angle
from .wheel_unit import ACCEL_SCALES, GYRO_SCALES, Bools, Doubt, Unit, trusted
from .wheel_yaw import estimate_yaw_rate

__all__ = [
    "Carrier",
    "WheelMotion",
    "WheelSteer",
    "carriers",
    "choose_steer_input",
    "steer_from_sensor",
    "steer_from_wheels",
    "wheel_motion",
    "wheel_motions",
]

LEAST_SAMPLES = 200  # two seconds: less says nothing of phase, bias and noise
SHARE = 0.05  # of a unit's axis in a wheel's axis, from which its bad samples count there
GAP = 0.06  # s, of the body's unit, that may be bridged by a line
COVERAGE = 0.95  # share of the grid that a steering sensor covers to be preferred to the wheels
QUIETEST = 0.03  # deg: noise of a steering sensor whose noise nobody states
LEAST_COVERAGE = 0.5  # below, a series is none


@dataclass(frozen=True)
class Carrier:
    """Angular velocity (M, 3) [rad/s] of the body that carries the wheels, along its own axes, at t (M,)
    [s, UTC].
    """

    t: Floats
    angular_velocity: Floats

    def at(self, t: Floats) -> Floats:
        """Interpolated to other instants, (N, 3)."""
        return np.column_stack([np.interp(t, self.t, axis) for axis in self.angular_velocity.T])

    def covers(self, t: Floats) -> Bools:
        """Which instants lie between two neighbouring samples, (N,): not in a gap of more than `GAP`
        seconds.
        """
        after = np.clip(np.searchsorted(self.t, t), 1, self.t.size - 1)
        inside = (t >= self.t[0]) & (t <= self.t[-1])
        return np.asarray(inside & (self.t[after] - self.t[after - 1] < GAP))


@dataclass(frozen=True)
class WheelMotion:
    """Motion of one wheel from its unit, at the unit's own instants t (N,) [s, UTC].

    phase, phase_sd : rad, unwrapped, positive rolling forward, 0 where the unit's frame is the wheel's
    spin, spin_sd : rad/s; times the effective radius it is the speed of the hub along the wheel's heading
    yaw_rate, yaw_rate_sd : rad/s, of the wheel's heading, smoothed; roll_rate : rad/s, of the hub
    turned, turned_variance : rad and rad², the unsmoothed yaw rate's integral from the first sample and how
    its
        variance grows
    rest : standing still; calibration : constants of the unit with standard deviations, for the report
    """

    name: str
    wheel: str
    t: Floats
    phase: Floats
    phase_sd: Floats
    spin: Floats
    spin_sd: Floats
    yaw_rate: Floats
    yaw_rate_sd: Floats
    roll_rate: Floats
    turned: Floats
    turned_variance: Floats
    rest: Bools
    calibration: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    warnings: tuple[Warn, ...] = ()

    @property
    def front(self) -> bool:
        return self.wheel.startswith("front")

    def turning(self) -> WheelMotion:
        """The same wheel with only what the steering and the report need: of an hour the rest is 20 MB."""
        none = np.empty(0)
        return replace(
            self, phase=none, phase_sd=none, spin=none, spin_sd=none, yaw_rate=none, yaw_rate_sd=none,
            roll_rate=none,
        )  # fmt: skip


CONSTANTS = (
    "gyro_bias_axle", "gyro_scale_axle", "axle_tilt",
    "accel_bias_x", "accel_bias_z", "offset_error_x", "offset_error_z", "accel_scale",
)  # fmt: skip
YAW_CONSTANTS = ("gyro_bias_x", "gyro_bias_z", "tilt_x", "tilt_z", "roll_leak", "pitch_leak")


def wheel_motion(
    stream: WheelStream,
    sensor: Wds,
    radius: float,
    carrier: Carrier | None = None,
    doubt: Doubt | None = None,
) -> WheelMotion:
    """Phase, spin and yaw rate of the wheel that carries a unit.

    radius : m, about the rolling radius (its error matters little: it only scales the vehicle's own
    acceleration that is taken off gravity); carrier : rates of the body, see `Carrier`; without it the
    body's pitching stays in the spin and its rolling hides more of the unit's constants

    Raises StreamError when there are too few samples.
    """
    if stream.t.size < LEAST_SAMPLES:
        few = f"{stream.name}: {stream.t.size} samples are too few to find the wheel's phase"
        raise StreamError(f"{few}; it needs {LEAST_SAMPLES}")
    doubt = _doubt(sensor) if doubt is None else doubt
    unit = _unit(stream, sensor, radius, carrier)
    phase = estimate_phase(unit, doubt)
    yaw = estimate_yaw_rate(unit, phase, doubt)
    spin, spin_sd = hub_spin(unit, phase, yaw, sensor.wheel.startswith("front"))
    calibration = _named(CONSTANTS, phase.constants.value, phase.constants.sd)
    return WheelMotion(
        name=stream.name,
        wheel=sensor.wheel,
        t=stream.t,
        phase=phase.phase,
        phase_sd=phase.phase_sd,
        spin=spin,
        spin_sd=spin_sd,
        yaw_rate=yaw.rate,
        yaw_rate_sd=yaw.rate_sd,
        roll_rate=yaw.roll_rate,
        turned=yaw.turned,
        turned_variance=yaw.turned_variance,
        rest=phase.rest,
        calibration=calibration | _named(YAW_CONSTANTS, yaw.constants.value, yaw.constants.sd),
        warnings=_unused(stream.name, unit.axle_ok & unit.across_ok & unit.plane_ok),
    )


def _unit(stream: WheelStream, sensor: Wds, radius: float, carrier: Carrier | None) -> Unit:
    force, rate = to_body(stream, sensor)
    force_ok = _trusted(stream.specific_force, sensor, ACCEL_SCALES, spikes=False)
    rate_ok = _trusted(stream.angular_velocity, sensor, GYRO_SCALES, spikes=True)
    return Unit(
        t=stream.t - stream.t[0],
        plane=force[:, 2] - 1j * force[:, 0],
        side=force[:, 1],
        axle=rate[:, 1],
        across=rate[:, 2] + 1j * rate[:, 0],
        plane_ok=force_ok[:, 0] & force_ok[:, 2],
        axle_ok=rate_ok[:, 1],
        across_ok=rate_ok[:, 0] & rate_ok[:, 2],
        radius=radius,
        place=complex(sensor.offset[2], -sensor.offset[0]),
        carrier=None if carrier is None else carrier.at(stream.t),
        carrier_ok=None if carrier is None else carrier.covers(stream.t),
    )


def _trusted(values: Floats, sensor: Wds, full_scales: Floats, spikes: bool) -> Bools:
    """Which samples (N, 3) along the wheel's axes rest on sound samples of the unit's own axes only."""
    bad = np.column_stack([~trusted(axis, full_scales, spikes) for axis in values.T])
    shares = np.abs(mounting_matrix(sensor.rotation_deg)) > SHARE
    return np.asarray(~(bad.astype(float) @ shares.T > 0.0))


def wheel_motions(log: FieldLog) -> dict[str, WheelMotion]:
    """Every wheel-mounted unit of a log, by sensor name; units with too few samples are left out.

    Two units are worked on at a time: the arithmetic releases the interpreter.
    """
    carrier = next(iter(carriers(log)), None)
    units = {
        name: (stream, sensor, nominal_radius(log.manifest.machine, sensor), carrier)
        for name, sensor in log.manifest.of_kind("wds").items()
        if isinstance(stream := log.streams.get(name), WheelStream) and stream.t.size >= LEAST_SAMPLES
    }
    with ThreadPoolExecutor(max_workers=2) as pool:
        return dict(zip(units, pool.map(lambda unit: wheel_motion(*unit), units.values()), strict=True))


def carriers(log: FieldLog) -> tuple[Carrier, ...]:
    """Angular velocity of the tractor by each of its IMDs, in the manifest's order."""
    found = []
    for name, sensor in log.manifest.of_kind("imd").items():
        stream = log.streams.get(name)
        if (
            isinstance(sensor, Imd)
            and sensor.body == "tractor"
            and isinstance(stream, ImuStream)
            and stream.t.size > 1
        ):
            found.append(Carrier(stream.t, to_body(stream, sensor)[1]))
    return tuple(found)


def nominal_radius(machine: Machine, sensor: Wds) -> float:
    """Rolling radius that the manifest states for a unit's wheel, m."""
    tractor = machine.tractor
    return tractor.front_wheel_radius if sensor.wheel.startswith("front") else tractor.rear_wheel_radius


def steer_from_wheels(
    wheels: Mapping[str, WheelMotion],
    body_t: Floats,
    body_yaw_rate: Floats,
    grid_t: Floats,
    tractor: Tractor | None = None,
) -> WheelSteer | None:
    """Steering angle from the front wheels' yaw rates less the body's; None without a front wheel's unit.

    body_t (M,) s, UTC; body_yaw_rate (M,) rad/s: the body's own gyro (its bias is found here, at rest and
    against the rear wheels' units); grid_t (N,) s, UTC, increasing; tractor : its track and wheelbase turn
    a single wheel's angle into the mean of both

    Never touched by the body's position, by its estimated yaw, or by the kinematics of steering.
    """
    chosen = [TurnedWheel(w.wheel, w.t, w.turned, w.turned_variance, w.rest) for w in wheels.values()]
    return steering_angle(chosen, body_t, body_yaw_rate, grid_t, tractor)


def steer_from_sensor(stream: SteerStream, sensor: Steer, grid_t: Floats) -> SteerInput:
    """The steering sensor's angle on a grid, with the manifest's doubt of its zero and scale; its noise is what the
    manifest states or, where it states none, what the series shows (at least QUIETEST: it may be filtered)."""
    noise = sensor.noise_deg if "noise_deg" in sensor.model_fields_set else QUIETEST
    angle, sd, correlation_time = sensor_angle(stream.t, stream.angle, np.radians(noise), grid_t)
    return SteerInput(
        angle, sd, correlation_time, float(np.radians(sensor.zero_sd_deg)), sensor.scale_sd, "sensor"
    )


def choose_steer_input(
    log: FieldLog, grid_t: Floats, wheels: Mapping[str, WheelMotion] | None = None
) -> SteerInput | None:
    """The series that may drive the replay: the steering sensor where it covers the pass, else the front
    wheels, else what there is of the sensor.

    None when the log has neither for half of the grid.
    """
    sensors = _steer_sensors(log)
    for stream, sensor in sensors:
        if _share(stream.t, grid_t) >= COVERAGE:
            return steer_from_sensor(stream, sensor, grid_t)
    steer = _by_wheels(log, grid_t, wheel_motions(log) if wheels is None else wheels)
    if steer is not None:
        return steer.as_input()
    for stream, sensor in sensors:
        if _share(stream.t, grid_t) >= LEAST_COVERAGE:
            return steer_from_sensor(stream, sensor, grid_t)
    return None


def _steer_sensors(log: FieldLog) -> list[tuple[SteerStream, Steer]]:
    found = [(log.streams.get(name), sensor) for name, sensor in log.manifest.of_kind("steer").items()]
    return [(stream, sensor) for stream, sensor in found if isinstance(stream, SteerStream)]


def _by_wheels(log: FieldLog, grid_t: Floats, wheels: Mapping[str, WheelMotion]) -> WheelSteer | None:
    """Steering by the front wheels' units where one covers half of the grid; the body's rate by all its
    IMDs.
    """
    body = carriers(log)
    covered = [w for w in wheels.values() if w.front and _share(w.t, grid_t) >= LEAST_COVERAGE]
    if not body or not covered:
        return None
    yaw_rate = np.mean([c.at(body[0].t)[:, 2] for c in body], axis=0)
    return steer_from_wheels(wheels, body[0].t, yaw_rate, grid_t, log.manifest.machine.tractor)


def _share(t: Floats, grid_t: Floats) -> float:
    """Share of the grid that lies within half a second of a sample."""
    if t.size < 2:
        return 0.0
    after = np.clip(np.searchsorted(t, grid_t), 1, t.size - 1)
    near = np.minimum(np.abs(t[after] - grid_t), np.abs(t[after - 1] - grid_t))
    return float(np.mean(near < 0.5))


def _doubt(sensor: Wds) -> Doubt:
    """The manifest's bias figures where it has them."""
    usual = Doubt()
    return Doubt(
        gyro_bias=usual.gyro_bias if sensor.gyro_bias is None else sensor.gyro_bias,
        accel_bias=usual.accel_bias if sensor.accel_bias is None else sensor.accel_bias,
    )


def _named(names: tuple[str, ...], value: Floats, sd: Floats) -> dict[str, tuple[float, float]]:
    return {name: (float(v), float(s)) for name, v, s in zip(names, value, sd, strict=False)}


def _unused(name: str, good: Bools) -> tuple[Warn, ...]:
    count = int(np.count_nonzero(~good))
    if count == 0:
        return ()
    what = f"{count} samples are clipped, frozen or spikes"
    return (Warn(what, "left out of the wheel's motion and bridged", sensor=name),)
