"""Names of parameters: the dotted ones of the manifest, their short forms, and the nearest known to a typo."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence

from ..model.machine import Machine
from .identify_parameter import WrongUseError

PREFIX = "machine."
LISTED = "help"  # in place of a name: list them all
SYMBOLS: Mapping[str, str] = {
    "m1": "tractor.mass",
    "J1": "tractor.yaw_inertia",
    "l1": "tractor.front_track",
    "l2": "tractor.front_axle",
    "l3": "tractor.rear_axle",
    "l4": "tractor.hitch",
    "m2": "seeder.mass",
    "J2": "seeder.yaw_inertia",
    "l5": "seeder.hitch_to_com",
    "l6": "seeder.com_to_axle",
    "l7": "seeder.track",
    "P2": "seeder.draft",
    "Pw": "tyre_pressure_mpa",
}
"""The paper's symbols."""


def known_names(machine: Machine) -> tuple[str, ...]:
    """Every number of a machine by its dotted name; a tandem's lists an entry an axle (`seeder.track.1`)."""
    found: list[str] = []
    for name, owner in _tables(machine).items():
        for key, value in vars(owner).items():
            if isinstance(value, tuple) and len(value) > 1:
                found += [f"{name}.{key}.{i}" for i in range(len(value))]
            elif isinstance(value, int | float | tuple):
                found.append(f"{name}.{key}")
    return (*found, "tyre_pressure_mpa")


def _tables(machine: Machine) -> dict[str, object]:
    tables = {"tractor": machine.tractor, "seeder": machine.seeder}
    tables |= {f"tyres.{axle}": tyre for axle, tyre in vars(machine.tyres).items()}
    return {name: owner for name, owner in tables.items() if owner is not None}


def full_name(given: str, machine: Machine) -> str:
    """The dotted name behind a name as a person writes it.

    Taken: the dotted name, with or without `machine.` before it; any of its parts in any order that leave no
    doubt (`cornering_stiffness.front`, `front.cornering_stiffness`, `hitch_to_com`); the paper's symbol (`l5`).
    Raises WrongUseError: an unknown name with the nearest known one, a doubtful one with all that it may mean.
    """
    known = known_names(machine)
    name = given.strip().removeprefix(PREFIX)
    name = SYMBOLS.get(name, name)
    if name in known:
        return name
    if name.startswith(("seeder.", "tyres.seeder.")) and machine.seeder is None:
        raise WrongUseError(f"{given}: this machine has no seeder")
    parts = set(name.split("."))
    fitting = [one for one in known if parts <= set(one.split("."))]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        raise WrongUseError(f"{given}: may be {', '.join(fitting)}; name one of them")
    raise WrongUseError(f"{given}: unknown parameter{_nearest(name, known)}")


def _nearest(name: str, known: Sequence[str]) -> str:
    spellings = {form: one for one in known for form in (one, short_form(one, known))}
    spellings |= {".".join(reversed(short_form(one, known).split("."))): one for one in known}
    near = difflib.get_close_matches(name, list(spellings), n=1, cutoff=0.5)
    hint = f"; did you mean `{spellings[near[0]]}`?" if near else ""
    return f"{hint or ';'} `--free {LISTED}` lists all names"


def short_form(name: str, known: Sequence[str]) -> str:
    """The fewest of a name's last parts that no other name shares: `cornering_stiffness.front`, `hitch_to_com`."""
    *path, last = name.split(".")
    if sum(last in one.split(".") for one in known) == 1:
        return last
    owner = path[-1] if path else last
    return f"{last}.{owner}" if not last.isdigit() else name


def listed(machine: Machine) -> tuple[dict[str, object], ...]:
    """Every parameter that can be freed: name, short form and stated value (SI)."""
    known = known_names(machine)
    return tuple(
        {"parameter": name, "short": short_form(name, known), "stated": machine.parameter(name)}
        for name in known
    )
