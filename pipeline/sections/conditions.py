"""What was tested where: the run, the machine as the model has it, and the conditions of the field."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from ..report_blocks import Block, Missing, Section, Table
from ..report_view import PassView

SYMBOLS = {
    "machine.tractor.mass": ("m₁, mass of the tractor", "kg"),
    "machine.tractor.yaw_inertia": ("J₁, its moment of inertia about the vertical", "kg·m²"),
    "machine.tractor.front_track": ("l₁, front track", "m"),
    "machine.tractor.front_axle": ("l₂, front axle ahead of the centre of mass", "m"),
    "machine.tractor.rear_axle": ("l₃, rear axle behind the centre of mass", "m"),
    "machine.tractor.hitch": ("l₄, hitch behind the centre of mass", "m"),
    "machine.seeder.mass": ("m₂, mass of the seeder", "kg"),
    "machine.seeder.yaw_inertia": ("J₂, its moment of inertia about the vertical", "kg·m²"),
    "machine.seeder.hitch_to_com": ("l₅, hitch to the seeder's centre of mass", "m"),
    "machine.seeder.com_to_axle": ("l₆, wheels' axle behind the seeder's centre of mass", "m"),
    "machine.seeder.track": ("l₇, track of the seeder", "m"),
    "machine.seeder.draft": ("P₂, traction resistance", "N"),
    "operating.speed": ("v, nominal speed", "m/s"),
    "operating.tyre_pressure_mpa": ("P_w, pressure in the tractor's tyres", "MPa"),
}
NO_CONDITIONS = "The manifest states no [conditions] (soil hardness and moisture by layer, weather, crop)."


def build(view: PassView) -> Section:
    """The section."""
    conditions = tuple(_flat(view.manifest.conditions))
    stated: Block = Missing(NO_CONDITIONS)
    if conditions:
        stated = Table(
            "conditions", "Conditions as the manifest states them", ("condition", "value"), conditions
        )
    return Section("conditions", "Machine and conditions", (stated, _machine(view), _tyres(view)))


def _machine(view: PassView) -> Table:
    values = view.manifest.model_dump(mode="json", by_alias=True)
    rows = []
    for path, (words, unit) in SYMBOLS.items():
        value: Any = values
        for key in path.split("."):
            value = value.get(key) if isinstance(value, Mapping) else None
        if value is not None:
            sd = view.manifest.uncertainty.get(path.removeprefix("machine."))
            rows.append((words, _plain(value), unit, "–" if sd is None else f"{sd:g}"))
    caption = "The machine as the model has it, in the symbols of the paper"
    return Table("machine", caption, ("parameter", "value", "unit", "stated sd"), tuple(rows))


def _tyres(view: PassView) -> Table:
    tyres = view.manifest.machine.tyres
    named = {"front": tyres.front, "rear": tyres.rear, "seeder": tyres.seeder}
    rows = tuple(
        (name, f"{t.cornering_stiffness:g}", f"{t.reference_pressure_mpa:g}", f"{t.pressure_exponent:g}",
         f"{t.friction:g}", f"{t.rolling_resistance:g}", f"{t.relaxation_length:g}")
        for name, t in named.items() if t is not None
    )  # fmt: skip
    columns = ("tyre", "cornering stiffness, N/rad", "at, MPa", "exponent", "friction", "rolling resistance",
               "relaxation length, m")  # fmt: skip
    return Table("tyres", "Tyres, one wheel each", columns, rows)


def _plain(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(_plain(item) for item in value)
    return f"{value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested tables as lines: `soil hardness mpa, 0-5cm`."""
    for key, value in values.items():
        name = f"{prefix}{key.replace('_', ' ')}"
        if isinstance(value, Mapping):
            yield from _flat(value, f"{name}, ")
        else:
            yield name, _plain(value)
