"""Between samples: whether a recorded input was held or moved on, by what the model says and the recordings show.

    1. what the user says, else what the model declares;
    2. a column that stays where it is after most of its changes was held: a measured quantity hardly ever does that;
    3. a command (by its name, or by the unit in which electronics command: V, A, 1) is held by a D/A converter;
    4. everything else is a measured physical quantity, which goes from sample to sample without jumps.

Held where it was linear, an input comes half a sample late: at 50 Hz that alone moves a mass by 3 %.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.flat import INTERPOLATIONS, Signal
from hydrotwin.models.language.units import compatible

from .noise import quantisation_step

STAYS = 0.5  # of the changes of a column after which it stays for a sample: more, and it was held
FEWEST = 3  # changes that show how a column moves
LEVELS = 8  # of a quantised column: with more of them, steps of one quantum are rounding and not commands
COMMANDED = {"command", "cmd", "commanded", "setpoint", "reference", "demand", "control", "wanted", "target", "soll"}
MEASURED = {"measured", "actual", "sensed", "feedback", "measurement", "ist"}
COMMAND_UNITS = ("V", "A", "1")


def settled(model, records: Sequence, wanted: Mapping[str, str] | None = None):
    """The model (or block, or FMU) with every input decided: as ``wanted`` by input, or as the ``records`` show.

    Raises DeclarationError for an unknown input or interpolation in ``wanted``.
    """
    flat = getattr(model, "flat", model)
    changes = decided(flat.inputs, records, wanted or {}, flat.name)
    return (model if hasattr(model, "with_inputs") else flat).with_inputs(changes) if changes else model


def told(inputs: Sequence[Signal], wanted: Mapping[str, str], owner: str) -> dict[str, dict]:
    """What `changed` takes: what the user says. Raises DeclarationError for an unknown input or interpolation."""
    names = [s.name for s in inputs]
    for name, kind in wanted.items():
        if name not in names:
            raise DeclarationError(f"interpolation: {owner}: no input '{name}'. {nearest(name, names)}")
        if kind not in INTERPOLATIONS:
            known = " or ".join(f"{name}={one}" for one in INTERPOLATIONS)
            raise DeclarationError(f"interpolation {name}={kind}: there is none. Write {known}.")
    return {n: {"interpolation": kind, "chosen_by": "user", "shift": 0.0, "why": ""} for n, kind in wanted.items()}


def decided(inputs: Sequence[Signal], records: Sequence, wanted: Mapping[str, str], owner: str) -> dict[str, dict]:
    """What `changed` takes: the choice for each input that is ``wanted`` so or that nobody has chosen for yet."""
    changes = told(inputs, wanted, owner)
    for signal in inputs:
        if signal.name not in wanted and signal.interpolation is None:
            kind, why = shown(signal, [r[signal.name] for r in records if signal.name in r])
            changes[signal.name] = {"interpolation": kind, "chosen_by": "recording", "why": why}
    return changes


def shown(signal: Signal, columns: Sequence[np.ndarray]) -> tuple[str, str]:
    """ "hold" or "linear" and the reason, by the recorded ``columns`` (n,) of an input."""
    stays, changes = np.sum([_stays(values) for values in columns], axis=0) if columns else (0, 0)
    if changes >= FEWEST and stays > STAYS * changes:
        return "hold", "it stays where it is after most of its changes"
    words = set(re.findall("[a-z]+", f"{signal.name} {signal.description}".lower()))
    if words & COMMANDED and not words & MEASURED:
        return "hold", f"a command, by its name ({', '.join(sorted(words & COMMANDED))})"
    if not words & MEASURED and any(_same(signal.unit, unit) for unit in COMMAND_UNITS):
        return "hold", f"a command, by its unit ({signal.unit})"
    return "linear", f"a measured quantity [{signal.unit}] that moves between its samples"


def shown_otherwise(inputs: Sequence[Signal], records: Sequence) -> list[str]:
    """Of every input that some ``records`` show otherwise than it is taken, a sentence.

    A choice by recordings is about those: of a model file about the ones of its fit, and a fit that found it so looked
    at no others. What a user says, or a model declares, is not doubted.
    """
    found = []
    for s in {(s.name, s.interpolation): s for s in inputs if s.chosen_by in (None, "recording", "fit")}.values():
        columns = {r.name: r[s.name] for r in records if s.name in r}
        kind = s.interpolation or shown(s, list(columns.values()))[0]
        apart = {n: why for n, c in columns.items() if (why := _against(s, kind == "hold", c))}
        if apart:
            first, *others = apart
            taken, other = ("held", "linear") if kind == "hold" else (kind, "hold")
            more = f" (and {len(others)} more)" if others else ""
            found.append(
                f"input {s.name} is taken as {taken} between its samples, and {first}{more} shows it otherwise: "
                f"{apart[first]}. Errors there may come from that alone; --interpolation {s.name}={other} takes it so."
            )
    return found


def _against(signal: Signal, held: bool, column: np.ndarray) -> str:
    """Why a column shows that an input is not as it is taken; "" where it shows nothing of that."""
    stays, changes = _stays(column)
    kind, why = shown(signal, [column])
    if changes < FEWEST or held == (kind == "hold"):
        return ""
    return why if stays > STAYS * changes or (held and signal.chosen_by != "fit") else ""


def _same(unit: str, other: str) -> bool:
    return unit == other or (unit not in ("rad", "1") and other != "1" and compatible(unit, other))


def _stays(values: np.ndarray) -> tuple[int, int]:
    """After how many of its changes a column stays for a sample, and how many they are.

    A quantum up or down is how rounding shows a slow movement, and no step of a command.
    """
    values = np.asarray(values, dtype=float)
    values = values[np.isfinite(values)]
    if not len(values):
        return 0, 0
    steps = np.abs(np.diff(values))
    quantum = quantisation_step(values)
    least = 1.5 * quantum if np.ptp(values) > LEVELS * quantum else 0.0
    return int(np.sum((steps[:-1] > least) & (steps[1:] == 0))), int(np.sum(steps[:-1] > 0))


def between(inputs: Sequence[Signal]) -> dict[str, dict]:
    """What every input does between its samples, who says so and why, as data."""
    rows = {}
    for s in inputs:
        row = {"interpolation": s.interpolation, "chosen_by": s.chosen_by, "why": s.why, "shift": s.shift}
        rows[s.name] = {k: v for k, v in row.items() if v}
    return rows


def sentences(inputs: Sequence[Signal]) -> list[str]:
    """The same for a reader; what a model declares needs no words."""
    said = []
    for s in inputs:
        if s.chosen_by == "model":
            continue
        late = f", {abs(s.shift):.3g} s {'later' if s.shift > 0 else 'earlier'} than it is stamped" if s.shift else ""
        why = f": {s.why}" if s.why else ""
        kind = "held" if s.held else s.interpolation
        said.append(f"input {s.name} is {kind} between samples{late} (chosen by {_who(s)}{why})")
    return said


def _who(signal: Signal) -> str:
    return {"user": "you", "fit": "the fit", "recording": "the recordings"}.get(signal.chosen_by, "nobody yet")
