"""The report of the gap workflow: report.html, report.md and gap.json from one set of rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from hydrotwin.discovery.answer.discovery import Discovery, Step
from hydrotwin.discovery.answer.going_on import experiment_sentence, untried_sentences
from hydrotwin.discovery.answer.words import certainty, joined, lowered, percent, placed, sentence
from hydrotwin.records.between import between

from .fit import parameter_rows, parameter_table
from .format import number_text
from .gap_data import accuracy, gap_data
from .gap_figures import (
    candidate_figure,
    experiment_figure,
    moved,
    overlay_groups,
    overlay_plan,
    picture,
    region_groups,
    shift_figure,
    waterfall_figure,
)
from .gap_moved import moved_notes
from .gap_sure import sure_section
from .gap_tables import (
    candidate_tables,
    effect_table,
    headline,
    location_table,
    member_table,
    noise_table,
    recording_tables,
    shift_table,
    timing_table,
    unknown_table,
    untestable_table,
    waterfall_table,
)
from .gap_text import capital
from .gap_words import (
    class_sentence,
    display_units,
    facts,
    notices,
    results,
    tried_last,
    untestable,
)
from .page import Note, Page, Section, write_page
from .provenance import command_line, digest_table, item_table, made_table, versions


def write_gap_report(
    discovery: Discovery, folder: str | Path, *, command: str | None = None, date: datetime | None = None
) -> dict[str, Path]:
    """Write report.html, report.md and gap.json into ``folder``; the paths by "html", "markdown", "json".

    command : as printed under provenance; by default the running command.
    """
    return write_page(gap_page(discovery, command=command, date=date), folder, data_name="gap.json")


def gap_page(discovery: Discovery, *, command: str | None = None, date: datetime | None = None) -> Page:
    """The page of a discovery, not yet written."""
    date = date or datetime.now().astimezone()
    command = command_line() if command is None else command
    shown = display_units(discovery)
    made = (
        _where(discovery, shown),
        _candidates(discovery),
        _effects(discovery),
        sure_section(discovery),
        _plots(discovery, shown),
        _waterfall(discovery),
        _shifts(discovery),
        _apart(discovery),
        _recordings(discovery, shown),
        _unknown(discovery),
        _untestable(discovery),
        _findings(discovery),
        _noise(discovery, shown),
        _provenance(discovery, command, date),
    )
    extra = {"created": date.isoformat(timespec="seconds"), "command": command, "versions": versions()}
    return Page(
        title=f"{discovery.name}: {title_of(discovery)}",
        eyebrow=_eyebrow(discovery, date),
        answer=discovery.answer,
        picture=picture(discovery, shown),
        results=results(discovery),
        facts=facts(discovery, shown),
        notices=(*untried_sentences(discovery), *notices(discovery, shown)),
        headline=headline(discovery, shown),
        sections=tuple(s for s in made if s.parts),
        data=gap_data(discovery) | extra,
    )


TITLES = {
    "named": "the missing effect",
    "class": "the missing effect, one of several",
    "none": "no gap",
    "unknown": "a gap without a name",
}


def title_of(discovery: Discovery) -> str:
    """What the page is about in a few words: a part may have a name where the gap has none."""
    partly = discovery.verdict == "unknown" and discovery.steps
    return "a part of the missing effect" if partly else TITLES[discovery.verdict]


def _eyebrow(discovery: Discovery, date: datetime) -> str:
    records = sum(discovery.given.values())
    tried = discovery.screened
    words = [f"Gap of {discovery.name}"]
    words += [f"{records} recording{'s' * (records != 1)}"] * bool(records)
    words += [f"{tried} candidate{'s' * (tried != 1)}"] * bool(tried)
    return " · ".join([*words, f"{number_text(discovery.seconds, 2)} s", f"{date:%-d %B %Y}"])


def _where(discovery: Discovery, shown: Mapping[str, str]) -> Section:
    lead = (
        "The free run of the identified model against the measurement. The maps show the mean error, model minus "
        "measurement, in bins of one quantity with plus and minus one standard error; a filled marker differs from "
        "zero (after Holm, autocorrelation counted), an open one does not."
    )
    if discovery.steps:
        lead += " Before and after share one scale."
    parts = (*((location_table(discovery),) if discovery.locations else ()), *region_groups(discovery, shown))
    gap = discovery.verdict != "none"
    title = "Where model and measurement disagree" if gap else "Model against measurement"
    return Section("where", title, parts, lead)


def _candidates(discovery: Discovery) -> Section:
    lead = (
        "Every effect of the catalogue at every place it fits. Promise: the part of the gap that a few steps promise "
        "it would close, – where nobody looked. What promises most is fitted to whole recordings together with the "
        "base parameters. Gap closed is the share of the squared gap on the recordings of the fit."
    )
    parts: list = []
    for k, step in enumerate(discovery.steps, 1):
        parts += _look(step.ranked, f"candidates_{k}", _title(discovery, k, step))
    if discovery.last_ranked:
        parts += _look(discovery.last_ranked, "candidates_last", "Last look" if discovery.steps else "")
    return Section("candidates", "Candidates and their evidence", tuple(parts), lead)


def _title(discovery: Discovery, number: int, step: Step) -> str:
    """Which look a table of candidates shows: after what was named before, or again beside all the others."""
    there = [s for s in discovery.steps if (s.effect, s.site) in step.beside]
    if not there:
        return "First look" if number == 1 else f"Look {number}"
    again = any(s in there for s in discovery.steps[number:])
    return f"Look {number}{', again: beside' if again else ': after'} {joined([placed(s) for s in there])}"


def _look(ranked, id: str, title: str) -> list:
    if not ranked:
        return []
    first, *rest = candidate_tables(ranked, id, title)
    figure = candidate_figure(ranked, id.replace("_", "-"))
    return [first, *([figure] if figure else []), *rest]


def _effects(discovery: Discovery) -> Section:
    parts: list = []
    for k, step in enumerate(discovery.steps, 1):
        parts += [Note(_about(step, k, len(discovery.steps))), effect_table(step, f"effect_{k}")]
        if len(step.members) > 1:
            parts.append(member_table(step, f"members_{k}"))
    title = "The missing effect" if len(discovery.steps) == 1 else "The missing effects"
    lead = (
        "Fitted together with the base parameters to all recordings but the never used; intervals allow for coloured "
        "errors. The gap that it closes is that of the search."
    )
    return Section("effects", title, tuple(parts), lead)


def _about(step: Step, number: int, of: int) -> tuple[str, ...]:
    order = f"{number}. " if of > 1 else ""
    told = [f"{order}{capital(placed(step))}{': ' if step.equation else ''}{step.equation}"]
    closed = f" It closes {percent(step.gap_closed)} of the gap that it met."
    told.append(f"Probability {certainty(step.probability)}.{closed if percent(step.gap_closed) != '–' else ''}")
    if step.sentence:
        told.append(f"What shows it best: {lowered(sentence(step.sentence))}")
    return tuple(told)


def _plots(discovery: Discovery, shown: Mapping[str, str]) -> Section:
    title = "Measured, before and after" if discovery.steps else "Measured and simulated"
    lead = "The error below each plot is model minus measurement. "
    lead += "All numbers come from the full recordings, and the curves keep every peak."
    drawn = len(overlay_plan(discovery)[1])
    if drawn < len(discovery.overlays):
        lead += f" {drawn} of {len(discovery.overlays)} recordings are drawn, those never used for fitting first."
    return Section("plots", title, tuple(overlay_groups(discovery, shown)), lead)


def _waterfall(discovery: Discovery) -> Section:
    parts = (waterfall_figure(discovery), waterfall_table(discovery)) if len(discovery.waterfall) > 1 else ()
    lead = (
        "The root of the mean squared error over noise of all outputs on the recordings of the fit, as the "
        "search left it: 1 is the noise of the sensors. Gap closed is the share of the squared gap."
    )
    return Section("waterfall", "What each effect closes", parts, lead)


def _shifts(discovery: Discovery) -> Section:
    if not (discovery.shifts and discovery.steps):
        return Section("shifts", "How the base parameters moved", ())
    lead = "Without the missing effect the free parameters of the base model made up for it as far as they could."
    known = any(moved(s) == moved(s) for s in discovery.shifts)
    parts: list = [
        *moved_notes(discovery),
        shift_table(discovery),
        *([shift_figure(discovery.shifts)] if known else []),
    ]
    if getattr(discovery.fit_after, "parameters", ()):
        rows = parameter_table(parameter_rows(discovery.fit_after), "fit_after")
        note = "Intervals of the fit alone. Those of the effects above also allow for the form of the law."
        title = "All free parameters of the model with its effects"
        parts.append(replace(rows, title=title, note=note, folded=True))
    return Section("shifts", "How the base parameters moved", tuple(parts), lead)


def _apart(discovery: Discovery) -> Section:
    told = tuple(t for t in (class_sentence(discovery), experiment_sentence(discovery)) if t)
    if not told and discovery.steps:
        told = ("No other candidate explains the recordings as well and as simply as what was named.",)
    e = discovery.experiment
    figure = (experiment_figure(e),) if e is not None and len(e.time) else ()
    return Section("apart", "What could not be told apart", (Note(told), *figure) if told else ())


def _recordings(discovery: Discovery, shown: Mapping[str, str]) -> Section:
    lead = (
        "Every recording is an operating point: an effect that helps one and ruins another is not the effect. "
        "“Never used” recordings are neither fitted to nor used for choosing among the candidates. The errors are "
        "those of the final fits, which are to all the others."
    )
    return Section("recordings", "Recording by recording", tuple(recording_tables(discovery, shown)), lead)


def _unknown(discovery: Discovery) -> Section:
    rows = discovery.unknown
    told = tuple(capital(sentence(u.sentence)) for u in rows if u.sentence)
    lead = "What is left, described by what was recorded. It has no physical name: take it as a hint where to look."
    parts = (*((Note(told),) if told else ()), *((unknown_table(rows),) if rows else ()))
    if discovery.verdict == "unknown" and not rows:
        near = tried_last(discovery)
        last = f"None of the {len(near)} candidates of the last look explains what is left"
        parts = (Note((f"{last}, and no description of it was found.",)),)
    return Section("unknown", "What remains unknown", parts, lead if rows else "")


def _untestable(discovery: Discovery) -> Section:
    rows = untestable(discovery)
    lead = "These effects may be there: with the excitation and the sensors of these recordings nobody could see them."
    return Section("not-testable", "What these recordings cannot test", (untestable_table(rows),) if rows else (), lead)


def _findings(discovery: Discovery) -> Section:
    told = tuple(capital(sentence(str(f))) for f in discovery.findings)
    return Section("findings", "What else was found", (Note(told),) if told else ())


def _noise(discovery: Discovery, shown: Mapping[str, str]) -> Section:
    lead = (
        "What no model can explain: from the fourth differences, in quiet blocks, of the measured signals and of what "
        "the model leaves of them, whichever is less; or as it was told."
    )
    return Section("noise", "Noise of the sensors", (noise_table(discovery, shown),) if discovery.noise else (), lead)


def _provenance(discovery: Discovery, command: str, date: datetime) -> Section:
    records = getattr(discovery.fit_after, "records", ())
    digests = digest_table(records) if records else None
    fitted = {r.name for r in records}
    rest = {name: value for name, value in discovery.provenance.items() if name not in fitted}
    origin = item_table(rest, title="Recordings never used" if digests else "Recordings")
    inputs = item_table(between(discovery.model.flat.inputs), "inputs", "Inputs between their samples")
    reached = item_table({k: str(v) for k, v in accuracy(discovery).items()}, "accuracy", "Accuracy of the runs")
    parts = [p for p in (digests, origin, inputs, reached) if p]
    return Section("provenance", "Provenance", (*parts, timing_table(discovery), made_table(command, date)))
