"""Every model x variant x recording of a scenario: `run_matrix`, and the `Matrix` that it answers with."""

from __future__ import annotations

import dataclasses
import fnmatch
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from hydrotwin.models.language.errors import DataError, DeclarationError, HydrotwinError, UnitError, nearest
from hydrotwin.models.language.summary_html import SmallTable, summary_html
from hydrotwin.records import Record
from hydrotwin.records.thinning import sampled_so, thinned
from hydrotwin.work.executor import executor_for

from .acceptance import Acceptance, Wanted, acceptance
from .asked import criteria_about, judged_model
from .changes import Change
from .comparison import Comparison, Failure
from .contender import Contender
from .earlier import earlier
from .notices import notices_of_variants
from .running import Where, asked_of, check_asked, compare_as, load_contenders, read_all, things_of
from .scenario import Scenario
from .travel import Carried, travels
from .variants import BASE, Variant, check_many
from .varied import check_variant

if TYPE_CHECKING:
    import pyarrow

_NAMED = re.compile(r"\s*variant\s*=\s*(?P<name>[^:]+?)\s*:\s*(?P<rest>.*)", re.DOTALL)


@dataclass(frozen=True, eq=False, repr=False)
class VariantRun:
    """One variant with what came of it.

    failed : why it could not be run at all; "" else. as_base : names of models that it leaves as they are.
    same_as : the variant before it of which it is in every run the same, and which was run for both; "" else.
    accepted : the criteria that are about it, judged; None without.
    """

    variant: Variant
    comparison: Comparison
    failed: str = ""
    as_base: tuple[str, ...] = ()
    same_as: str = ""
    accepted: Acceptance | None = None

    @property
    def name(self) -> str:
        return self.variant.name

    @property
    def folder(self) -> str:
        """Of its detailed page, below that of the overview: of the variant that was run for it."""
        return Variant(self.same_as).folder if self.same_as else self.variant.folder

    @property
    def left(self) -> frozenset[str]:
        """Models of which it has no numbers of its own."""
        return frozenset(self.comparison.models if self.same_as else self.as_base)


@dataclass(frozen=True, eq=False, repr=False)
class Matrix:
    """The variants of a scenario in its order, the scenario as it stands first."""

    title: str
    runs: tuple[VariantRun, ...]

    def __repr__(self) -> str:
        base = self.base
        size = f"{len(base.models)} models x {len(self.runs)} variants x {len(base.records)} recordings"
        return f"Matrix '{self.title}': {size}"

    def _repr_html_(self) -> str:
        mode, signal, accepted = self.base.modes[0], self.base.outputs[0], self.accepted
        scores = [(run.name, s) for run in self.runs if not run.same_as
                  for s in run.comparison.ranking(signal.name, mode)]  # fmt: skip
        scores.sort(key=lambda row: -row[1].rmse)
        rows = [(name, s.model, s.rmse, s.maximum, s.fit_percent) for name, s in scores]
        columns = ("variant", "model", f"RMSE [{signal.unit}]", f"maximum [{signal.unit}]", "fit [%]")
        told = "" if accepted is None else "All criteria hold." if accepted.passed else "Not all criteria hold."
        facts = {"models": len(self.base.models), "variants": len(self.runs), "recordings": len(self.base.records)}
        tables = [SmallTable(f"{signal.name}, {mode}, worst first", columns, rows)]
        return summary_html(self.title, told, facts, tables, notices_of_variants(self.runs))

    def __getitem__(self, name: str) -> VariantRun:
        for run in self.runs:
            if run.name == name:
                return run
        raise DeclarationError(f"{self.title}: no variant '{name}'. {nearest(name, [r.name for r in self.runs])}")

    @property
    def base(self) -> Comparison:
        """The scenario as it stands."""
        return self.runs[0].comparison

    @property
    def accepted(self) -> Acceptance | None:
        """All criteria of all variants, each with the variant in its words, missed ones first; None without any."""
        own = [(run.name, run.accepted) for run in self.runs if run.accepted]
        if not own:
            return None
        judged = [_of(name, one) for name, found in own for one in found.judged]
        changes = tuple(_changed(name, one) for name, found in own for one in found.changes)
        first = own[0][1]
        return dataclasses.replace(first, judged=tuple(sorted(judged, key=lambda j: j.passed)), changes=changes)

    def table(self, what: str = "scores") -> pyarrow.Table:
        """The rows of all variants as one Arrow table, see `Comparison.table`; the first column is ``variant``."""
        import pyarrow

        tables = [(run.name, run.comparison.table(what)) for run in self.runs]
        named = [t.add_column(0, "variant", pyarrow.array([name] * len(t), pyarrow.string())) for name, t in tables]
        return pyarrow.concat_tables(named, promote_options="default")


def run_matrix(
    scenario: Scenario,
    resolve: Callable[[str], object],
    where: Where | None = None,
    *,
    repeats: int = 3,
    on_variant: Callable[[VariantRun], None] | None = None,
) -> Matrix:
    """Run a scenario and its variants; one without variants is the base alone.

    where : where the runs are made, what keeps them (a second call then makes only what is new), and who is told
        (runs done, runs in all, what was done); by default here.
    on_variant : called with each variant that was run as soon as it is done. Its curves are then dropped: those of many
        variants would fill the memory. Without it all curves stay.

    A variant that cannot be run is listed with its reason, and costs only itself. One that comes to the same as one
    before it (the same equations and values, starts and recordings) is not run again.

    Raises DeclarationError, before anything runs, for a variant or a criterion that names what does not exist, for
    values that no model takes, and for more runs than can be meant; what `run_scenario` raises.
    """
    variants = scenario.variants
    variants = variants if variants and variants[0].name == BASE else (Variant(BASE), *variants)
    check_many(len(variants), len(scenario.models), len(scenario.validate), scenario.title)
    things = things_of(scenario, resolve)
    for variant in variants:
        check_variant(things, variant, scenario.title)
    wanted = {v.name: _wanted_of(scenario.wanted, v.name, variants) for v in variants}
    where = where or Where()
    with executor_for(where.executor) as pool:
        where = dataclasses.replace(where, executor=pool)
        prepared = [_prepared(scenario, v, resolve) for v in variants]
        base = prepared[0].contenders
        records, train = read_all(scenario, pool, where.on_read)
        _check_records(variants, records, scenario.title)
        check_asked(dataclasses.replace(scenario, wanted=_any_of(wanted.values())), base, records)
        for one in prepared[1:]:
            seen = [thinned(r, one.variant.period) for r in records]
            _check_criteria(scenario, one, wanted[one.variant.name], seen)
        first = _first_of(prepared, scenario.initial_states, records)
        counts = [len(p.contenders) * (j == k) * len(records) * len(scenario.modes)
                  for k, (p, j) in enumerate(zip(prepared, first, strict=True))]  # fmt: skip
        runs = []
        for k, one in enumerate(prepared):
            if first[k] == k:
                told = _from(where, sum(counts[:k]), sum(counts), one.variant.name if len(variants) > 1 else "")
                run = _run(scenario, one, (records, train), told, repeats, runs[0].comparison if runs else None)
                as_base = _as_base(one, prepared[0], scenario.initial_states, records) if k else ()
                run = dataclasses.replace(run, as_base=as_base)
            else:
                run = _again(runs[first[k]], one.variant, scenario.title)
            run = dataclasses.replace(run, accepted=_accepted(run, wanted[run.name], variants))
            if on_variant and not run.same_as:
                on_variant(run)
                run = dataclasses.replace(run, comparison=dataclasses.replace(run.comparison, trajectories=()))
            runs.append(run)
    return Matrix(scenario.title, tuple(runs))


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A variant with its contenders, or why there are none."""

    variant: Variant
    contenders: tuple[Contender, ...]
    failed: str = ""

    @cached_property
    def contents(self) -> dict[str, str]:
        """What the runs of each model depend on, hashed; of those that can say it."""
        return {c.name: Carried(c).content for c in self.contenders if travels(c)}


def _prepared(scenario: Scenario, variant: Variant, resolve: Callable[[str], object]) -> _Prepared:
    try:
        return _Prepared(variant, tuple(load_contenders(scenario, resolve, variant)))
    except (DeclarationError, UnitError, DataError) as error:  # said wrongly: told before anything runs
        where = f"{scenario.title}: variant '{variant.name}': " if variant.name != BASE else ""
        raise type(error)(f"{where}{error}") from None
    except HydrotwinError as error:
        if variant.name == BASE:
            raise
        return _Prepared(variant, (), str(error))


def _run(scenario: Scenario, one: _Prepared, read, where: Where, repeats: int, base: Comparison | None) -> VariantRun:
    """One variant on the recordings ``read`` (to compare on, of the training)."""
    variant = one.variant
    how = variant.initial_states or scenario.initial_states
    described = dataclasses.replace(scenario, initial_states=how)
    if base is not None:
        described = dataclasses.replace(described, title=f"{scenario.title}: {variant.name}")
    if one.failed:
        return VariantRun(variant, _empty(base, one.failed, described.title), one.failed)
    records = [thinned(r, variant.period) for r in read[0]]
    try:
        found = compare_as(described, one.contenders, records, read[1], where, repeats)
        if base is not None and variant.period is not None:
            found = dataclasses.replace(found, whole=base.records)
    except DataError as error:
        if base is None:
            raise
        return VariantRun(variant, _empty(base, str(error), described.title), str(error))
    failed = "" if found.scores else next((f.sentence for f in found.failures), "nothing was scored")
    return VariantRun(variant, found, failed)


def _period(variant: Variant, records: Sequence[Record]) -> float | None:
    """The sample time [s] to which a variant thins out; None where that changes no recording."""
    if variant.period is None or all(sampled_so(r, variant.period) for r in records):
        return None
    return variant.period


def _first_of(prepared: Sequence[_Prepared], how: str, records: Sequence[Record]) -> list[int]:
    """For each variant the first that comes to the same, by what its runs depend on; its own place where none does."""
    known: dict[tuple, int] = {}
    return [known.setdefault(_content(one, how, records) or (k,), k) for k, one in enumerate(prepared)]


def _content(one: _Prepared, how: str, records: Sequence[Record]) -> tuple | None:
    """All that its runs depend on, the recordings apart; None where a model cannot say it, or there is none."""
    if one.failed or len(one.contents) < len(one.contenders):
        return None
    return one.variant.initial_states or how, _period(one.variant, records), tuple(one.contents.items())


def _again(first: VariantRun, variant: Variant, title: str) -> VariantRun:
    """A variant that comes to the same as one before it."""
    found = dataclasses.replace(first.comparison, title=f"{title}: {variant.name}")
    as_base = found.models if first.name == BASE else first.as_base
    return VariantRun(variant, found, first.failed, as_base, first.name)


def _check_records(variants: Sequence[Variant], records: Sequence[Record], where: str) -> None:
    if len(variants) > 1 and any("variant" in r.tags for r in records):
        raise DeclarationError(f"{where}: criteria name variants by 'variant=', so no tag can be called so. Rename it.")
    for variant in (v for v in variants if v.period is not None):
        for record in records:
            if not record.period <= variant.period * (1 + 1e-9) or not variant.period < record.duration:
                raise DeclarationError(
                    f"{where}: variant '{variant.name}': {record.name} has a sample every {record.period:g} s for "
                    f"{record.duration:g} s and cannot be thinned to {variant.period:g} s. Give a time between them."
                )


def _empty(base: Comparison, reason: str, title: str) -> Comparison:
    """The comparison of a variant of which nothing ran."""
    real = [m for m in base.models if m not in base.yardsticks]
    failures = tuple(Failure(m, r.name, mode, reason) for mode in base.modes for m in real for r in base.records)
    nothing = dict.fromkeys(("scores", "means", "trajectories", "timings", "domains", "residuals", "unscored"), ())
    return dataclasses.replace(base, title=title, failures=failures, starts=(), inaccurate=(), **nothing)


def _as_base(one: _Prepared, base: _Prepared, how: str, records: Sequence[Record]) -> tuple[str, ...]:
    """Models of which this variant changes nothing, so that their numbers are those of the base.

    how : initial_states of the scenario; another way concerns those whose start can be estimated.
    """
    if _period(one.variant, records) is not None:
        return ()
    started = one.variant.initial_states in (None, how)
    same = [c for c in one.contenders if c.name in one.contents and base.contents.get(c.name) == one.contents[c.name]]
    return tuple(c.name for c in same if started or not hasattr(c, "estimate_start"))


def _from(where: Where, before: int, total: int, name: str) -> Where:
    """The same place, where ``before`` runs were made already."""
    tell = where.progress
    if tell is None:
        return where
    word = f"{name}: " if name else ""
    return dataclasses.replace(where, progress=lambda done, _, what: tell(before + done, total, f"{word}{what}"))


# -- criteria ----------------------------------------------------------------------------------------------------------
def _wanted_of(wanted: Wanted, name: str, variants: Sequence[Variant]) -> Wanted:
    """What is asked of one variant: criteria that name it (``variant=cold: ...``), or none."""
    own, folders = [], {}
    for text in wanted.accept:
        found = _NAMED.fullmatch(text)
        names = [v.name for v in variants]
        if found and len(names) > 1 and not fnmatch.filter(names, found["name"]):
            raise DeclarationError(f"accept: '{text}': no variant '{found['name']}'. {nearest(found['name'], names)}")
        about = found["rest"] if found and len(names) > 1 else text
        if about is text or fnmatch.fnmatch(name, found["name"]):
            own.append(about)
            folders[about] = wanted.folder(text)
    return dataclasses.replace(wanted, accept=tuple(own), own=folders)


def _check_criteria(scenario: Scenario, one: _Prepared, wanted: Wanted, records: Sequence[Record]) -> None:
    """Refuse what the models of a variant cannot be judged by: changed values, for one, have no band."""
    if one.failed:
        return
    asked = dataclasses.replace(asked_of(scenario, one.contenders, records), changed=True)
    for text in wanted.accept:
        try:
            criteria_about(text, asked, judged_model(asked, wanted.model))
        except DeclarationError as error:
            raise DeclarationError(f"{scenario.title}: variant '{one.variant.name}': {error}") from None


def _any_of(wanted: Sequence[Wanted]) -> Wanted:
    first, *_ = wanted
    folders = {text: one.folder(text) for one in wanted for text in one.accept}
    return dataclasses.replace(first, accept=tuple(folders), own=folders)


def _accepted(run: VariantRun, wanted: Wanted, variants: Sequence[Variant]) -> Acceptance | None:
    """What is asked of a variant, judged; that of the base tells which variants are not those of the earlier one."""
    if run.name != BASE:
        return acceptance(run.comparison, wanted, run.name)
    found = acceptance(run.comparison, wanted)
    if found is None or wanted.against is None:
        return found
    otherwise = earlier(wanted.against).varied_otherwise(variants)
    return dataclasses.replace(found, otherwise=(*found.otherwise, *otherwise))


def _of(name: str, judged):
    """A criterion with its variant in its words."""
    text = f"variant={name}: {judged.criterion.text}"
    return dataclasses.replace(judged, criterion=dataclasses.replace(judged.criterion, text=text))


def _changed(name: str, change: Change) -> Change:
    return change if name == BASE else dataclasses.replace(change, model=f"{change.model}, {name}")
