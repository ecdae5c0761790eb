"""What the first screen of a gap report says: which effect, where, how much, how sure, and what is left."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from hydrotwin.discovery.discovery import Discovery, EffectParameter, Experiment, OutputGap, Ranked, Step

from .format import NONE, difference_to_shown, number_text, pretty_unit, shown_unit, to_shown, with_unit

AT_NOISE = 1.1  # times the noise: nothing worth a name is left below this
WORSE = 1.1  # a recording whose RMSE grew by more speaks against the effect
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


def answer(discovery: Discovery) -> str:
    """The result in a sentence: that of the discovery itself, else one made of its verdict."""
    if discovery.answer.strip():
        return discovery.answer.strip()
    if discovery.verdict == "none":
        return "No effect is missing: the model agrees with the recordings to within the noise of the sensors."
    if discovery.verdict == "unknown":
        named = f" beyond {joined([placed(s) for s in discovery.steps])}" if discovery.steps else ""
        return f"Something is missing{named}, and no effect of the catalogue explains it: it gets no physical name."
    found = [_class_words(s) if s.is_class else placed(s) for s in discovery.steps]
    return f"Missing in the model: {joined(found)}."


def facts(discovery: Discovery, shown: Mapping[str, str]) -> tuple[str, ...]:
    """The sentences below the answer."""
    told = [step_sentence(s, k, len(discovery.steps)) for k, s in enumerate(discovery.steps[:TOLD], 1)]
    if len(discovery.steps) > TOLD:
        told.append(f"{len(discovery.steps) - TOLD} more effects were added: see below.")
    if discovery.steps:
        told.append(closed_sentence(discovery, shown))
    told.append(left_sentence(discovery))
    if discovery.verdict == "unknown":
        told += _unknown_sentences(discovery)
    told += [s for s in (class_sentence(discovery), experiment_sentence(discovery)) if s]
    if discovery.verdict in ("none", "unknown"):
        told.append(tried_sentence(discovery))
    return tuple(t for t in told if t)


def notices(discovery: Discovery, shown: Mapping[str, str]) -> tuple[str, ...]:
    """What speaks against the answer: a recording that got worse, values that are not plausible, bounds."""
    found = [
        f"{r.record} ({ROLES.get(r.role, r.role)}): {o.output} got worse, RMSE {_rmse(o, o.rmse_before, shown)} before "
        f"and {_rmse(o, o.rmse_after, shown)} after. An effect that is there improves every operating point."
        for r in discovery.recordings
        for o in r.outputs
        if discovery.steps and o.rmse_after > WORSE * max(o.rmse_before, o.noise)
    ]
    for step in discovery.steps:
        for p in step.parameters:
            if typical_remark(p):
                text = f"{placed(step)}: {p.name} = {value_text(p)} is {typical_remark(p)} ({typical_text(p)})."
                found.append(text)
    bounds = [s.name for s in discovery.shifts if s.at_bound]
    if bounds:
        rest = "rests on its bound" if len(bounds) == 1 else "rest on their bounds"
        found.append(f"{joined(bounds)} {rest}: read no physics into the value, or widen the bound.")
    if len(found) > TOLD:
        found[TOLD:] = [f"{len(found) - TOLD} more warnings are marked in the tables below."]
    return tuple(found)


ROLES = {"fit": "fitted", "select": "chosen by", "report": "never used", "train": "fitted", "validate": "never used"}


def step_sentence(step: Step, number: int = 1, of: int = 1) -> str:
    """The effect, where, its equation with values and intervals in engineering units, and how sure that is."""
    order = f"{number}. " if of > 1 else ""
    values = joined([f"{p.name.rpartition('.')[2]} = {value_text(p)}{interval_words(p)}" for p in step.parameters])
    equation = f"{step.equation}{', with ' if values else ''}{values}" if step.equation else values
    pair = [f"{effect} at {site}" for effect, site in step.together]
    with_it = f" Only together with {joined(pair)} does it explain anything." if pair else ""
    return f"{order}{placed(step)}: {equation}. Probability {percent(step.probability)}.{with_it}"


def closed_sentence(discovery: Discovery, shown: Mapping[str, str]) -> str:
    """How much of the gap the named effects close, on which recordings."""
    rows, fresh = unseen(discovery)
    gaps = [o for o in rows if math.isfinite(o.gap_closed)]
    where = "On recordings never used for fitting" if fresh else "On the recordings of the fit (none were held back)"
    if not gaps:
        return f"{where} there was no measurable gap to close." if rows else ""
    what = "it closes" if len(discovery.steps) == 1 else "they close"
    words = [f"{percent(o.gap_closed)} of the gap of {o.output} ({_from_to(o, shown)})" for o in gaps[:TOLD]]
    if len(gaps) > TOLD:
        low, high = min(gaps, key=lambda o: o.gap_closed), max(gaps, key=lambda o: o.gap_closed)
        first = f"{percent(gaps[0].gap_closed)} of the gap of {gaps[0].output} ({_from_to(gaps[0], shown)})"
        span = f"{percent(low.gap_closed)} ({low.output}) to {percent(high.gap_closed)} ({high.output})"
        words = [first, f"from {span} over all {len(gaps)} outputs with a gap"]
    return f"{where} {what} {joined(words)}."


def left_sentence(discovery: Discovery) -> str:
    """What is left over the noise of the sensors."""
    rows, fresh = unseen(discovery)
    ratio = {o.output: o.rmse_after / o.noise for o in rows if o.noise > 0.0 and math.isfinite(o.rmse_after)}
    if not ratio:
        return ""
    over = {name: r for name, r in ratio.items() if r > AT_NOISE}
    where = "" if fresh else " on the recordings of the fit"
    if not over:
        worst = max(ratio, key=ratio.__getitem__)
        many = f"at most {number_text(ratio[worst])} times ({worst})" if len(ratio) > 1 else number_text(ratio[worst])
        return f"What is left{where} is the noise of the sensors: {many}{'' if len(ratio) > 1 else ' times'}."
    worst = sorted(over, key=over.__getitem__, reverse=True)[:TOLD]
    words = [f"{number_text(over[n], 2)} times the noise on {n}" for n in worst]
    rest = len(ratio) - len(over)
    done = f"; {rest} other output{'s are' if rest > 1 else ' is'} at the noise" if rest else ""
    return f"What is left{where}: {joined(words)}{done}."


def class_sentence(discovery: Discovery) -> str:
    """What these recordings cannot tell apart; empty when one effect stands alone."""
    steps = [s for s in discovery.steps if len(s.members) > 1]
    words = [_class_words(s) for s in steps]
    return f"These recordings cannot tell apart: {'; '.join(words)}." if words else ""


def experiment_sentence(discovery: Discovery) -> str:
    """Which experiment would tell; that there is none when a class has none."""
    e = discovery.experiment
    if e is None:
        split = any(s.is_class for s in discovery.steps)
        return "No input within the limits was found that would tell them apart." if split else ""
    return f"The experiment that would tell: {_lower(e.sentence)} {separation_words(e)}"


def separation_words(experiment: Experiment) -> str:
    """How far apart the members would be, and are now."""
    then, now = number_text(experiment.separation, 2), number_text(experiment.now, 2)
    return f"It sets them {then} times the noise apart; the recordings at hand do by {now}."


def tried_sentence(discovery: Discovery) -> str:
    """How many candidates were looked at, which came nearest, and why it was not named."""
    tried = tried_last(discovery)
    if not tried:
        return ""
    refitted = [r for r in tried if math.isfinite(r.bic_gain)]
    words = f"{len(tried)} candidates were screened and {len(refitted)} of them fitted"
    if discovery.verdict == "none" or not refitted:
        return f"{words}; none is needed."
    best = max(refitted, key=lambda r: r.gap_closed if math.isfinite(r.gap_closed) else -math.inf)
    reason = f" ({_lower(best.reason).rstrip('.')})" if best.reason else ""
    return f"{words}. The nearest, {best.title or best.effect} at {best.site}, was turned down{reason}."


def tried_last(discovery: Discovery) -> tuple[Ranked, ...]:
    """The candidates of the last look, which named nothing."""
    tried = discovery.last_ranked or (discovery.steps[-1].ranked if discovery.steps else ())
    return tuple(r for r in tried if r.fate not in ("not testable", "cannot be added"))


def where_sentences(discovery: Discovery) -> list[str]:
    """Where the model disagrees and what the difference follows, worst output first."""
    worst = sorted(discovery.locations, key=lambda place: -place.times_noise)
    return [f"{sentence(place.where)}{_follows(place.drivers)}" for place in worst if place.where][:TOLD]


def driver_words(drivers: Sequence[tuple[str, float, float]]) -> str:
    """Inputs that a residual follows: name, correlation, lag."""
    return joined(
        [f"{n} (correlation {number_text(c, 2)}{f' after {number_text(t, 2)} s' if t else ''})" for n, c, t in drivers]
    )


def parameter_unit(p: EffectParameter) -> str:
    """The unit that a parameter of an effect is shown in; times under half a second in ms."""
    if p.unit == "s" and abs(p.value) < 0.5:
        return "ms"
    return shown_unit(p.unit, peak=abs(p.value))


def value_texts(p: EffectParameter) -> tuple[str, str, str]:
    """Value, lower and upper limit in the shown unit with the digits that the interval gives sense to."""
    unit = parameter_unit(p)
    value, low, high = (float(to_shown(v, p.unit, unit)) for v in (p.value, p.low, p.high))
    reach = (high - low) / 2
    digits = 3
    if math.isfinite(reach) and reach > 0.0 and value != 0.0:
        digits = min(6, max(3, 2 + math.ceil(math.log10(abs(value) / reach))))
    return number_text(value, digits), number_text(low, digits), number_text(high, digits)


def value_text(p: EffectParameter) -> str:
    """The value with its unit."""
    return with_unit(value_texts(p)[0], parameter_unit(p))


def interval_words(p: EffectParameter) -> str:
    """The 95 % interval in brackets."""
    _, low, high = value_texts(p)
    if not (math.isfinite(p.low) and math.isfinite(p.high)):
        return " (interval not known)"
    return f" (95\u00a0%: {low} to {high})"


def typical_text(p: EffectParameter) -> str:
    """The typical range of the catalogue in the shown unit."""
    if p.typical is None:
        return NONE
    unit = parameter_unit(p)
    low, high = (number_text(float(to_shown(v, p.unit, unit))) for v in p.typical)
    return f"{low} to {high}"


def typical_remark(p: EffectParameter) -> str:
    """That a value lies outside its typical range, when even its interval does; else empty."""
    if p.typical is None:
        return ""
    low = p.low if math.isfinite(p.low) else p.value
    high = p.high if math.isfinite(p.high) else p.value
    if high < p.typical[0]:
        return "below its typical range"
    return "above its typical range" if low > p.typical[1] else ""


def placed(step: Step | Ranked) -> str:
    """Title and site in words."""
    title = step.title or step.effect
    return f"{title} at {step.site}" if step.site else title


def percent(share: float) -> str:
    """A share as percent: whole numbers, a decimal from 99 on, never a rounded 100.

    >>> percent(0.873), percent(0.9934), percent(0.99996), percent(float("nan"))
    ('87 %', '99.3 %', 'over 99.9 %', '–')
    """
    if not math.isfinite(share):
        return NONE
    if 0.9995 <= share < 1.0:
        return "over 99.9\u00a0%"
    text = f"{100.0 * share:.{1 if 0.99 <= share < 1.0 else 0}f}".replace("-", "−")
    return f"{'0' if text in ('−0', '0') else text}\u00a0%"


def joined(words: Sequence[str]) -> str:
    """a, b and c."""
    words = list(words)
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def sentence(text: str) -> str:
    """A text as a sentence: with a full stop."""
    text = text.strip()
    return text if not text or text.endswith((".", "!", "?")) else f"{text}."


def _unknown_sentences(discovery: Discovery) -> list[str]:
    told = where_sentences(discovery)[:2]
    return told + [f"{sentence(u.sentence)}" for u in discovery.unknown[:2] if u.sentence]


def _class_words(step: Step) -> str:
    known = {(r.effect, r.site): r for r in step.ranked}
    words = []
    for effect, site in step.members:
        row = known.get((effect, site))
        name = placed(row) if row else f"{effect} at {site}"
        words.append(f"{name} ({percent(row.probability)})" if row and math.isfinite(row.probability) else name)
    return " or ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def _follows(drivers) -> str:
    return f" It follows {driver_words(drivers)}." if drivers else ""


def _from_to(o: OutputGap, shown: Mapping[str, str]) -> str:
    return f"RMSE {_rmse(o, o.rmse_before, shown)} to {_rmse(o, o.rmse_after, shown)}"


def _rmse(o: OutputGap, value: float, shown: Mapping[str, str]) -> str:
    unit = shown.get(o.output, o.unit)
    return with_unit(number_text(float(difference_to_shown(value, o.unit, unit))), unit)


def _lower(text: str) -> str:
    """A sentence inside another: without its capital, unless its first word is a name or an abbreviation."""
    text = sentence(text)
    first = text.split(" ", 1)[0]
    return text[:1].lower() + text[1:] if first[1:].islower() or len(first) == 1 else text


def _peak(discovery: Discovery, output: str) -> float:
    sizes = [np.nanmax(np.abs(o.measured[output])) for o in discovery.overlays if output in o.measured]
    return float(max(sizes, default=0.0))


def unit_label(unit: str) -> str:
    """`` [unit]`` for an axis or heading, empty without a unit."""
    label = pretty_unit(unit)
    return f" [{label}]" if label else ""
