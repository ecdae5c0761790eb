"""A sampled controller and a machine as one block: the loop closed."""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca

from hydrotwin.models.language.errors import DeclarationError, TopologyError, nearest
from hydrotwin.models.language.provenance import lasting

from .block import Block


def close_loop(
    plant: Block,
    controller: Block,
    *,
    feedback: Mapping[str, str],
    command: Mapping[str, str],
    limits: Mapping[str, tuple[float, float]] | None = None,
    name: str | None = None,
) -> Block:
    """The block of a plant under a controller of the same period.

    At every sample the controller reads the plant's outputs and sets the plant's inputs, which are held to the next.

    Args:
        plant: a lowered model or a learned block.
        controller: for example ``from_control(control.tf(...), 0.01)``.
        feedback: controller input -> plant output that it reads.
        command: plant input -> controller output that sets it.
        limits: plant input -> (lower, upper), SI; the command saturates there.

    Returns: a Block with the remaining inputs of the controller, then those of the plant; the outputs of the plant,
    then the commands under the names of the plant's inputs.

    Raises:
        DeclarationError: a name that is not known, or different periods.
        TopologyError: an output that is fed back depends on the commanded input without delay.
    """
    _check(plant, controller, feedback, command)
    own, driven = _free(controller.inputs, feedback), _free(plant.inputs, command)
    x = ca.MX.sym("x", len(plant.states) + len(controller.states))
    u = ca.MX.sym("u", len(own) + len(driven))
    p = ca.MX.sym("p", len(plant.parameters) + len(controller.parameters))
    n_x, n_p = len(plant.states), len(plant.parameters)
    given = {s.name: u[k] for k, s in enumerate(own)}
    disturbing = {s.name: u[len(own) + k] for k, s in enumerate(driven)}
    idle = ca.vertcat(*(disturbing.get(s.name, 0) for s in plant.inputs))
    _, y_before = plant.step(x[:n_x], idle, p[:n_p])
    outputs = [s.name for s in plant.outputs]
    read = {c: y_before[outputs.index(o)] for c, o in feedback.items()}
    inputs = ca.vertcat(*(read[s.name] if s.name in read else given[s.name] for s in controller.inputs))
    controller_next, commanded = controller.step(x[n_x:], inputs, p[n_p:])
    sent = {i: commanded[[s.name for s in controller.outputs].index(o)] for i, o in command.items()}
    for i, (low, high) in (limits or {}).items():
        sent[i] = ca.fmin(ca.fmax(sent[i], low), high)
    plant_inputs = ca.vertcat(*(sent[s.name] if s.name in sent else disturbing[s.name] for s in plant.inputs))
    plant_next, y = plant.step(x[:n_x], plant_inputs, p[:n_p])
    following = ca.vertcat(plant_next, controller_next)
    answered = ca.vertcat(y, *(sent[s.name] for s in plant.inputs if s.name in sent))
    commands = tuple(s for s in plant.inputs if s.name in sent)
    return Block(
        name=name or f"{plant.name} in closed loop",
        inputs=own + driven,
        outputs=plant.outputs + commands,
        states=plant.states + controller.states,
        parameters=plant.parameters + controller.parameters,
        step=ca.Function("loop_step", [x, u, p], [following, answered], ["x", "u", "p"], ["x_next", "y"]),
        start=_start(plant, controller, len(own), len(driven), len(commands)),
        period=plant.period,
        description=f"{plant.name} under {controller.name}",
        provenance=lasting(plant.provenance, f"under {controller.name}") | {"controller": controller.name},
    )


def _free(signals, taken):
    return tuple(s for s in signals if s.name not in taken)


def _start(plant: Block, controller: Block, own: int, driven: int, commands: int) -> ca.Function:
    """The plant rests with its commands at zero; the controller starts from its own start."""
    u = ca.MX.sym("u", own + driven)
    y = ca.MX.sym("y", len(plant.outputs) + commands)
    p = ca.MX.sym("p", len(plant.parameters) + len(controller.parameters))
    n_p = len(plant.parameters)
    plant_start = plant.start(ca.MX.zeros(len(plant.inputs)), y[: len(plant.outputs)], p[:n_p])
    nothing = ca.MX.zeros(len(controller.inputs)), ca.MX.zeros(len(controller.outputs))
    x = ca.vertcat(plant_start, controller.start(*nothing, p[n_p:]))
    return ca.Function("loop_start", [u, y, p], [x], ["u", "y", "p"], ["x"])


def _check(plant: Block, controller: Block, feedback, command) -> None:
    for what, names, signals in (
        (f"{controller.name}: input", feedback, controller.inputs),
        (f"{plant.name}: output", feedback.values(), plant.outputs),
        (f"{plant.name}: input", command, plant.inputs),
        (f"{controller.name}: output", command.values(), controller.outputs),
    ):
        known = [s.name for s in signals]
        for name in names:
            if name not in known:
                raise DeclarationError(f"close_loop: {what} '{name}' is not known. {nearest(name, known)}")
    if not math.isclose(plant.period, controller.period, rel_tol=1e-9):
        raise DeclarationError(
            f"close_loop: {plant.name} steps every {plant.period:g} s, {controller.name} every {controller.period:g} "
            "s. Give both the same period."
        )
    through = plant.step.jac_sparsity(1, 1)  # of y with respect to u
    rows, columns = through.get_triplet()
    outputs, inputs = [s.name for s in plant.outputs], [s.name for s in plant.inputs]
    for row, column in zip(rows, columns, strict=True):
        if outputs[row] in feedback.values() and inputs[column] in command:
            raise TopologyError(
                f"close_loop: {plant.name}.{outputs[row]} depends on {inputs[column]} in the same sample: an algebraic "
                "loop. Feed back another output, or delay the command by one sample."
            )
