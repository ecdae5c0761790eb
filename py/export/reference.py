"""A short run of our own that an FMU carries along, so that any tool can replay it and compare."""

from __future__ import annotations

import numpy as np

from hydrotwin.models.language.errors import DeclarationError, SolveError
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.records import Record, as_needed
from hydrotwin.simulation import simulate
from hydrotwin.simulation.block import Block
from hydrotwin.simulation.control import Accuracy
from hydrotwin.simulation.inputs import at, substeps
from hydrotwin.simulation.sampled import sample_grid

from .lower import implicit_advance, middle_of_training
from .method import SHARES, excitation, held

REFINED = 8
REPRODUCIBLE = 0.01  # of an output's range: what half the step may change in a run that others shall meet
SIMULATED = {"auto": "auto", "explicit": "explicit", "adaptive": "implicit"}  # method of the FMU -> of `simulate`


def reference_run(model, *, fine: bool = False, step: float | None = None, method: str = "auto") -> Record:
    """The inputs of `excitation`, and the outputs that `simulate` gives.

    By the method and at the step of the exported FMU, so that it gives the same numbers; `simulate` warns where those
    are not accurate.

    Inputs change at the samples only (held in between). It starts where the model starts by itself; a block starts with
    its measured outputs at zero, or at the middle of its training domain.

    Inputs that drive the model to where its equations have no solution move less, or not at all.

    fine : with an eighth of the model's step, for Model Exchange: the importer's solver meets the exact solution.
    step, method : internal step [s] and method as those of `export_fmu`; not for blocks.

    Raises SolveError where there is no solution though the inputs rest at their defaults.
    """
    system = getattr(model, "flat", model)
    if isinstance(system, Block):
        inputs = excitation(system, system.period)
        starts = {s.name: s for s in system.outputs if s.name not in inputs}
        values = {n: np.full(len(inputs.time), middle_of_training(system, n, 0.0)) for n in starts}
        inputs = inputs.with_signals(values, units={n: s.unit for n, s in starts.items()})
        outputs = simulate(system, inputs)
    else:
        inputs, outputs = _endured(system, step or system.step / (REFINED if fine else 1), method)
    answers = {s.name: outputs[s.name] for s in system.outputs}
    return inputs.with_signals(answers, units={s.name: s.unit for s in system.outputs})


def reference_experiment(model, record: Record, *, step: float | None = None, method: str = "auto") -> Record:
    """A recording as an experiment: its inputs, held between samples, and the outputs that `simulate` gives for them.

    It starts where the recording starts, as `simulate` does. A sampled block has it at its own samples: what a block
    gives between them is the importer's. ``step``, ``method`` as in `reference_run`. No measurement
    but the inputs and the first samples is in it. Raises as `simulate`.
    """
    system = getattr(model, "flat", model)
    if isinstance(system, Block):
        record = _on_its_grid(system, record)
        outputs = simulate(system, record)
    elif method == "implicit":
        raise DeclarationError(
            f"{system.name}: what an FMU of method 'implicit' is compared with starts in equilibrium, and a recording "
            "need not. Export it without --experiment, or with another method."
        )
    else:
        outputs = _answers(held(system), record, step or system.step, method)
        _require_reproducible(system, record, outputs.accuracy)
    inputs = {s.name: record[s.name] for s in system.inputs}
    answers = {s.name: outputs[s.name] for s in system.outputs}
    units = {s.name: s.unit for s in (*system.inputs, *system.outputs)}
    return Record(record.time, inputs | answers, units, record.name, record.source)


def _require_reproducible(system: FlatModel, record: Record, accuracy: Accuracy | None) -> None:
    """SolveError for a run that half the step changes so much that no importer would meet it."""
    if accuracy is not None and not accuracy.error <= REPRODUCIBLE:
        raise SolveError(
            f"export: {system.name} on {record.name}: {accuracy}, so nobody can meet its results. Identify the model "
            "first, give a smaller --step, or leave this --experiment out."
        )


def _on_its_grid(block: Block, record: Record) -> Record:
    """A recording at the samples of a block, its inputs held."""
    record = record.evenly()
    grid = sample_grid(block, record.time)
    if grid is record.time:
        return record
    grid = grid[grid <= record.time[-1]]
    return as_needed(record, (*block.inputs, *block.outputs)).resample(times=grid, hold=[s.name for s in block.inputs])


def _endured(flat: FlatModel, step: float, method: str) -> tuple[Record, Record]:
    """The inputs and what `simulate` gives, of the largest movement that the model bears."""
    for share in SHARES:
        inputs = excitation(flat, share=share)
        try:
            return inputs, _answers(held(flat), inputs, step, method)
        except SolveError as error:
            stopped = error
    raise SolveError(
        f"{flat.name}: the short run that an FMU carries along to be compared with has no solution, even with the "
        f"inputs at their defaults ({stopped}). Give inputs and states starts from which it runs for two seconds."
    )


def _answers(flat: FlatModel, inputs: Record, step: float, method: str) -> Record:
    if method == "implicit":
        return _implicit_run(flat, inputs, step)
    return simulate(flat, inputs, step=step, method=SIMULATED[method])


def _implicit_run(flat: FlatModel, record: Record, step: float) -> Record:
    """The outputs that the FMU of method "implicit" has, in CasADi's interpreter: `simulate` has no such method."""
    time, u, p = record.time, record.array([s.name for s in flat.inputs]), flat.parameter_vector()
    parameters = [q.name for q in flat.parameters]
    late = [p[parameters.index(s.dead_time)] if s.dead_time else None for s in flat.inputs]
    seen = [at(time, column, time - (Td or 0.0), False, "right") for column, Td in zip(u.T, late, strict=True)]
    cut, advance = substeps(time, u, step, [False] * len(late), late), implicit_advance(flat)
    x, rows = flat.start_given(())(u[0], p, []), []
    for k in range(len(time)):
        rows.append(flat.ode(time[k], x, [column[k] for column in seen], p)[1].full().ravel())
        for j in range(cut.first[k], cut.last[k] + 1) if k + 1 < len(time) else ():
            try:
                x = advance(cut.time[j], cut.length[j], x, cut.mean[j], p)
            except RuntimeError:
                raise SolveError(
                    f"{flat.name}: the implicit method with a fixed step of {step:g} s gives up at t = "
                    f"{cut.time[j]:.4g} s. Take a smaller step, or method 'adaptive'."
                ) from None
    columns = dict(zip([s.name for s in flat.outputs], np.array(rows).T, strict=True))
    return Record(time, columns, {s.name: s.unit for s in flat.outputs})
