"""A scenario's control loop: the same controller around every model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.simulation import Block, lower
from hydrotwin.simulation.closed_loop import close_loop

from .contender import BlockContender

_KEYS = ("reference", "measured", "command", "period", "numerator", "denominator", "limits")


@dataclass(frozen=True)
class Loop:
    """``command = C(z) (reference - measured)``, kept within ``limits``.

    reference : column of the recordings with the wanted value, in the unit of ``measured``.
    measured : output that is fed back. command : input that the controller sets.
    numerator, denominator : of C in powers of z, highest first, in SI (python-control's ``tf(num, den, period)``).
    """

    reference: str
    measured: str
    command: str
    period: float
    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    limits: tuple[float, float] = (-np.inf, np.inf)


def read_loop(table: Mapping, where: str) -> Loop:
    """The ``[loop]`` table of a scenario."""
    for key in table:
        if key not in _KEYS:
            raise DeclarationError(f"{where}: [loop] has an unknown key '{key}'. {nearest(key, _KEYS)}")
    for key in _KEYS[:-1]:
        if key not in table:
            raise DeclarationError(f"{where}: [loop] has no '{key}'. It needs {', '.join(_KEYS[:-1])}.")
    try:
        return Loop(
            str(table["reference"]), str(table["measured"]), str(table["command"]), float(table["period"]),
            tuple(float(c) for c in table["numerator"]), tuple(float(c) for c in table["denominator"]),
            tuple(float(c) for c in table.get("limits", (-np.inf, np.inf))),
        )  # fmt: skip
    except (TypeError, ValueError) as error:
        raise DeclarationError(f"{where}: [loop] holds something that is no number ({error}). Correct it.") from None


def in_loop(thing, loop: Loop, name: str | None = None) -> BlockContender:
    """A Model or Block under the scenario's controller, as a contender driven by the reference.

    Raises DeclarationError for what has no block (an FMU), or lacks the loop's input or output.
    """
    plant = thing
    if not isinstance(thing, Block):
        if not hasattr(getattr(thing, "flat", thing), "ode"):
            raise DeclarationError(
                f"loop: {getattr(thing, 'name', thing)} cannot be put under the controller. Only models and blocks can."
            )
        plant = lower(thing, loop.period)
    block = close_loop(
        plant,
        controller_block(loop, plant),
        feedback={"measured": loop.measured},
        command={loop.command: "command"},
        limits={loop.command: loop.limits},
        name=name or plant.name,
    )
    return BlockContender(block, kind=str(plant.provenance.get("kind", "physical")), name=name or plant.name)


def controller_block(loop: Loop, plant: Block) -> Block:
    """The controller with inputs ``reference`` (under the loop's name) and ``measured``, output ``command``."""
    import control  # heavy, and only a scenario with a loop needs it

    from hydrotwin.simulation.control_system import from_control

    units = {s.name: s.unit for s in (*plant.inputs, *plant.outputs)}
    for wanted, kind in ((loop.measured, "output"), (loop.command, "input")):
        if wanted not in units:
            raise DeclarationError(f"loop: {plant.name} has no {kind} '{wanted}'. {nearest(wanted, units)}")
    error = control.tf(list(loop.numerator), list(loop.denominator), loop.period)
    single = control.ss(error)
    two = control.ss(
        single.A, np.hstack([single.B, -single.B]), single.C, np.hstack([single.D, -single.D]), loop.period,
        inputs=[loop.reference, "measured"], outputs=["command"], name="controller",
    )  # fmt: skip
    unit = units[loop.measured]
    return from_control(two, units={loop.reference: unit, "measured": unit, "command": units[loop.command]})
