"""Linear analysis of the study: modes, damping and critical speed against v, l5 and Pw; frequency
responses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..model.linear import Mode, critical_speed, linearise
from ..model.settings import SimulationSettings
from .study_plan import Version, machine_of

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
DEFAULT = SimulationSettings()

# The paper's three parameters over the ranges of the sweep.
RANGES: dict[str, Floats] = {
    "speed": np.linspace(1.0, 8.0, 36),
    "seeder.hitch_to_com": np.linspace(1.5, 3.5, 21),
    "tyre_pressure_mpa": np.linspace(0.08, 0.16, 17),
}
FREQUENCIES = np.geomspace(0.02, 10.0, 200)  # Hz


@dataclass(frozen=True)
class LinearMap:
    """Modes of straight running along one parameter, the rest as in a version.

    values (n,); damping (n,): least damping ratio; frequency (n,): of the least damped oscillation, Hz, NaN
    where none oscillates; growth (n,): largest real part, 1/s; critical_speed (n,) m/s, NaN where none was
    found; modes: all modes of every value
    """

    version: Version
    name: str
    values: Floats
    damping: Floats
    frequency: Floats
    growth: Floats
    critical_speed: Floats
    modes: tuple[tuple[Mode, ...], ...]


def linear_map(
    version: Version, name: str, values: Floats, settings: SimulationSettings = DEFAULT
) -> LinearMap:
    """Modes along "speed" or a machine's dotted parameter."""
    modes, critical = [], []
    for value in values:
        machine = machine_of(version)
        if name != "speed":
            machine = machine.replace_parameters({name: float(value)})
        speed = float(value) if name == "speed" else version.speed
        modes.append(linearise(machine, speed, settings).modes())
        bound = critical_speed(machine, settings)
        critical.append(np.nan if bound is None else bound)
    return LinearMap(
        version=version,
        name=name,
        values=np.asarray(values, dtype=np.float64),
        damping=np.array([min(mode.damping for mode in each) for each in modes]),
        frequency=np.array([least_damped_frequency(each) for each in modes]),
        growth=np.array([max(mode.eigenvalue.real for mode in each) for each in modes]),
        critical_speed=np.array(critical),
        modes=tuple(modes),
    )


def least_damped_frequency(modes: tuple[Mode, ...]) -> float:
    """Natural frequency of the least damped mode that oscillates, Hz; NaN if none does."""
    swinging = [mode for mode in modes if mode.oscillates]
    return min(swinging, key=lambda mode: mode.damping).frequency if swinging else float("nan")


def linear_maps(version: Version, settings: SimulationSettings = DEFAULT) -> tuple[LinearMap, ...]:
    """Maps along v, l5 and Pw over RANGES."""
    return tuple(linear_map(version, name, values, settings) for name, values in RANGES.items())


@dataclass(frozen=True)
class Response:
    """Frequency response of a version from the steering angle: complex gains (n, outputs) at frequencies in
    Hz."""

    version: Version
    frequency: Floats
    outputs: tuple[str, ...]
    gain: Complexes


def steering_response(version: Version, settings: SimulationSettings = DEFAULT) -> Response:
    """From steering to both yaw rates (1/s) and both lateral accelerations (m/s²/rad)."""
    model = linearise(machine_of(version), version.speed, settings)
    gain = model.frequency_response(FREQUENCIES)[:, :, model.inputs.index("steer")]
    return Response(version, FREQUENCIES, model.outputs, gain)


def linear_table(maps: tuple[LinearMap, ...]) -> pd.DataFrame:
    """A row a version, parameter, value and mode."""
    rows = [
        {
            "version": item.version.label, "parameter": item.name, "value": float(value),
            "real": mode.eigenvalue.real, "imaginary": mode.eigenvalue.imag, "frequency": mode.frequency,
            "damping": mode.damping, "critical_speed": float(critical),
        }
        for item in maps
        for value, modes, critical in zip(item.values, item.modes, item.critical_speed, strict=True)
        for mode in modes
    ]  # fmt: skip
    return pd.DataFrame(rows)
