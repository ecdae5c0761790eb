"""A scenario's control loop: the same controller around every model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.quantities import Wanted, in_unit, wanted
from hydrotwin.simulation import Block, lower
from hydrotwin.simulation.closed_loop import close_loop
from hydrotwin.simulation.propagator import OWN_METHOD

from .band import SD
from .contender import BlockContender

EXPLICIT = "explicit"  # the method of a model as a block
_KEYS = ("reference", "measured", "command", "period", "numerator", "denominator", "limits")


@dataclass(frozen=True)
class Loop:
    """``command = C(z) (reference - measured)``, kept within ``limits``.

    reference : column of the recordings with the wanted value, in the unit of ``measured``.
    measured : output that is fed back. command : input that the controller sets.
    limits : in SI, or texts with a unit, which those of a command that is declared in another one need.
    numerator, denominator : of C in powers of z, highest first, in SI (python-control's ``tf(num, den, period)``).
    """

    reference: str
    measured: str
    command: str
    period: float
    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    limits: tuple[float | str, float | str] = (-np.inf, np.inf)


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
            str(table["reference"]), str(table["measured"]), str(table["command"]),
            in_unit(table["period"], Wanted(f"{where}: [loop] period", "s"), "period = '{}'"),
            tuple(float(c) for c in table["numerator"]), tuple(float(c) for c in table["denominator"]),
            tuple(_limit(c) for c in table.get("limits", (-np.inf, np.inf))),
        )  # fmt: skip
    except (TypeError, ValueError) as error:
        raise DeclarationError(f"{where}: [loop] holds something that is no number ({error}). Correct it.") from None


def _limit(given: object) -> float | str:
    return given if isinstance(given, str) else float(given)


def in_loop(
    thing, loop: Loop, name: str | None = None, *, step: float | None = None, method: str | None = None
) -> BlockContender:
    """A Model or Block under the scenario's controller, as a contender driven by the reference.

    step, method : longest step [s] and method of a model with equations, see `lower`; by default its own, explicit.
    It has no bands: those of the model are of runs in which nothing makes up for its errors.

    Raises DeclarationError for what has no block (an FMU), or lacks the loop's input or output.
    """
    plant = without_deviations(thing) if isinstance(thing, Block) else thing
    if not isinstance(thing, Block):
        if not hasattr(getattr(thing, "flat", thing), "ode"):
            raise DeclarationError(
                f"loop: {getattr(thing, 'name', thing)} cannot be put under the controller. Only models and blocks can."
            )
        flat = getattr(thing, "flat", thing)
        stepped = replace(flat, step=step) if step else flat
        plant = lower(stepped, loop.period, EXPLICIT if method in (None, OWN_METHOD) else method)
    controller = controller_block(loop, plant)  # which knows the command
    block = close_loop(
        plant,
        controller,
        feedback={"measured": loop.measured},
        command={loop.command: "command"},
        limits={loop.command: limits_of(loop, plant)},
        name=name or plant.name,
    )
    block = replace(block, domain=plant.domain)
    return BlockContender(block, kind=str(plant.provenance.get("kind", "physical")), name=name or plant.name)


def without_deviations(block: Block) -> Block:
    """The block without the standard deviations among its outputs."""
    kept = [k for k, s in enumerate(block.outputs) if not s.name.endswith(SD)]
    if len(kept) == len(block.outputs):
        return block
    x, u, p = (
        ca.MX.sym(n, len(of)) for n, of in zip("xup", (block.states, block.inputs, block.parameters), strict=True)
    )
    y = ca.MX.sym("y", len(kept))
    given = ca.vertcat(*(y[kept.index(k)] if k in kept else 0 for k in range(len(block.outputs))))
    following, answered = block.step(x, u, p)
    return replace(
        block,
        outputs=tuple(block.outputs[k] for k in kept),
        step=ca.Function("step", [x, u, p], [following, answered[kept]], ["x", "u", "p"], ["x_next", "y"]),
        start=ca.Function("start", [u, y, p], [block.start(u, given, p)], ["u", "y", "p"], ["x"]),
    )


def limits_of(loop: Loop, plant: Block) -> tuple[float, float]:
    """The limits of the command in SI. Raises DeclarationError or UnitError for what is none."""
    asked = next(wanted(s, "loop") for s in plant.inputs if s.name == loop.command)
    return tuple(
        c if isinstance(c, float) and np.isinf(c) else in_unit(c, asked, "limits = ['{}', ..]") for c in loop.limits
    )


def controller_block(loop: Loop, plant: Block) -> Block:
    """The controller with inputs ``reference`` (under the loop's name) and ``measured``, output ``command``."""
    import control  # heavy, and only a scenario with a loop needs it

    from hydrotwin.simulation.control_system import from_control

    units = {s.name: s.unit for s in (*plant.inputs, *plant.outputs)}
    for name, kind in ((loop.measured, "output"), (loop.command, "input")):
        if name not in units:
            raise DeclarationError(f"loop: {plant.name} has no {kind} '{name}'. {nearest(name, units)}")
    error = control.tf(list(loop.numerator), list(loop.denominator), loop.period)
    single = control.ss(error)
    two = control.ss(
        single.A, np.hstack([single.B, -single.B]), single.C, np.hstack([single.D, -single.D]), loop.period,
        inputs=[loop.reference, "measured"], outputs=["command"], name="controller",
    )  # fmt: skip
    unit = units[loop.measured]
    return from_control(two, units={loop.reference: unit, "measured": unit, "command": units[loop.command]})
