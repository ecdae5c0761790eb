"""What the first screen of a gap report says: which effect, where, how much, how sure, and what is left."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from hydrotwin.discovery.answer.discovery import Discovery, OutputGap, Ranked, Step
from hydrotwin.discovery.answer.going_on import experiment_sentence
from hydrotwin.discovery.answer.words import (
    ALMOST_ALL,
    certainty,
    class_words,
    joined,
    lowered,
    percent,
    placed,
    sentence,
)

from .format import difference_to_shown, number_text, shown_unit, with_unit
from .gap_text import (
    capital,
    interval_words,
    largest,
    typical_remark,
    typical_text,
    value_text,
)

AT_NOISE = 1.1  # times the noise: nothing worth a name is left below this
BEYOND_COUNTING = 1000.0  # times the noise: the error itself says more
WORSE = 1.1  # a recording whose RMSE grew by more speaks against the effect
NOT_JUDGED = ("not testable", "cannot be added")
TOLD = 3  # outputs, places and effects told on the first screen; the tables below have all


def display_units(discovery: Discovery) -> dict[str, str]:
    """The unit that every output is shown in."""
    units = {r.output: r.unit for r in discovery.regions}
    units |= {o.output: o.unit for rows in discovery.outputs.values() for o in rows}
    units |= {o.output: o.unit for r in discovery.recordings for o in r.outputs}
    return {name: shown_unit(unit, peak=_peak(discovery, name)) for name, unit in units.items()}


def unseen(discovery: Discovery) -> tuple[tuple[OutputGap, ...], bool]:
    """The outputs pooled over the recordings never used for fitting, and true; those of the fit when there are none."""
    rows = tuple(discovery.outputs.get("validate", ()))
    return (rows, True) if rows else (tuple(discovery.outputs.get("train", ())), False)


def results(discovery: Discovery) -> tuple[str, ...]:
    """What was named, each with equation, values, intervals and probability; every member of a class."""
    many = len(discovery.steps) > 1
    told = []
    for k, step in enumerate(discovery.steps[:TOLD], 1):
        lines = member_sentences(step) if len(step.members) > 1 else [step_sentence(step)]
        told += [f"{k}. {line}" if many and n == 0 else line for n, line in enumerate(lines)]
    if len(discovery.steps) > TOLD:
        told.append(f"{len(discovery.steps) - TOLD} more effects were added: see below.")
    if discovery.verdict == "unknown" and not discovery.steps:
        told += where_sentences(discovery)[:2]
    return tuple(told)


def facts(discovery: Discovery, shown: Mapping[str, str]) -> tuple[str, ...]:
    """The sentences below the answer."""
    told = []
    if discovery.steps:
        told.append(closed_sentence(discovery, shown))
    told.append(left_sentence(discovery, shown))
    told += [capital(sentence(u.sentence)) for u in discovery.unknown[:TOLD] if u.sentence]
    if any(len(s.members) > 1 for s in discovery.steps):
        told.append(f"These recordings cannot tell them apart. {experiment_sentence(discovery)}")
    if discovery.verdict in ("none", "unknown"):
        told += [] if discovery.steps else [tried_sentence(discovery)]
        told += [untestable_sentence(discovery)]
    return tuple(t for t in told if t)


def notices(discovery: Discovery, shown: Mapping[str, str]) -> tuple[str, ...]:
    """What speaks against the answer: a recording that got worse, values that are not plausible, bounds."""
    found = []
    judged = (o for r in discovery.recordings if r.role == "report" for o in r.outputs)
    if discovery.steps and not any(math.isfinite(o.gap_closed) for o in judged):
        found.append(
            "No recording confirms this: none that took no part shows the gap. Record another run that moves like "
            "those, and give it with --validate."
        )
    for r in discovery.recordings if discovery.steps else ():
        worse = [f"{o.output} (RMSE {_change(o, shown)})" for o in r.outputs if got_worse(o)]
        if worse:
            place = f"{r.record} ({ROLES.get(r.role, r.role)}) got worse on {joined(worse)}"
            found.append(f"{place}. An effect that is there improves every operating point, or leaves it alone.")
    for step in discovery.steps:
        for p in step.parameters:
            if typical_remark(p):
                text = (
                    f"{capital(placed(step))}: {p.name} = {value_text(p)} is {typical_remark(p)} ({typical_text(p)})."
                )
                found.append(text)
    bounds = [s.name for s in discovery.shifts if s.at_bound]
    if bounds:
        rest = "rests on its bound" if len(bounds) == 1 else "rest on their bounds"
        found.append(f"{joined(bounds)} {rest}: read no physics into the value, or widen the bound.")
    if len(found) > TOLD:
        more = len(found) - TOLD
        found[TOLD:] = [f"{more} more warning{'s are' if more > 1 else ' is'} marked in the tables below."]
    return tuple(found)


ROLES = {"fit": "fitted", "report": "never used", "train": "fitted", "validate": "never used"}


def step_sentence(step: Step) -> str:
    """The effect, where, its equation with values and intervals in engineering units, and how sure that is."""
    pair = [f"{effect} at {site}" for effect, site in step.together]
    with_it = f" Found together with {joined(pair)}; alone it explains less." if pair else ""
    return f"{capital(placed(step))}: {_formula(step)}. Probability {certainty(step.probability)}.{with_it}"


def member_sentences(step: Step) -> list[str]:
    """A sentence like that of `step_sentence` for each member of a class: either this, or that."""
    known = {(r.effect, r.site): r for r in step.ranked} | {(step.effect, step.site): step}
    told = []
    for k, (effect, site) in enumerate(step.members[:TOLD]):
        row, start = known.get((effect, site)), "Or" if k else "Either"
        if row is None:
            told.append(f"{start} {effect} at {site}.")
        else:
            sure = f", probability {certainty(row.probability)}" if math.isfinite(row.probability) else ""
            formula = _formula(row)
            told.append(f"{start} {lowered(placed(row))}{sure}{': ' if formula else ''}{formula}.")
    rest = [f"{effect} at {site}" for effect, site in step.members[TOLD:]]
    if len(rest) > TOLD:
        told.append(f"Or one of {len(rest)} others, listed below.")
    elif rest:
        told.append(f"Or {' or '.join(rest)}.")
    return told


def _formula(row: Step | Ranked) -> str:
    values = joined([f"{p.name.rpartition('.')[2]} = {value_text(p)}{interval_words(p)}" for p in row.parameters])
    return ", with ".join(t for t in (row.equation, values) if t)


def closed_sentence(discovery: Discovery, shown: Mapping[str, str]) -> str:
    """How much of the gap the named effects close, on which recordings."""
    rows, fresh = unseen(discovery)
    gaps = [o for o in rows if math.isfinite(o.gap_closed)]
    where = "On recordings never used for fitting" if fresh else "On the recordings of the fit (none were held back)"
    if not gaps:
        return f"{where} there was no measurable gap to close." if rows else ""
    what = "it closes" if len(discovery.steps) == 1 else "they close"
    words = [f"{percent(o.gap_closed)} of the gap of {o.output} (RMSE {_change(o, shown)})" for o in gaps[:TOLD]]
    if len(gaps) > TOLD:
        words = [words[0], _span(gaps[1:])]
    return f"{where} {what} {joined(words)}."


def _span(gaps: Sequence[OutputGap]) -> str:
    """From the least to the most that is closed of several outputs."""
    low, high = min(gaps, key=lambda o: o.gap_closed), max(gaps, key=lambda o: o.gap_closed)
    if low.gap_closed >= 0.9995 or percent(low.gap_closed) == percent(high.gap_closed):
        return f"{percent(min(low.gap_closed, ALMOST_ALL))} of that of each of the {len(gaps)} others"
    span = f"{percent(low.gap_closed)} ({low.output}) to {percent(high.gap_closed)} ({high.output})"
    return f"from {span} of those of the {len(gaps)} others"


def left_sentence(discovery: Discovery, shown: Mapping[str, str]) -> str:
    """What is left over the noise of the sensors."""
    rows, fresh = unseen(discovery)
    ratio = {o.output: o.rmse_after / o.noise for o in rows if o.noise > 0.0 and math.isfinite(o.rmse_after)}
    if not ratio:
        return ""
    over = {name: r for name, r in ratio.items() if r > AT_NOISE}
    where = "What is left"
    if not discovery.steps:
        where = (
            f"The error of the model on {'recordings never used for fitting' if fresh else 'the recordings of the fit'}"
        )
    if not over:
        worst = max(ratio, key=ratio.__getitem__)
        return f"{where} is the noise of the sensors: at most {number_text(ratio[worst])} times it, on {worst}."
    worst = sorted(over, key=over.__getitem__, reverse=True)[:TOLD]
    by_name = {o.output: o for o in rows}
    words = [_over_noise(by_name[n], over[n], shown) for n in worst]
    rest = len(ratio) - len(over)
    done = f"; {rest} other output{'s are' if rest > 1 else ' is'} at the noise" if rest else ""
    return f"{where}: {joined(words)}{done}."


def _over_noise(o: OutputGap, times: float, shown: Mapping[str, str]) -> str:
    if times < BEYOND_COUNTING:
        return f"{number_text(times, 2)} times the noise on {o.output}"
    return f"{_rmse(o, o.rmse_after, shown)} on {o.output}, whose sensor is far finer"


def class_sentence(discovery: Discovery) -> str:
    """What these recordings cannot tell apart; empty when one effect stands alone."""
    steps = [s for s in discovery.steps if len(s.members) > 1]
    words = [class_words(s) for s in steps]
    return f"These recordings cannot tell apart: {'; '.join(words)}." if words else ""


def tried_sentence(discovery: Discovery) -> str:
    """How many candidates were looked at, which came nearest, and why it was not named."""
    tried = tried_last(discovery)
    if not tried:
        return ""
    fitted = [r for r in tried if math.isfinite(r.left)]
    words = f"{discovery.screened} candidates were looked at and {discovery.fitted} of them fitted"
    if discovery.verdict == "none":
        return f"{words}; none is needed."
    if not fitted:
        return f"{words}; none is named."
    best = min(fitted, key=lambda r: r.left)
    reason = f" ({lowered(best.reason).rstrip('.')})" if best.reason else ""
    return f"{words}; none is named. The nearest, {lowered(placed(best))}, was turned down{reason}."


def untestable(discovery: Discovery) -> tuple[Ranked, ...]:
    """Candidates that these recordings cannot judge, each once."""
    ranked = (*discovery.last_ranked, *(r for s in discovery.steps for r in s.ranked))
    rows = (*discovery.not_testable, *(r for r in ranked if r.fate in NOT_JUDGED))
    return tuple({(r.effect, r.site): r for r in rows[::-1]}.values())[::-1]


def untestable_sentence(discovery: Discovery) -> str:
    """Which effects may be there all the same."""
    rows = untestable(discovery)
    if not rows:
        return ""
    words = [lowered(placed(r)) for r in rows[:TOLD]]
    more = f" and {len(rows) - TOLD} more" if len(rows) > TOLD else ""
    listed = f"{', '.join(words)}{more}" if more else joined(words)
    return f"These recordings cannot judge {listed}: that would not have been seen."


def got_worse(o: OutputGap) -> bool:
    """The error grew by more than the noise lets it."""
    return o.rmse_after > WORSE * max(o.rmse_before, o.noise)


def tried_last(discovery: Discovery) -> tuple[Ranked, ...]:
    """The candidates of the last look, which named nothing."""
    tried = discovery.last_ranked or (discovery.steps[-1].ranked if discovery.steps else ())
    return tuple(r for r in tried if r.fate not in NOT_JUDGED)


def where_sentences(discovery: Discovery) -> list[str]:
    """Where the model disagrees and what the difference follows, worst output first."""
    off = [place for place in discovery.locations if place.times_noise > AT_NOISE]
    worst = sorted(off, key=lambda place: -place.times_noise)
    return [f"{capital(sentence(place.where))}{_follows(place.drivers)}" for place in worst if place.where][:TOLD]


def driver_words(drivers: Sequence[tuple[str, float, float]]) -> str:
    """Inputs that a residual follows: name, correlation, lag."""
    return joined(
        [f"{n} (correlation {number_text(c, 2)}{f' after {number_text(t, 2)} s' if t else ''})" for n, c, t in drivers]
    )


def _follows(drivers) -> str:
    return f" It follows {driver_words(drivers)}." if drivers else ""


def _change(o: OutputGap, shown: Mapping[str, str]) -> str:
    return f"{_rmse(o, o.rmse_before, shown)} to {_rmse(o, o.rmse_after, shown)}"


def _rmse(o: OutputGap, value: float, shown: Mapping[str, str]) -> str:
    unit = shown.get(o.output, o.unit)
    return with_unit(number_text(float(difference_to_shown(value, o.unit, unit))), unit)


def _peak(discovery: Discovery, output: str) -> float:
    return max((largest(o.measured[output]) for o in discovery.overlays if output in o.measured), default=0.0)
