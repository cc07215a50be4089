"""Inertial units of a twin: from what an ideal unit feels to what a MEMS unit reports.

Figures per unit, 1 sigma, of the data sheets of common units (Bosch BMI088, TDK ICM-20948 and MPU-9250,
ST LSM6DSO), after the maker's trim and a factory calibration of the logger:

| quantity | data sheets | here |
| --- | --- | --- |
| gyro noise density | 0.004 (LSM6DSO), 0.014 (BMI088), 0.015 (ICM-20948) °/s/√Hz | 0.007 °/s/√Hz |
| gyro offset at turn-on | ±1 (BMI088, LSM6DSO), ±5 (ICM-20948) °/s, before calibration | 0.25 °/s |
| gyro bias instability | 2 to 10 °/h (Allan deviation, BMI088 under 2) | 8 °/h, Gauss-Markov of 120 s |
| gyro scale error | 0.5 to 1 % | 0.3 % |
| gyro range, resolution | ±250 (IMD), ±500 (WDS) °/s in 16 bits | same |
| accelerometer noise density | 70 (LSM6DSO), 175 (BMI088), 230 (ICM-20948) µg/√Hz | 230 µg/√Hz |
| accelerometer offset | ±20 (BMI088, LSM6DSO) to ±50 mg, before calibration | 6 mg |
| accelerometer instability | 20 to 50 µg | 40 µg, Gauss-Markov of 120 s |
| accelerometer scale error | 0.5 % | 0.3 % |
| accelerometer range, resolution | ±8 g in 16 bits | same |
| magnetometer (AK09916, BMM150) | 0.15 to 0.3 µT resolution, 0.3 to 1 µT noise | 0.3 µT, 0.15 µT |
| hard iron of a tractor | tens of µT | 8 µT a unit |
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter

from .twin_path import wander
from .twin_plan import ErrorPlan
from .twin_rigid import GRAVITY, Feel, from_degrees

Floats = NDArray[np.float64]

GYRO_NOISE = math.radians(0.007)  # rad/s/√Hz; sigma of a sample is density·√rate, as the manifest has it
GYRO_BIAS = math.radians(0.25)
GYRO_WANDER = math.radians(8.0 / 3600.0)
ACCEL_NOISE = 230e-6 * GRAVITY
ACCEL_BIAS = 6e-3 * GRAVITY
ACCEL_WANDER = 40e-6 * GRAVITY
SCALE_ERROR = 3e-3
WANDER_TIME = 120.0  # s
ACCEL_RANGE = 8.0 * GRAVITY
GYRO_RANGE = {"imd": math.radians(250.0), "wds": math.radians(500.0)}
STEPS = 32768.0  # of half the range
MAG_NOISE, MAG_STEP, MAG_RANGE, HARD_IRON = 0.3e-6, 0.15e-6, 1300e-6, 8e-6
CURRENT_TIME = 8.0  # s: fans and pumps switch, alternators follow the load
ENGINE_HZ, ENGINE = 31.0, {"tractor": 0.18, "seeder": 0.06}  # firing frequency at work, amplitude in m/s²
ROLLING = {"tractor": 0.10, "seeder": 0.045}  # m/s² of broad vibration for each m/s of speed
VIBRATION_SHARE = 0.03  # of half the sampling rate: vibration lies above
RATTLE = 2.0e-4  # rad/s of angular vibration for each m/s


@dataclass(frozen=True)
class UnitErrors:
    """What is constant in one unit for a pass (kept beside the truth): mounting error (deg), biases,
    scale errors, hard iron; noise is a sample's sigma."""

    misalignment_deg: Floats
    gyro_bias: Floats
    accel_bias: Floats
    gyro_scale: Floats
    accel_scale: Floats
    hard_iron: Floats
    gyro_noise: float
    accel_noise: float


def draw_errors(plan: ErrorPlan, rate: float, rng: np.random.Generator) -> UnitErrors:
    """One unit's constant errors."""

    def normal(sigma: float) -> Floats:
        return np.asarray(sigma * rng.standard_normal(3))

    return UnitErrors(
        misalignment_deg=normal(plan.misalignment_deg),
        gyro_bias=normal(GYRO_BIAS * plan.bias_scale),
        accel_bias=normal(ACCEL_BIAS * plan.bias_scale if plan.accel_bias is None else plan.accel_bias),
        gyro_scale=normal(SCALE_ERROR * plan.bias_scale),
        accel_scale=normal(SCALE_ERROR * plan.bias_scale),
        hard_iron=normal(HARD_IRON),
        gyro_noise=GYRO_NOISE * plan.noise_scale * math.sqrt(rate),
        accel_noise=ACCEL_NOISE * plan.noise_scale * math.sqrt(rate),
    )


def mounting(rotation_deg: tuple[float, ...], errors: UnitErrors) -> Floats:
    """True mounting, (3, 3): the stated one, then turned by the misalignment about the unit's own axes."""
    return np.asarray(from_degrees(rotation_deg) @ from_degrees(tuple(errors.misalignment_deg)))


def measured(
    feel: Feel, errors: UnitErrors, rate: float, kind: str, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Specific force and angular velocity that the unit reports, (N, 3) each: scale, bias, wander,
    noise, saturation, whole steps of its converter. `feel` : in the unit's axes, vibration included."""
    n, step = feel.force.shape[0], 1.0 / rate
    force = feel.force * (1.0 + errors.accel_scale) + errors.accel_bias
    force = force + ACCEL_WANDER * _wanders(n, step, rng) + errors.accel_noise * rng.standard_normal((n, 3))
    spin = feel.rate * (1.0 + errors.gyro_scale) + errors.gyro_bias
    spin = spin + GYRO_WANDER * _wanders(n, step, rng) + errors.gyro_noise * rng.standard_normal((n, 3))
    return converted(force, ACCEL_RANGE), converted(spin, GYRO_RANGE[kind])


def _wanders(n: int, step: float, rng: np.random.Generator) -> Floats:
    return np.column_stack([wander(n, step, WANDER_TIME, rng) for _ in range(3)])


def converted(value: Floats, reach: float) -> Floats:
    """Saturated at ±reach and rounded to the steps of a 16-bit converter."""
    counts = np.clip(np.round(value / reach * STEPS), -STEPS, STEPS - 1.0)
    return np.asarray(counts * reach / STEPS)


def shaken(feel: Feel, t: Floats, speed: Floats, body: str, level: float, rng: np.random.Generator) -> Feel:
    """With the vibration of engine and ground: a tone at the firing frequency with drawn phases, and
    broad noise that grows with speed. Units sit on their own brackets, so it is not common to them."""
    phase, share = rng.uniform(0.0, 2.0 * math.pi, 3), rng.uniform(0.5, 1.2, 3)
    frequency = ENGINE_HZ * (1.0 + 0.004 * np.cumsum(rng.standard_normal(t.size)) / math.sqrt(max(t.size, 1)))
    turns = np.concatenate([[0.0], np.cumsum(frequency[1:] * np.diff(t))])
    tone = ENGINE[body] * share * np.sin(2.0 * math.pi * turns[:, None] + phase)
    broad = ROLLING[body] * speed[:, None] * _bounded(t.size, rng)
    rattle = RATTLE * speed[:, None] * _bounded(t.size, rng)
    return Feel(feel.force + level * (tone + broad), feel.rate + level * rattle, feel.twist, feel.axes)


def _bounded(n: int, rng: np.random.Generator) -> Floats:
    """Broad noise of unit variance whose integral stays bounded, (n, 3): a vibrating unit does not drift
    away."""
    white = rng.standard_normal((n, 3))
    b, a = butter(1, VIBRATION_SHARE, "highpass")
    return np.asarray(lfilter(b, a, white, axis=0))


def earth_field(lat: float) -> Floats:
    """Magnetic field in (E, N, U), T: a dipole tilted by nothing, B = B0·(0, cos λ, −2·sin λ), B0 = 30 µT."""
    latitude = math.radians(lat)
    return 30e-6 * np.array([0.0, math.cos(latitude), -2.0 * math.sin(latitude)])


def magnetic(
    feel: Feel, errors: UnitErrors, lat: float, rng: np.random.Generator, plan: ErrorPlan, rate: float
) -> Floats:
    """What the unit's magnetometer reports, (N, 3) T: earth's field in its axes, bent by soft iron, hard iron, motors'
    currents, noise, steps."""
    field = np.einsum("nji,j->ni", feel.axes, earth_field(lat)) + errors.hard_iron
    noise = MAG_NOISE * rng.standard_normal(field.shape)
    if plan.soft_iron > 0.0:
        field = field + field @ (plan.soft_iron * rng.standard_normal((3, 3)))
    if plan.current_field > 0.0:
        drawn = np.column_stack([wander(field.shape[0], 1.0 / rate, CURRENT_TIME, rng) for _ in range(2)])
        field = field + plan.current_field * (drawn[:, :1] > 0.0) * drawn[:, 1:] * rng.standard_normal(3)
    noisy = field + noise
    return np.asarray(np.clip(np.round(noisy / MAG_STEP) * MAG_STEP, -MAG_RANGE, MAG_RANGE))
