"""What a person asks of an identification: which parameters are free, their bounds, and what is known before.

From the command line (`--free`, `--bound`, `--prior`) and from a TOML file of priors; names are resolved by the
machine of the passes (`identify_names`).
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..model.machine import Machine
from .identify_names import full_name
from .identify_parameter import IdentifyError, WrongUseError

Pair = tuple[float, float]
KEYS = ("mean", "sd", "low", "high")  # of a parameter's table in a file of priors


@dataclass(frozen=True)
class Wish:
    """What is asked of one free parameter, in its own unit.

    bounds : None: a tenth to ten times the stated value; mean, sd : of a normal prior, mean None: the stated
    value, sd None: what the manifests' [uncertainty] says, or no prior
    """

    bounds: Pair | None = None
    mean: float | None = None
    sd: float | None = None


@dataclass(frozen=True)
class Asked:
    """Wishes by the names that a person wrote; `library`: of a file, which may know more than is freed."""

    free: Mapping[str, Pair | None]
    bounds: Mapping[str, Pair] = field(default_factory=dict)
    priors: Mapping[str, Pair] = field(default_factory=dict)
    library: Mapping[str, Wish] = field(default_factory=dict)


def asked(
    free: Sequence[str], bounds: Sequence[str] = (), priors: Sequence[str] = (), file: Path | None = None
) -> Asked:
    """The wishes of a command line.

    Raises WrongUseError that names the option, IdentifyError that names the file and its key.
    """
    return Asked(
        parse_free(free),
        dict(_pairs(bounds, "--bound", "NAME=LOW:HIGH")),
        dict(_pairs(priors, "--prior", "NAME=MEAN:SD")),
        {} if file is None else read_priors(file),
    )


def wishes(wanted: Asked, machine: Machine) -> dict[str, Wish]:
    """What is asked of each free parameter, by its dotted name; the command line goes before the file.

    Raises WrongUseError for a name that is unknown, doubtful, freed twice or bounded twice, and for a bound or
    prior of the command line without its parameter being free.
    """
    found: dict[str, Wish] = {}
    library = {_named(name, machine, "--priors"): wish for name, wish in wanted.library.items()}
    for given, bounds in wanted.free.items():
        name = _named(given, machine, "--free")
        if name in found:
            raise WrongUseError(f"--free {given}: {name} is named twice")
        wish = library.get(name, Wish())
        found[name] = wish if bounds is None else replace(wish, bounds=bounds)
    for given, pair in wanted.bounds.items():
        name = _freed(given, machine, "--bound", found)
        if any(_named(g, machine, "--free") == name and b is not None for g, b in wanted.free.items()):
            raise WrongUseError(f"--bound {given}: {name} has bounds in --free too; give them once")
        found[name] = replace(found[name], bounds=pair)
    for given, (mean, sd) in wanted.priors.items():
        name = _freed(given, machine, "--prior", found)
        found[name] = replace(found[name], mean=mean, sd=sd)
    return found


def _named(given: str, machine: Machine, option: str) -> str:
    try:
        return full_name(given, machine)
    except WrongUseError as error:
        raise WrongUseError(f"{option} {error}") from None


def _freed(given: str, machine: Machine, option: str, free: Mapping[str, Wish]) -> str:
    name = _named(given, machine, option)
    if name not in free:
        raise WrongUseError(f"{option} {given}: {name} is not free; add it to --free")
    return name


def parse_free(texts: Sequence[str]) -> dict[str, Pair | None]:
    """Free parameters from the command line: names, or NAME=LOW:HIGH, separated by commas."""
    found: dict[str, Pair | None] = {}
    for text in (part.strip() for entry in texts for part in entry.split(",")):
        name, given, ends = text.partition("=")
        if not text:
            continue
        if name in found:
            raise WrongUseError(f"--free {name}: is named twice")
        found[name] = _pair(ends, f"--free {text}", "NAME=LOW:HIGH") if given else None
    return found


def _pairs(texts: Sequence[str], option: str, form: str) -> Iterator[tuple[str, Pair]]:
    seen = set()
    for text in (part.strip() for entry in texts for part in entry.split(",")):
        name, given, ends = text.partition("=")
        if not (name and given):
            raise WrongUseError(f"{option} {text}: is written {form}, in SI units")
        if name in seen:
            raise WrongUseError(f"{option} {name}: is given twice")
        seen.add(name)
        yield name, _pair(ends, f"{option} {text}", form)


def _pair(text: str, where: str, form: str) -> Pair:
    try:
        first, second = (float(end) for end in text.split(":"))
    except ValueError:
        raise WrongUseError(f"{where}: is written {form}, in SI units") from None
    if not (math.isfinite(first) and math.isfinite(second)):
        raise WrongUseError(f"{where}: both numbers must be finite")
    return first, second


def read_priors(path: Path) -> dict[str, Wish]:
    """Bounds and priors of a TOML file: a table a parameter, with `mean` and `sd`, `low` and `high`, or both.

    Raises IdentifyError that names the file and the key.
    """
    try:
        tables = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise IdentifyError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise IdentifyError(f"{path}: not valid TOML: {error}") from None
    return {name: _wish(table, f"{path}: {name}") for name, table in _leaves(tables, str(path))}


def _leaves(table: Mapping[str, Any], where: str, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Tables of numbers by the dotted path to them."""
    for key, value in table.items():
        name = (*path, key)
        if not isinstance(value, Mapping):
            raise IdentifyError(f"{where}: {'.'.join(name)}: must be a table with mean and sd, low and high")
        if any(isinstance(inner, Mapping) for inner in value.values()):
            yield from _leaves(value, where, name)
        else:
            yield ".".join(name), value


def _wish(table: Mapping[str, Any], where: str) -> Wish:
    for key, value in table.items():
        if key not in KEYS:
            raise IdentifyError(f"{where}.{key}: unknown key; there are {', '.join(KEYS)}")
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise IdentifyError(f"{where}.{key}: must be a finite number")
    if ("low" in table) != ("high" in table):
        raise IdentifyError(f"{where}: low and high go together")
    if "mean" in table and "sd" not in table:
        raise IdentifyError(f"{where}: a mean needs its sd")
    bounds = (float(table["low"]), float(table["high"])) if "low" in table else None
    mean, sd = (None if table.get(key) is None else float(table[key]) for key in ("mean", "sd"))
    return Wish(bounds, mean, sd)
