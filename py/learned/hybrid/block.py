"""A hybrid: an identified physical model with a learned residual beside it, as one Block.

    x_m[k+1], y_m[k] = model(x_m[k], u[k], p)                     the physical model, running free
    x_r[k+1], r[k]   = residual(x_r[k], (u[k], y_m[k]))           a learned block; it integrates what the model lacks
    y[k]             = y_m[k] + r[k]                              for the corrected outputs, y_m[k] for the others

The model is never fed with corrected values: it stays what was identified, and where the residual is zero the hybrid is
the model. The residual is bounded as every learned block is. One-step prediction of a corrected output is its free run:
no state of the hybrid is that output alone.

A residual that does not help is not added: the hybrid is then the model alone. `files` has how a hybrid is written.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import FlatModel, Signal, StateVariable
from hydrotwin.models.language.provenance import made_from_rows
from hydrotwin.simulation import Block, TrainingDomain, lower

from ..block_file import LearnedBlock

SIMULATED, RESIDUAL = "simulated.", "residual."  # before the name of an output


@dataclass(frozen=True, eq=False)
class HybridBlock(Block):
    """A Block with the physical model and the residual it was made of; ``residual`` None: the model alone.

    method : that of `lower`. substep : longest step [s] of the explicit method. started_by : outputs whose first
    measured sample sets the start; the others start where the model puts them.
    """

    model: object = None
    residual: LearnedBlock | None = None
    method: str = "explicit"
    substep: float = 0.0
    started_by: tuple[str, ...] = ()

    def with_inputs(self, changes: Mapping[str, Mapping]) -> HybridBlock:
        """The same hybrid whose inputs do something else between samples, in its model, too: its files hold that."""
        return replace(super().with_inputs(changes), model=self.model.with_inputs(changes))

    @property
    def corrected(self) -> tuple[str, ...]:
        """Names of the outputs that the residual corrects."""
        return tuple(s.name.removeprefix(RESIDUAL) for s in self.residual.outputs) if self.residual else ()


def simulated_signal(output: Signal) -> Signal:
    """The model's own output as an input of the residual."""
    return replace(output, name=SIMULATED + output.name, interpolation="linear", dead_time=None)


def residual_signal(output: Signal) -> Signal:
    """What the model lacks in an output."""
    return replace(output, name=RESIDUAL + output.name, description=f"what the model lacks in {output.name}")


def sampled_model(model, period: float, method: str, substep: float | None) -> Block:
    """The physical model as a Block; ``substep`` None: the step of the model."""
    flat = getattr(model, "flat", model)
    return lower(flat if substep is None else replace(flat, step=substep), period, method)


def join(
    model,
    residual: LearnedBlock,
    *,
    name: str = "hybrid",
    method: str = "explicit",
    substep: float | None = None,
    started_by: Sequence[str] | None = None,
    provenance: Mapping | None = None,
) -> HybridBlock:
    """The physical model and the learned residual as one Block, at the period of the residual.

    model : a Model or FlatModel. residual : its inputs are inputs of the model and ``simulated.<output>``, its outputs
    ``residual.<output>``; it has no parameters. method : of `lower`; substep : longest step [s], None: the model's.
    started_by : outputs that set the start, None: all that do it for the model, and the corrected ones.

    Raises `DataError` when the residual was not learned for this model.
    """
    flat = getattr(model, "flat", model)
    physical = sampled_model(model, residual.period, method, substep)
    _check_names(flat, residual)
    if started_by is None:
        started_by = [s.name for s in flat.outputs]
    return HybridBlock(
        name=name,
        inputs=physical.inputs,
        outputs=physical.outputs,
        states=(*_physical_states(physical, residual), *_residual_states(residual)),
        parameters=physical.parameters,
        step=_step(physical, residual),
        start=_start(physical, residual, started_by),
        period=residual.period,
        domain=_domain(physical, residual),
        description=f"{flat.name} with a learned residual ({residual.description})",
        provenance=_made_of(flat, residual) if provenance is None else dict(provenance),
        model=model,
        residual=residual,
        method=method,
        substep=float(substep or flat.step),
        started_by=tuple(started_by),
    )


def alone(
    model,
    period: float,
    *,
    name: str = "hybrid",
    method: str = "explicit",
    substep: float | None = None,
    started_by: Sequence[str] | None = None,
    domain: TrainingDomain | None = None,
    provenance: Mapping | None = None,
) -> HybridBlock:
    """The physical model without a residual, in the frame of `join`: a hybrid where no residual helps."""
    flat = getattr(model, "flat", model)
    physical = sampled_model(model, period, method, substep)
    started_by = [s.name for s in flat.outputs] if started_by is None else started_by
    u, p, y = (ca.SX.sym(n, len(part)) for n, part in (("u", flat.inputs), ("p", flat.parameters), ("y", flat.outputs)))
    x = physical.start(u, _read(physical, y, started_by), p)
    return HybridBlock(
        name=name,
        inputs=physical.inputs,
        outputs=physical.outputs,
        states=physical.states,
        parameters=physical.parameters,
        step=physical.step,
        start=ca.Function("hybrid_start", [u, y, p], [x], ["u", "y", "p"], ["x"]),
        period=period,
        domain=domain,
        description=f"{flat.name} alone: a learned residual did not help",
        provenance=_made_of(flat) if provenance is None else dict(provenance),
        model=model,
        method=method,
        substep=float(substep or flat.step),
        started_by=tuple(started_by),
    )


def _made_of(flat: FlatModel, residual: LearnedBlock | None = None) -> dict:
    """Which recordings a hybrid follows that was put together by hand."""
    rows = {"physics_trained_on": made_from_rows(flat.provenance)}
    return rows | ({"trained_on": made_from_rows(residual.provenance)} if residual else {})


def _read(physical: Block, y, started_by: Sequence[str]):
    """The measured outputs (ny,) that set the start, nan for the others."""
    measured = zip(physical.outputs, ca.vertsplit(y), strict=True)
    return ca.vertcat(*(v if s.name in started_by else np.nan for s, v in measured))


def _check_names(flat: FlatModel, residual: LearnedBlock) -> None:
    inputs, outputs = ([s.name for s in part] for part in (flat.inputs, flat.outputs))
    if not residual.outputs or len(residual.parameters):
        raise DataError(f"{residual.name}: no residual of a model. Learn one with learn_hybrid.")
    for signal in (*residual.inputs, *residual.outputs):
        prefix = next((p for p in (SIMULATED, RESIDUAL) if signal.name.startswith(p)), "")
        known, bare = outputs if prefix else inputs, signal.name.removeprefix(prefix)
        if bare not in known:
            raise DataError(
                f"{residual.name}: learned for a model with a signal '{bare}', which {flat.name} lacks. "
                f"{nearest(bare, known)} Learn the residual for this model with learn_hybrid."
            )


def _physical_states(physical: Block, residual: LearnedBlock) -> list[StateVariable]:
    """The model's states; what a corrected output measures is no longer a state alone."""
    corrected = {s.name.removeprefix(RESIDUAL) for s in residual.outputs}
    return [replace(s, measured_by=None) if s.measured_by in corrected else s for s in physical.states]


def _residual_states(residual: LearnedBlock) -> list[StateVariable]:
    return [replace(s, name=s.name if s.name.startswith(RESIDUAL) else RESIDUAL + s.name, measured_by=None)
            for s in residual.states]  # fmt: skip


def _domain(physical: Block, residual: LearnedBlock) -> TrainingDomain | None:
    """The residual's box in the inputs and the uncorrected outputs of the hybrid; those are what they were."""
    if residual.domain is None:
        return None
    corrected = {s.name.removeprefix(RESIDUAL) for s in residual.outputs}
    names = {s.name: s.name for s in physical.inputs}
    names |= {SIMULATED + s.name: s.name for s in physical.outputs if s.name not in corrected}
    box = residual.domain
    rows = [(names[n], *sides) for n, *sides in zip(box.names, box.lower, box.upper, strict=True) if n in names]
    return TrainingDomain(*zip(*rows, strict=True)) if rows else None


def _seen(physical: Block, residual: LearnedBlock, u, y):
    """The inputs of the residual from the inputs and outputs of the model."""
    values = dict(zip([s.name for s in physical.inputs], ca.vertsplit(u), strict=True))
    values |= {SIMULATED + s.name: v for s, v in zip(physical.outputs, ca.vertsplit(y), strict=True)}
    return ca.vertcat(*(values[s.name] for s in residual.inputs))


def _kind(physical: Block):
    return ca.SX if physical.step.is_a("SXFunction") else ca.MX


def _step(physical: Block, residual: LearnedBlock) -> ca.Function:
    kind, nm, nr = _kind(physical), len(physical.states), len(residual.states)
    x, u, p = kind.sym("x", nm + nr), kind.sym("u", len(physical.inputs)), kind.sym("p", len(physical.parameters))
    x_model, x_residual = ca.vertsplit(x, [0, nm, nm + nr])
    model_next, y = physical.step(x_model, u, p)
    residual_next, r = residual.step(x_residual, _seen(physical, residual, u, y), kind.zeros(0, 1))
    names, missing = [s.name for s in residual.outputs], ca.vertsplit(r)
    parts = [
        value + missing[names.index(RESIDUAL + s.name)] if RESIDUAL + s.name in names else value
        for s, value in zip(physical.outputs, ca.vertsplit(y), strict=True)
    ]
    following = ca.vertcat(model_next, residual_next)
    return ca.Function("hybrid_step", [x, u, p], [following, ca.vertcat(*parts)], ["x", "u", "p"], ["x_next", "y"])


def _start(physical: Block, residual: LearnedBlock, started_by: Sequence[str]) -> ca.Function:
    """The model as it starts by itself; the residual at what its first output lacks, zero where none is measured."""
    kind = _kind(physical)
    u, p = kind.sym("u", len(physical.inputs)), kind.sym("p", len(physical.parameters))
    y = kind.sym("y", len(physical.outputs))
    x_model = physical.start(u, _read(physical, y, started_by), p)
    simulated = physical.step(x_model, u, p)[1]
    apart = dict(zip([s.name for s in physical.outputs], ca.vertsplit(y - simulated), strict=True))
    lacks = [apart[s.name.removeprefix(RESIDUAL)] for s in residual.outputs]
    first = ca.vertcat(*(ca.if_else(ca.logic_or(v <= 0, v > 0), v, 0) for v in lacks))  # nan: not measured
    x_residual = residual.start(_seen(physical, residual, u, simulated), first, kind.zeros(0, 1))
    return ca.Function("hybrid_start", [u, y, p], [ca.vertcat(x_model, x_residual)], ["u", "y", "p"], ["x"])


def hybrid_outputs(flat: FlatModel, outputs: Sequence[str] | None, recorded: Callable[[str], bool]) -> list[Signal]:
    """The outputs to correct: those named, or all that are recorded everywhere.

    Raises DeclarationError for a name the model lacks, DataError when nothing is left.
    """
    names = [s.name for s in flat.outputs]
    for name in outputs or ():
        if name not in names:
            raise DeclarationError(f"{flat.name}: no output '{name}' to correct. {nearest(name, names)}")
    chosen = [s for s in flat.outputs if (s.name in outputs if outputs else recorded(s.name))]
    if not chosen:
        raise DataError(
            f"learn_hybrid: none of the outputs of {flat.name} is in every recording. It needs one of "
            f"{', '.join(names)}."
        )
    return chosen
