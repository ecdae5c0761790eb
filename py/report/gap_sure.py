"""How sure the answer is: the probabilities of nothing, of every likely structure, and of something else."""

from __future__ import annotations

from collections.abc import Mapping

from hydrotwin.discovery.answer.discovery import Discovery
from hydrotwin.discovery.answer.going_on import label_of, names_of, structure_words, untried_sentences
from hydrotwin.discovery.answer.standing import UNSEEN
from hydrotwin.discovery.answer.words import certainty

from .figure import Figure
from .gap_figures import AFTER, AS_WELL, BEFORE, FAINT, lying_bars
from .gap_text import capital
from .page import Note, Section
from .tables import Cell, Column, Table, table, texts

NOTHING, ELSE = "nothing", "something else"  # keys of `Discovery.probabilities` beside the structures
OWN = {  # what is no structure, in a sentence and at a bar
    NOTHING: ("that nothing is missing", "Nothing"),
    UNSEEN: ("that it is an effect which the search had no time to look at", "An effect that was not looked at"),
}
TOLD = 3  # structures in the sentence; the table has all
SMALL = 0.005  # a probability that is not worth a word
LEAST = 1e-9  # nothing is impossible


def sure_section(discovery: Discovery) -> Section:
    """The section: a sentence, what a longer search would try, the bars, the table."""
    told = (*sure_sentences(discovery), *untried_sentences(discovery))
    drawn = (sure_figure(discovery), sure_table(discovery)) if discovery.probabilities else ()
    lead = (
        "Everything that was fitted competes: the model as it is, each effect, and effects together. A law that is "
        "only roughly the machine's is allowed for, each effect and each parameter has its price, and a part is kept "
        "for what no catalogue holds."
    )
    if discovery.steps:
        lead += " Where a recording never used speaks against an effect, its own probability above is lower."
    return Section("sure", "How sure", (*([Note(told)] if told else ()), *drawn), lead if drawn else "")


def sure_sentences(discovery: Discovery) -> tuple[str, ...]:
    """The probabilities in a sentence, and that recordings never used say otherwise where they do."""
    odds = discovery.probabilities
    if not odds:
        return ()
    likely = sorted((k for k in odds if k != ELSE and odds[k] >= SMALL), key=lambda k: -odds[k])
    words = [f"{certainty(odds[k])} {_as_clause(k, discovery)}" for k in likely[:TOLD]]
    rest = sum(odds[k] for k in likely[TOLD:]) + others(odds)
    if rest >= SMALL:
        words.append(f"{certainty(rest)} for others, each less likely")
    words.append(f"{certainty(max(odds.get(ELSE, 0.0), LEAST))} that something else is missing which the catalogue "
                 "does not hold")  # fmt: skip
    told = [f"{'; '.join(words)}."]
    if discovery.verdict == "unknown" and max(odds, key=odds.__getitem__) != ELSE:
        told.append("This weighs the recordings that were fitted to. Those never used do not bear it out.")
    return tuple(told)


def sure_table(discovery: Discovery) -> Table:
    """What may be missing, most likely first, something else last."""
    rows = _rows(discovery)
    cells = tuple(Cell(p, certainty(p)) for _, p, _ in rows)
    columns = [
        texts("missing", "What is missing", [label for label, _, _ in rows], [colour for _, _, colour in rows]),
        Column("probability", "Probability", cells, numeric=True),
    ]
    return table("sure", "", columns)


def sure_figure(discovery: Discovery) -> Figure:
    """The same as bars."""
    rows = _rows(discovery)
    labels, odds, colours = zip(*rows, strict=True)
    caption = "Dark: named. Light blue: could be in its place. Grey: turned down. Orange: not in the catalogue."
    return lying_bars("sure-bars", "probability [%]", labels, odds, [certainty(p) for p in odds], colours, caption)


def others(odds: Mapping[str, float]) -> float:
    """What is left for structures that are too unlikely to be told one by one."""
    rest = 1.0 - sum(odds.values())
    return rest if rest >= SMALL else 0.0


def _rows(discovery: Discovery) -> list[tuple[str, float, str]]:
    """Label, probability and colour of each bar."""
    odds, names = discovery.probabilities, names_of(discovery)
    found = []
    for key in sorted((k for k in odds if k != ELSE), key=lambda k: -odds[k]):
        label = OWN[key][1] if key in OWN else capital(structure_words(key, names))
        found.append((label, float(odds[key]), _colour(key, discovery)))
    if others(odds):
        found.append(("Others, each less likely", others(odds), FAINT))
    return [*found, ("Something that the catalogue does not hold", float(odds.get(ELSE, 0.0)), BEFORE)]


def _colour(key: str, discovery: Discovery) -> str:
    if key == NOTHING:
        return AFTER if discovery.verdict == "none" else FAINT
    labels = set(key.split(" + "))
    named = {label_of(s.effect, s.site) for s in discovery.steps}
    members = {label_of(*m) for s in discovery.steps for m in s.members}
    if labels == named:
        return AFTER
    return AS_WELL if len(labels) == len(named) and labels <= named | members else FAINT


def _as_clause(key: str, discovery: Discovery) -> str:
    return OWN[key][0] if key in OWN else f"for {structure_words(key, names_of(discovery))}"
