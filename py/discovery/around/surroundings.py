"""surrounded: an FMU as a Model that effects can be added to, before its inputs and after its outputs."""

from __future__ import annotations

import copy
import dataclasses
import re
import time
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from hydrotwin.export.reader import LATE, FmuBlock
from hydrotwin.export.repeated import repeated
from hydrotwin.models.effects import Candidate
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, connect, der
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.records import Record, require
from hydrotwin.simulation import simulate

from .black_box import BlackBox, black_box

RAW = "puts_out_"  # before the name of an output: what the FMU itself puts out
WIDE = 30.0  # factor around its value within which a parameter of the FMU without bounds may move
STEP, SAMPLES = 1e-3, 10  # s; steps of the surroundings in one of the FMU or between two samples
LARGE = 0.9  # quantile of the size of a signal: its typical magnitude
SHARE = 0.6  # of a lone recording: what is fitted to


class SurroundedFmu(Model):
    """An FMU and what stands around it; it takes effects and values as any Model does, and compares as an FMU.

    Its parameters are those of the FMU and of the effects. None is free by itself.
    """

    sought = True  # what is put before the FMU acts inside it, where there are no equations to see that

    kind, modes = "fmu", ("free run",)

    @property
    def fmu(self) -> FmuBlock:
        """The FMU itself."""
        return type(self.root).fmu_inside

    @property
    def sites(self) -> tuple[str, ...]:
        """Where effects may stand: the inputs and outputs, in words of the language."""
        inside = type(self.root).names_inside
        return (*inside["inputs"], *inside["outputs"])

    @property
    def inputs(self):
        return self.flat.inputs

    @property
    def outputs(self):
        return self.flat.outputs

    @property
    def parameters(self):
        return self.flat.parameters

    def with_settings(self, settings: Mapping, provenance: Mapping | None = None) -> SurroundedFmu:
        """The same with further values; see `Model.with_settings`."""
        other = copy.copy(self)
        other.__dict__ = super().with_settings(settings, provenance).__dict__
        return other

    def with_inputs(self, changes: Mapping[str, Mapping]) -> SurroundedFmu:
        """The same whose inputs do something else between samples, also where they reach the FMU."""
        other = surrounded(self.fmu.with_inputs(changes)).plus(self.additions, sought=self.sought)
        other = other.with_settings(self.settings, self.provenance)
        other.step = self.step
        return other

    @cached_property
    def flat(self) -> BlackBox:
        """The FlatModel that runs the FMU between the equations of its surroundings."""
        around = Model.flat.func(self)
        inside = type(self.root).names_inside
        names = [q.name for q in around.parameters]
        starts = {f"inside.{name}": variable for name, variable in inside["starts"].items()}
        values = {name: name for name in inside["parameters"]}
        shaped = Model.observe(self, [f"inside.{name}" for name in inside["inputs"]])
        raw = [names.index(f"inside.{RAW}{name}") for name in inside["outputs"]]
        return black_box(around, shaped, raw, repeated(self.fmu), starts=starts, values=values)

    def observe(self, paths):
        """Any variables of the surroundings by path: ``(t, x, u, p) -> values`` along a run from its first column."""
        inside, flat = Model.observe(self, list(paths)), self.flat
        names = [q.name for q in Model.flat.func(self).parameters]
        kept = [names.index(q.name) for q in flat.parameters]
        raw = [names.index(f"inside.{RAW}{name}") for name in type(self.root).names_inside["outputs"]]

        def observed(t, x, u, p):
            time = np.ravel(t)
            states, inputs = np.reshape(x, (len(flat.states), len(time))), np.reshape(u, (-1, len(time)))
            chain = flat.prepared((), (), flat.step, "auto")
            whole = np.zeros((len(names), len(time)))
            whole[kept] = np.ravel(p)[:, None]
            whole[raw] = chain.raw(time, inputs.T, np.ravel(p), states[:, 0]).T
            return inside(time[None, :], states, inputs, whole)

        return observed

    def linearize(self, at=None, *, steady=False):
        """No FMU has equations to differentiate."""
        raise DeclarationError(f"{self.name}: an FMU has no equations to linearize. Linearize the model it came from.")

    def free_run(self, record: Record) -> Record:
        """Outputs at ``record.time`` from the inputs; see `Contender`."""
        return simulate(self, record)

    def one_step(self, record: Record) -> Record:
        """Not available: the inner states of the FMU cannot be set."""
        raise DeclarationError(f"{self.name}: one-step prediction is not available for an FMU with effects around it.")

    @property
    def opened(self) -> Model:
        """The surroundings alone: what the FMU gets are outputs, what it puts out are inputs. For Modelica."""
        known = {q.name for q in self.flat.parameters}
        settings = {k: v for k, v in self.settings.items() if k in known and "." in k}
        root = _component(self.fmu, opened=True)
        return Model(root, self.name, settings=settings, step=self.step, additions=self.additions)


def surrounded(fmu: FmuBlock, period: float = 0.0) -> SurroundedFmu:
    """The FMU with nothing around it yet, for recordings with a sample every ``period`` s where that is known.

    Raises DeclarationError for one without inputs or outputs.
    """
    fmu.require_outputs()
    if not fmu.inputs:
        raise DeclarationError(
            f"{fmu.path}: the FMU has no inputs (got {len(fmu.outputs)} outputs). Effects are looked for before inputs "
            "and after outputs: export it with both."
        )
    experiment = fmu.description.source.defaultExperiment
    own = float(experiment.stepSize) if experiment is not None and experiment.stepSize else 0.0
    name = re.sub(r"\W|^(?=\d)", "_", fmu.name)
    step = max(STEP, own / SAMPLES, period / SAMPLES)
    return SurroundedFmu(_component(fmu), name, step=step, provenance=fmu.provenance)


def sized(model: SurroundedFmu, records: Sequence[Record]) -> SurroundedFmu:
    """The same with steps that suit recordings, and typical magnitudes from them where the FMU declares none.

    Effects on a signal are sized by it: an offset of a pressure that counts as 1 Pa large would be looked for in vain.
    """
    declared = {v.name for v in model.fmu.description.source.modelVariables if v.nominal}
    of = model.fmu.description.fmu_names

    def with_size(s):
        values = [np.abs(r[s.name][np.isfinite(r[s.name])]) for r in records if s.name in r]
        size = float(np.quantile(np.concatenate(values), LARGE)) if values and sum(map(len, values)) else 0.0
        return s if of[s.name] in declared or not size > 0 else dataclasses.replace(s, nominal=float(f"{size:.1g}"))

    signals = {kind: tuple(with_size(s) for s in getattr(model.fmu, kind)) for kind in ("inputs", "outputs")}
    period = min(float(np.median(np.diff(r.time))) for r in records)
    sized_fmu = dataclasses.replace(model.fmu, **signals)
    return surrounded(sized_fmu, period).with_settings(model.settings, model.provenance)


def around_only(model: SurroundedFmu, candidates: Sequence[Candidate], seen: set[str]) -> tuple[Candidate, ...]:
    """The candidates on inputs and on the outputs that are ``seen``, the names of what was recorded.

    A parameter of the FMU is freed by name, not by an effect. A switch or a count has no lag, offset or limit.
    """
    inside, of = type(model.root).names_inside, model.fmu.description.fmu_names
    places = [*zip(inside["inputs"], model.fmu.inputs, strict=True)]
    places += [(w, s) for w, s in zip(inside["outputs"], model.fmu.outputs, strict=True) if s.name in seen]
    words = {w for w, s in places if of[s.name] not in model.fmu.description.whole}
    return tuple(c for c in candidates if c.site.through in words)


def ready(model: SurroundedFmu, records: Sequence[Record], validate: Sequence[Record], free):
    """Recordings that the FMU runs through, a lone one as two; what is to be said about it; seconds of a run.

    An FMU cannot start in the middle of a recording. Both parts of a lone one are the whole, with what belongs to the
    other not measured.

    Raises DataError or UnitError for missing signals, SolveError where the FMU fails, crashes or hangs.
    """
    seconds = 0.0
    for record in (*records, *validate):
        require(record, model.fmu.inputs, model.name)
        if not any(s.name in record for s in model.fmu.outputs):
            raise DataError(
                f"{record.source or record.name}: none of the outputs of {model.name} is recorded "
                f"({', '.join(s.name for s in model.fmu.outputs)}). Record at least one of them."
            )
        began = time.perf_counter()
        simulate(model, record)
        seconds = time.perf_counter() - began  # the first also starts the process
    said = []
    fixed = [p.name for p in model.fmu.parameters if p.name not in model.fmu.starts]
    if not free and fixed:
        more = f" and {len(fixed) - 6} more" if len(fixed) > 6 else ""
        said.append(
            f"gap: the parameters of the FMU are taken as they are. Wrong ones leave a gap that no effect should "
            f"explain; free them with --free ({', '.join(fixed[:6])}{more})."
        )
    if LATE in model.fmu.provenance:
        late = model.fmu.provenance[LATE]
        said.append(f"gap: outputs of the FMU are {LATE}: {late}. A delay that is named there may be none.")
    if len(records) == 1:
        outputs = [s.name for s in model.fmu.outputs]
        return [_part(records[0], outputs, number) for number in (1, 2)], said, seconds
    return list(records), said, seconds


def _part(record: Record, outputs: Sequence[str], number: int) -> Record:
    """The recording with its outputs known in the first part alone, or in the second."""
    edge = int(SHARE * len(record.time))
    signals = {n: np.array(v) for n, v in record.signals.items()}
    for name in outputs:
        if name in signals:
            signals[name][slice(edge, None) if number == 1 else slice(0, edge)] = np.nan
    return dataclasses.replace(record, signals=signals, name=f"{record.name} (part {number})")


def _component(fmu: FmuBlock, opened: bool = False) -> Component:
    """The surroundings as a component: inputs and outputs of the FMU, and between them the part ``inside``."""
    inputs, outputs = (_words([s.name for s in some]) for some in (fmu.inputs, fmu.outputs))
    declared = {w: Input(s.unit, s.description, s.nominal) for w, s in zip(inputs, fmu.inputs, strict=True)}
    declared |= {w: Output(s.unit, s.description, s.nominal) for w, s in zip(outputs, fmu.outputs, strict=True)}
    starts = [] if opened else [p for p in fmu.parameters if p.name in fmu.starts]
    held = [] if opened else [p for p in fmu.parameters if p.name not in fmu.starts]
    if opened:
        declared |= {RAW + w: Input(s.unit, s.description, s.nominal, "linear")
                     for w, s in zip(outputs, fmu.outputs, strict=True)}  # fmt: skip
        declared |= {f"takes_{w}": Output(s.unit, s.description, s.nominal)
                     for w, s in zip(inputs, fmu.inputs, strict=True)}  # fmt: skip
    else:
        declared["inside"] = _inside(fmu, inputs, outputs, starts)()
        declared |= {p.name: _parameter(fmu, p) for p in held}

    def equations(self):
        for word in inputs:
            taken = getattr(self, f"takes_{word}") if opened else getattr(self.inside, word)
            yield connect(getattr(self, word), taken)
        for word in outputs:
            given = getattr(self, RAW + word) if opened else getattr(self.inside, word)
            yield connect(given, getattr(self, word))

    names = {
        "inputs": inputs, "outputs": outputs, "parameters": [p.name for p in held],
        "starts": {_start_word(p.name): p.name for p in starts},
    }  # fmt: skip
    text = f"What stands around the FMU {Path(fmu.path).name}."
    more = {"__doc__": text, "equations": equations, "fmu_inside": fmu, "names_inside": names}
    return type("Surroundings", (Component,), {**declared, **more})()


def _inside(fmu: FmuBlock, inputs, outputs, starts) -> type[Component]:
    """The place of the FMU: it takes the inputs; what it puts out are constants here, and given from outside."""
    declared = {w: Input(s.unit, s.description, s.nominal) for w, s in zip(inputs, fmu.inputs, strict=True)}
    for word, s in zip(outputs, fmu.outputs, strict=True):
        declared[word] = Output(s.unit, s.description, s.nominal)
        declared[RAW + word] = Parameter(0.0, s.unit, f"{s.name} of the FMU", nominal=s.nominal, source="the FMU")
    nominal = {s.name: s.nominal for s in fmu.outputs}
    for p in starts:
        size = nominal.get(fmu.starts[p.name], 1.0)
        declared[_start_word(p.name)] = State(p.value, p.unit, f"start value {p.name}", nominal=size)

    def equations(self):
        for word in outputs:
            yield getattr(self, word) == getattr(self, RAW + word)
        for p in starts:
            yield der(getattr(self, _start_word(p.name))) == 0

    return type("ForeignFmu", (Component,), {**declared, "__doc__": "The place of the FMU.", "equations": equations})


def _parameter(fmu: FmuBlock, p) -> Parameter:
    """A parameter of the FMU between the bounds that it declares, else within a factor around its value."""
    variable = next(v for v in fmu.description.source.modelVariables if v.name == p.name)
    factor, offset = fmu.description.scales[p.name]
    declared = [None if b in (None, "") else factor * float(b) + offset for b in (variable.min, variable.max)]
    usual = sorted((p.value / WIDE, p.value * WIDE)) if p.value else (-np.inf, np.inf)
    low, high = (u if d is None or not np.isfinite(d) else d for d, u in zip(declared, usual, strict=True))
    bounds = (min(low, p.value), max(high, p.value))
    return Parameter(p.value, p.unit, p.description, bounds=bounds, source="the FMU")


def _start_word(name: str) -> str:
    return re.sub(r"\W", "_", name)


def _words(names: Sequence[str]) -> list[str]:
    """Names without dots and brackets, each once."""
    found: list[str] = []
    for name in names:
        word = re.sub(r"\W|^(?=\d)", "_", name)
        while word in found:
            word += "_"
        found.append(word)
    return found
