"""Parameters that moved: which, how far, and why that is plausible; the ones that rest on a bound are warned of."""

from __future__ import annotations

from hydrotwin.discovery.answer.discovery import Discovery, Shift

from .format import number_text, shown_unit, to_shown, with_unit
from .gap_figures import moved
from .page import Note

CHANCE = 2.0  # sigmas of the difference: less is no move
DIGITS = 4  # of a value, more where before and after would read the same
FINEST = 9  # digits
TOLD = 6  # parameters told in words; the table has all


def moved_notes(discovery: Discovery) -> tuple[Note, ...]:
    """A sentence for each free parameter that moved by more than chance, and a warning of those on a bound."""
    bounds = tuple(_on_bound(s) for s in discovery.shifts if s.at_bound)
    return (Note(moved_sentences(discovery)), *([Note(bounds, "warning")] if bounds else []))


def moved_sentences(discovery: Discovery) -> tuple[str, ...]:
    """The free parameters that moved by more than two sigmas, furthest first: from, to, and why."""
    rows = sorted((s for s in discovery.shifts if abs(moved(s)) > CHANCE), key=lambda s: -abs(moved(s)))
    if not rows:
        return ("No free parameter moved by more than two standard deviations of the difference.",)
    why = _why(discovery)
    told = [f"{s.name} {_from_to(s)}{why if k == 0 else _likewise(why)}." for k, s in enumerate(rows[:TOLD])]
    if len(rows) > TOLD:
        more = len(rows) - TOLD
        told.append(f"{more} more parameter{'s' * (more > 1)} moved by more than chance: see the table.")
    return tuple(told)


def _why(discovery: Discovery) -> str:
    """The reason of a move: a model that lacks an effect bends its parameters; nothing where none was named."""
    if not discovery.steps:
        return ""
    effects = "effect" if len(discovery.steps) == 1 else "effects"
    return f", because before it stood in for the missing {effects}"


def _likewise(why: str) -> str:
    return ", for the same reason" if why else ""


def _from_to(s: Shift) -> str:
    """``moved from .. to ..``, and how far that is, in the unit of the tables."""
    unit = shown_unit(s.unit, peak=max(abs(s.before), abs(s.after)))
    before, after = (float(to_shown(v, s.unit, unit)) for v in (s.before, s.after))
    digits = DIGITS
    while digits < FINEST and number_text(before, digits) == number_text(after, digits):
        digits += 1
    words = [with_unit(number_text(v, digits), unit).replace(" ", "\u00a0") for v in (before, after)]
    return f"moved from {words[0]} to {words[1]} ({number_text(abs(moved(s)), 2)} standard deviations)"


def _on_bound(s: Shift) -> str:
    unit = shown_unit(s.unit, peak=abs(s.after))
    value = with_unit(number_text(float(to_shown(s.after, s.unit, unit))), unit).replace(" ", "\u00a0")
    return f"{s.name} rests on its bound at {value}: read no physics into the value, or widen the bound."
