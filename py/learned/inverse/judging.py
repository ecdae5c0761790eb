"""How well an inverse or a compensator holds at commands that it was not learnt from, beside what costs little.

The inverse g is learnt once more, in the same way, without a fifth of the steady points. At every point left out, a
command u that gave the rate r,

    error = g^-1(u) - r

is the rate for which g gives that command, less the one that was measured. Where every sample of a recording counts,
points share samples: there the ends of the recordings are left out, and are turned into points of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, HydrotwinError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import Block

from .. import held_out
from ..block_file import LearnedBlock
from ..report_card import BLOCK, MEAN, STEADY, Row, Words, card_of, carded, further, shown, unknown
from ..verdicts import rms_of
from .compensator import DesiredCurve, desired_curve, learn_compensator
from .curve import GRID, static_answer
from .data import Characteristic, characteristic
from .held import UNSETTLED
from .learn import learn_inverse
from .stretches import COVERED, LEAST_POINTS

EVERY = 5  # of the points, in the order of their commands, one is left out
LINE, ALONE = "a straight line", "the machine alone"  # the second is beside a compensator only
YARDSTICKS = {"invert": (MEAN, LINE), "compensate": (MEAN, LINE, ALONE)}
LEFT_OUT = "steady points that were left out"
OF_ENDS = "points of the ends of the recordings, which were left out"
FEWEST = 3  # points that a desired curve must leave to be judged by


@dataclass(frozen=True, eq=False)
class _Apart:
    """What is learnt from, and the points left out: commands and rates (n,), SI; ``words``: what they are."""

    fit: Characteristic
    commands: np.ndarray
    rates: np.ndarray
    words: str


def judged_inverse(
    source, input: Signal | str | None, output: Signal | str | None, *, forward: Characteristic | None = None, **options
) -> LearnedBlock:
    """`learn_inverse`, with a card in ``provenance["held_out"]``: errors at points left out, in the rate's unit.

    The block itself is learnt from all points. ``forward`` is the characteristic of the source where it is known.
    Options and errors: those of `learn_inverse`. A card that cannot be made says why.
    """
    steady, learning = _two(options)
    forward = forward or characteristic(source, input, output, **steady)
    block = learn_inverse(forward, **learning)
    return _carded(block, forward, (source, input, output, steady), learning, None)


def judged_compensator(
    source,
    input: Signal | str | None,
    output: Signal | str | None,
    waypoints: Sequence[tuple[float, float]],
    *,
    forward: Characteristic | None = None,
    **options,
) -> LearnedBlock:
    """`learn_compensator`, with a card as `judged_inverse` has it, over the rates that the curve asks for."""
    steady, learning = _two(options)
    forward = forward or characteristic(source, input, output, **steady)
    block = learn_compensator(forward, None, None, waypoints, **learning)
    curve = desired_curve(waypoints, learning.pop("degree", None))
    return _carded(block, forward, (source, input, output, steady), learning, curve)


def judged_signal(rate: Signal) -> Signal:
    """The rate that is judged: as it is measured, not as it is wanted."""
    return replace(rate, name=rate.name.removeprefix("wanted_"))


def _two(options: Mapping) -> tuple[dict, dict]:
    """Options of `characteristic`, and those of the learning."""
    steady = {k: v for k, v in options.items() if k in characteristic.__kwdefaults__}
    return steady, {k: v for k, v in options.items() if k not in steady}


def _carded(block: LearnedBlock, forward: Characteristic, given: tuple, learning: Mapping, curve) -> LearnedBlock:
    again = {k: v for k, v in learning.items() if k not in ("name", "progress")}
    try:
        apart = _apart(forward, given)
        inverse = learn_inverse(apart.fit, **again)
        told = _card(inverse, apart, forward, given[0], curve)
    except DeclarationError:
        raise
    except HydrotwinError as error:
        told = unknown(f"{error} How well it holds at other commands is not known.", Words(_wrong(forward, given[0])))
    except KeyboardInterrupt:  # the block is learnt: it is not lost because nobody waits for its card
        why = "the card was interrupted. How well it holds at other commands is not known."
        told = unknown(why, Words(_wrong(forward, given[0])))
    return replace(block, provenance={**block.provenance, STEADY: told})


def _apart(forward: Characteristic, given: tuple) -> _Apart:
    """A fifth of the points left out, or the ends of recordings whose every sample counts."""
    source, input_, output, steady = given
    if "moving_points" in forward.source:
        records = [source] if isinstance(source, Record) else list(source)
        split = held_out.split(records, [forward.input.name], [getattr(output, "name", output)])
        if not split.parts:
            raise DataError(f"{split.why.rstrip('.')}. Record longer.")
        steady = {**steady, "rate": forward.source["rate"]}  # a part may not tell what all of them do
        fit, seen = (characteristic(part, input_, output, **steady) for part in (split.fit, split.held_out))
        return _Apart(fit, seen.commands, seen.rates, OF_ENDS)
    out = np.arange(len(forward.commands)) % EVERY == EVERY // 2
    if np.sum(~out) < LEAST_POINTS:
        raise DataError(
            f"{len(forward.commands)} steady points are too few to leave one of {EVERY} out. "
            f"Hold {-(-LEAST_POINTS * EVERY // (EVERY - 1))} commands or more."
        )
    fit = replace(forward, commands=forward.commands[~out], rates=forward.rates[~out])
    words = f"{LEFT_OUT}, of {source.name} and not of the machine" if isinstance(source, Block) else LEFT_OUT
    return _Apart(fit, forward.commands[out], forward.rates[out], words)


def _card(inverse: LearnedBlock, apart: _Apart, forward: Characteristic, source, curve: DesiredCurve | None) -> dict:
    u, r = apart.commands, apart.rates
    asked = np.ones(len(r), bool)
    if curve is not None:
        most = float(curve(np.array([curve.full]))[0])
        asked = np.abs(r) <= most if np.sum(np.abs(r) <= most) >= FEWEST else asked
    slope, offset = np.polyfit(apart.fit.commands, apart.fit.rates, 1)
    misses = {
        BLOCK: (_expected(inverse, u) - r)[asked],
        MEAN: (apart.fit.rates.mean() - r)[asked],
        LINE: (slope * u + offset - r)[asked],
    }
    errors = {name: float(np.sqrt(np.mean(miss**2))) for name, miss in misses.items()}
    own = errors.pop(BLOCK)
    if curve is not None and (driven := np.abs(u) <= curve.full).any():
        errors[ALONE] = float(np.sqrt(np.mean((r - np.sign(u) * curve(np.abs(u)))[driven] ** 2)))
    row = Row(
        judged_signal(forward.rate), own, float(np.ptp(forward.rates)), errors,
        errors=further(r[asked], misses[BLOCK]),
        stretches={name: rms_of([miss]) for name, miss in misses.items()},
    )  # fmt: skip
    held = {"points": int(asked.sum()), "which": apart.words}
    good = f"At {held['points']} {apart.words}, RMS error of {row.said()}."
    bad = [*_wrong(forward, source), *_uncovered(apart, forward)]
    return carded([row], Words(bad, [*_noise(forward), *_at_stops(forward), *_moving(forward)]), [held], [good])


def _wrong(forward: Characteristic, source) -> list[str]:
    return [
        *_of_source(source),
        *_creeping(forward),
        *_going_on(forward),
        *_one_way(forward),
        *_changing(forward),
        *_falling(forward),
    ]


def _falling(forward: Characteristic) -> list[str]:
    """Where the machine falls: every inverse is wrong there, also one that its card finds good."""
    fall, u = forward.fell, forward.input.unit
    if fall is None:
        return []
    rate = judged_signal(forward.rate)
    unless = "Unless this comes of points that have not settled: f" if forward.source.get("creeping") else "F"
    return [
        f"{unless}rom {shown(fall.begin, u)} to {shown(fall.end, u)} of {forward.input.name}, {rate.name} falls by "
        f"{shown(fall.by, rate.unit)} ({100 * fall.share:.2g} % of its range): there is no inverse there, and this one "
        "holds a mean. Leave those commands and stretches at end stops out of the recordings, or make the machine rise."
    ]


def _creeping(forward: Characteristic) -> list[str]:
    """Where the recordings do not hold commands until the machine rests: points left out creep as those learnt from."""
    found, settle = forward.source.get("creeping"), forward.source.get("settle")
    if not found:
        return []
    before, now = (shown(scatter, forward.rate.unit) for scatter in found)
    rate = judged_signal(forward.rate)
    return [
        f"{rate.name} has hardly settled where the commands end: {shown(settle, 's')} after a step its points scatter "
        f"by {now} about a rising curve, a little sooner by {before}, and commands are not held for longer. Some of "
        "that is in the inverse. Hold every command until the machine rests."
    ]


def _going_on(forward: Characteristic) -> list[str]:
    """Where the machine still moves while its answer is taken."""
    by, window = forward.source.get("going_on"), forward.source.get("window")
    if not by or forward.source.get("creeping"):
        return []
    rate = judged_signal(forward.rate)
    return [
        f"{rate.name} still changes while commands are held, by {shown(by, rate.unit)} from one half of a window of "
        f"{shown(window, 's')} to the other: it has not settled, or drifts. Some of that is in the "
        "inverse, more where it is slow. Hold every command until the machine rests."
    ]


def _one_way(forward: Characteristic) -> list[str]:
    if not forward.source.get("one_way"):
        return []
    return [
        f"{forward.input.name} goes one way only: lag and play of the machine shift all points alike, and nothing here "
        "can tell. Record it both rising and falling."
    ]


def _changing(forward: Characteristic) -> list[str]:
    """Where the rates of a block depend on where it stands, or come late."""
    by, settle, span = forward.source.get("changing", 0.0), forward.source.get("settle"), float(np.ptp(forward.rates))
    if not by > UNSETTLED[True] * span:
        return []
    rate = judged_signal(forward.rate)
    return [
        f"Held for twice {shown(settle, 's')}, {rate.name} changes by up to {shown(by, rate.unit)} "
        f"({100 * by / span:.2g} % of its range): it depends on where the machine stands, or comes late. "
        "The inverse holds near the start alone. Give the start where it is to be used, or a longer settle."
    ]


def _uncovered(apart: _Apart, forward: Characteristic) -> list[str]:
    """Commands of which nothing was left out: what the inverse does there, nothing has judged."""
    covered = float(np.ptp(apart.commands) / np.ptp(forward.commands))
    if apart.words != OF_ENDS or covered >= COVERED:
        return []
    low, high = (shown(float(end(apart.commands)), forward.input.unit) for end in (np.min, np.max))
    return [
        f"The ends of the recordings judge {100 * covered:.2g} % of the range of {forward.input.name} ({low} to "
        f"{high}): elsewhere the inverse is not judged. End recordings with commands over the whole range."
    ]


def _noise(forward: Characteristic) -> list[str]:
    """How far one point is known."""
    return [f"One point is known to {shown(forward.sigma, forward.rate.unit)}."] if forward.sigma > 0 else []


def _moving(forward: Characteristic) -> list[str]:
    """What a command that never rests does not tell."""
    if "moving_points" not in forward.source:
        return []
    late = shown(forward.source["delay"], "s")
    return [
        f"The command never rests, so every sample counts, {late} late. Dead time, lag and play are one there, and the "
        "ends of the range are rounded: hold commands, from both sides, to tell them apart."
    ]


def _at_stops(forward: Characteristic) -> list[str]:
    seconds = forward.source.get("at_stops", 0.0)
    if not seconds:
        return []
    output = judged_signal(forward.rate).name.removesuffix("_rate")
    return [f"Stretches in which {output} stands at an end stop, {shown(seconds, 's')} of all, were left out."]


def _of_source(source) -> list[str]:
    """What the card of a learned block says against it: its inverse is as wrong as it is."""
    card = card_of(source) if isinstance(source, Block) else {}
    if not card.get("bad"):
        return []
    return [f"It is the inverse of {source.name}, not of the machine, and of that: {card['says']}"]


def _expected(inverse: LearnedBlock, commands: np.ndarray) -> np.ndarray:
    """The rates (n,) [SI] for which an inverse gives ``commands`` (n,); its ends beyond its reach."""
    rates = np.linspace(inverse.domain.lower[0], inverse.domain.upper[0], GRID)
    given = np.maximum.accumulate(static_answer(inverse, rates))
    return np.interp(commands, given, rates)
