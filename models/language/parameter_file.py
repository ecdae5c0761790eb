"""parameters.toml: one line per parameter with value, unit, bounds, source and whether identification frees it.

[cylinder.friction]
viscous = { value = 741.36, unit = "N.s/m", bounds = [0, 1e6], free = true, source = "C-EHA paper, Table 1" }
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from numbers import Real
from pathlib import Path

import numpy as np

from .errors import DataError, DeclarationError, HydrotwinError, nearest
from .units import counts_turns_or_not, parse_unit

_KEYS = ("value", "unit", "bounds", "free", "source", "sigma", "note")
_WORDS = (
    ("free", (bool, np.bool_), "true or false"),
    ("source", str, "text in quotes"),
    ("note", str, "text in quotes"),
)


def read_toml(path: Path | str) -> dict:
    """A TOML file as a dictionary; errors name the file and the line."""
    path = Path(path)
    try:
        with open(path, "rb") as file:
            return tomllib.loads(file.read().decode("utf-8-sig"))
    except FileNotFoundError:
        beside = [p.name for p in path.parent.glob("*.toml")] if path.parent.is_dir() else []
        raise DataError(f"{path}: no such file. {nearest(path.name, beside)}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: this is not TOML ({error}). Correct that place, or write the file anew.") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}). Check the path and its permissions.") from None


def read_parameters(path: Path | str) -> dict[str, dict]:
    """Settings by dotted path, in SI, ready for `Model`."""
    return parameter_settings(read_toml(path), str(path))


def parameter_settings(table: Mapping, where: str) -> dict[str, dict]:
    """Settings by dotted path from nested tables whose leaves are ``{ value = .., unit = .., ... }``."""
    found: dict[str, dict] = {}

    def walk(node: Mapping, path: str) -> None:
        for key, entry in node.items():
            full = f"{path}.{key}" if path else key
            if not isinstance(entry, Mapping):
                raise DataError(
                    f'{where}: {full} is no parameter (got {entry!r}). Write {{ value = .., unit = ".." }}.'
                )
            if any(not isinstance(below, Mapping) for below in entry.values()):
                if full in found:
                    raise DataError(f"{where}: {full} is written twice. Take one of the two out.")
                found[full] = _of_file(entry, f"{where}: {full}")
            else:
                walk(entry, full)

    walk(table, "")
    return found


def _of_file(entry: Mapping, where: str) -> dict:
    """A setting of a file, where nobody is to guess the unit."""
    setting = setting_in_si(entry, where, DataError)
    if "value" not in entry:
        raise DataError(f'{where}: no value. Write {{ value = .., unit = ".." }}.')
    if "unit" not in entry:
        raise DataError(f'{where}: no unit. Add unit = ".."; a pure number has unit = "1".')
    return setting


def setting_in_si(entry: Mapping, where: str, error: type[HydrotwinError] = DeclarationError) -> dict:
    """What is said of one parameter, its numbers in SI: the one place where settings of any origin become so.

    Without a unit they are in SI already; those in 1/min stay so until it is known whether an angle is needed.

    Raises
    ------
    error : a key that does not exist, a number that is none, bounds in no order, a negative sigma.
    UnitError : a unit that does not exist.
    """
    if unknown := [str(key) for key in entry if key not in _KEYS]:
        said = " ".join(f"Unknown key '{key}'. {nearest(key, _KEYS)}" for key in unknown)
        raise error(f"{where}: {said[0].lower()}{said[1:]}")
    setting = dict(entry)
    for key, kind, form in _WORDS:
        if key in entry and not isinstance(entry[key], kind):
            raise error(f"{where}: {key} is not {form} (got {entry[key]!r}). Write {form}.")
    for key in ("value", "sigma"):
        if key in entry and not (key == "sigma" and entry[key] is None):
            if isinstance(entry[key], bool) or not isinstance(entry[key], Real):
                raise error(f"{where}: {key} is no number (got {entry[key]!r}). Give a number, such as 1.0.")
            setting[key] = float(entry[key])
    if not math.isfinite(setting.get("value", 0.0)) or not (setting.get("sigma") or 0.0) >= 0.0:
        raise error(f"{where}: value and sigma must be finite and sigma not negative (got {dict(entry)!r}).")
    if "bounds" in entry:
        setting["bounds"] = _ordered(entry["bounds"], where, error)
    if "unit" in entry:
        if not entry.keys() & {"value", "bounds", "sigma"}:
            raise error(f"{where}: a unit and no value (got {dict(entry)!r}). Write the value that is in that unit.")
        _convert(setting, where)
    return setting


def _ordered(bounds, where: str, error: type[HydrotwinError]) -> tuple[float, float]:
    try:
        low, high = (float(b) for b in bounds)
    except (TypeError, ValueError):
        raise error(f"{where}: bounds are no pair of numbers (got {bounds!r}). Write [low, high].") from None
    if not low <= high:
        raise error(f"{where}: bounds are in no order (got [{low:g}, {high:g}]). Write [low, high].")
    return low, high


def _convert(setting: dict, where: str) -> None:
    """Value and bounds as points of the unit, sigma as a difference."""
    try:
        unit = parse_unit(setting["unit"])
    except HydrotwinError as error:
        raise type(error)(f"{where}: {error}") from None
    if counts_turns_or_not(setting["unit"]):
        return
    setting["unit"] = unit.si
    if setting.get("value") is not None:
        setting["value"] = unit.factor * setting["value"] + unit.offset
    if "bounds" in setting:
        setting["bounds"] = tuple(unit.factor * b + unit.offset for b in setting["bounds"])
    if setting.get("sigma") is not None:
        setting["sigma"] = unit.factor * setting["sigma"]
