"""parameters.toml: one line per parameter with value, unit, bounds, source and whether identification frees it.

    [cylinder.friction]
    viscous = { value = 741.36, unit = "N.s/m", bounds = [0, 1e6], free = true, source = "C-EHA paper, Table 1" }
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from pathlib import Path

from .errors import DataError, HydrotwinError, nearest
from .units import convert, si_unit

_KEYS = ("value", "unit", "bounds", "free", "source", "sigma", "note")


def read_toml(path: Path | str) -> dict:
    """A TOML file as a dictionary; errors name the file and the line."""
    path = Path(path)
    try:
        with open(path, "rb") as file:
            return tomllib.load(file)
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
                    f"{where}: {full} is no parameter (got {entry!r}). Write {{ value = .., unit = \"..\" }}."
                )
            if "value" in entry:
                found[full] = _setting(entry, f"{where}: {full}")
            else:
                walk(entry, full)

    walk(table, "")
    return found


def _setting(entry: Mapping, where: str) -> dict:
    for key in entry:
        if key not in _KEYS:
            raise DataError(f"{where}: unknown key '{key}'. {nearest(key, _KEYS)}")
    for key in ("value", "sigma"):
        if key in entry and (isinstance(entry[key], bool) or not isinstance(entry[key], (int, float))):
            raise DataError(f"{where}: {key} is no number (got {entry[key]!r}). Give a number.")
    for key, kind, form in (("free", bool, "true or false"), ("source", str, "text in quotes")):
        if not isinstance(entry.get(key, kind()), kind):
            raise DataError(f"{where}: {key} is not {form} (got {entry[key]!r}). Write {form}.")
    if not math.isfinite(entry["value"]) or not entry.get("sigma", 0.0) >= 0.0:
        raise DataError(f"{where}: value and sigma must be finite and sigma not negative (got {dict(entry)!r}).")
    if "unit" not in entry:
        raise DataError(f"{where}: no unit. Add unit = \"..\"; a pure number has unit = \"1\".")
    unit = entry["unit"]
    try:
        to = si_unit(unit)
        setting = {"value": float(convert(float(entry["value"]), unit, to)), "unit": to}
        if "bounds" in entry:
            low, high = (float(convert(float(b), unit, to)) for b in entry["bounds"])
            setting["bounds"] = (low, high)
        if "sigma" in entry:
            zero = float(convert(0.0, unit, to))
            setting["sigma"] = float(convert(float(entry["sigma"]), unit, to)) - zero
    except HydrotwinError as error:
        raise type(error)(f"{where}: {error}") from None
    except (TypeError, ValueError):
        message = f"{where}: bounds are no pair of numbers (got {entry['bounds']!r}). Write [low, high]."
        raise DataError(message) from None
    for key in ("source", "free"):
        if key in entry:
            setting[key] = entry[key]
    return setting

