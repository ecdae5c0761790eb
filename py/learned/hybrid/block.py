"""A hybrid: an identified physical model with a learned residual beside it, as one Block.

    x_m[k+1], y_m[k] = model(x_m[k], u[k], p)                     the physical model, running free
    x_r[k+1], r[k]   = residual(x_r[k], (u[k], y_m[k]))           a learned block; it integrates what the model lacks
    y[k]             = y_m[k] + r[k]                              for the corrected outputs, y_m[k] for the others

The model is never fed with corrected values: it stays what was identified, and where the residual is zero the hybrid is
the model. The residual is bounded as every learned block is. One-step prediction of a corrected output is its free run:
no state of the hybrid is that output alone.

A hybrid's file names two others beside it, the model file and the block file of the residual. All three are data.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import casadi as ca
import numpy as np
import tomlkit

from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import FlatModel, Signal, StateVariable
from hydrotwin.models.language.model_file import write_model_file
from hydrotwin.models.language.parameter_file import read_toml
from hydrotwin.models.language.writing import toml_values, write_whole
from hydrotwin.simulation import Block, TrainingDomain, lower

from ..block_file import LearnedBlock, read_block, write_block

VERSION = 1
SIMULATED, RESIDUAL = "simulated.", "residual."  # before the name of an output


@dataclass(frozen=True, eq=False)
class HybridBlock(Block):
    """A Block with the physical model and the residual it was made of.

    method : that of `lower`. substep : longest step [s] of the explicit method. started_by : outputs whose first
    measured sample sets the start; the others start where the model puts them.
    """

    model: object = None
    residual: LearnedBlock | None = None
    method: str = "explicit"
    substep: float = 0.0
    started_by: tuple[str, ...] = ()

    @property
    def corrected(self) -> tuple[str, ...]:
        """Names of the outputs that the residual corrects."""
        return tuple(s.name.removeprefix(RESIDUAL) for s in self.residual.outputs)


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
        provenance=dict(provenance or {}),
        model=model,
        residual=residual,
        method=method,
        substep=float(substep or flat.step),
        started_by=tuple(started_by),
    )


def write_hybrid(block: HybridBlock, path: str | Path, model: str) -> tuple[Path, ...]:
    """Write ``block`` as ``path`` (.toml) with ``<stem>_model.toml``, ``<stem>_residual.toml`` and .npz beside it.

    model : what the physical model is called in `hydrotwin.load`, such as ``cehA:third_order``.

    Raises `DataError` when the path does not end in .toml.
    """
    path = Path(path)
    if path.suffix != ".toml":
        raise DataError(f"{path}: a hybrid is a .toml file (got '{path.suffix}'). Write to {path.stem}.toml.")
    if not isinstance(block, HybridBlock):
        raise DataError(f"{block.name}: no hybrid (got {type(block).__name__}). Write learned blocks with write_block.")
    model_path, residual_path = (path.with_name(f"{path.stem}_{part}.toml") for part in ("model", "residual"))
    write_model_file(model_path, model, block.model)
    written = write_block(block.residual, residual_path)
    header = {
        "kind": "hybrid",
        "version": VERSION,
        "name": block.name,
        "method": block.method,
        "substep": block.substep,
        "started_by": list(block.started_by),
        "model": _named(model_path),
        "residual": _named(residual_path),
        "provenance": toml_values(block.provenance),
    }
    write_whole(path, tomlkit.dumps(header))
    return (path, model_path, *written)


def read_hybrid(path: str | Path, load: Callable[[str], object]) -> HybridBlock:
    """Read a hybrid; ``load`` makes the physical model of a model file's path (`hydrotwin.load`).

    Raises `DataError` naming the file when one of the three is missing, damaged or of another hybrid.
    """
    path = Path(path)
    header = read_toml(path)
    if header.get("kind") != "hybrid":
        raise DataError(f"{path}: not a hybrid (got kind {header.get('kind')!r}). Write it again with write_hybrid.")
    if header.get("version") != VERSION:
        raise DataError(
            f"{path}: written in version {header.get('version')} of 'hybrid', this hydrotwin reads version {VERSION}. "
            "Learn the hybrid again, or open it with the hydrotwin that wrote it."
        )
    try:
        frame = {"name": header["name"], "method": header["method"], "substep": float(header["substep"])}
        frame["started_by"] = [str(name) for name in header["started_by"]]
        frame["provenance"] = dict(header.get("provenance", {}))
        model_path, residual_path = (_beside(path, header[part]) for part in ("model", "residual"))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(f"{path}: the header lacks or garbles {error}. Write it again with write_hybrid.") from None
    try:
        return join(load(str(model_path)), read_block(residual_path), **frame)
    except DeclarationError as error:
        raise DataError(f"{path}: {error}") from None


def _named(path: Path) -> dict[str, str]:
    return {"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}


def _beside(path: Path, entry: Mapping[str, str]) -> Path:
    """The file that the header names, in the same folder and unchanged."""
    found, digest = path.with_name(Path(entry["file"]).name), entry["sha256"]
    try:
        content = found.read_bytes()
    except OSError:
        raise DataError(f"{path}: {found} is missing. Keep the files of a hybrid in one folder.") from None
    if hashlib.sha256(content).hexdigest() != digest:
        raise DataError(
            f"{found}: not the file that {path.name} was written with (sha256 differs). The residual was learned for "
            "that very model: learn it again with learn_hybrid, or copy all files again."
        )
    return found


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
    read = [v if s.name in started_by else np.nan for s, v in zip(physical.outputs, ca.vertsplit(y), strict=True)]
    x_model = physical.start(u, ca.vertcat(*read), p)
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
