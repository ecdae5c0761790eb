"""Where signals of a recording rest, and how long they take to come to rest after the inputs have moved."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from hydrotwin.records import NoiseFloor, Record
from hydrotwin.records.steps import holes_at

REST, REST_SAMPLES = 0.02, 20  # of the recording, and samples at least: how long all must rest
STILL, NOISE_WIDTH = 0.005, 6.0  # of the range of a signal, or sigmas of its noise: what moves less rests
HELD = 0.001  # the same of an input: at the crest of a slow motion it is not held
LARGEST = 4.0  # sigmas: no noise of a sample is larger
SETTLED = 0.05  # of the largest distance from the final value: what stays nearer, or rests, has settled


def rests(record: Record, names: Sequence[str], noise: Mapping[str, NoiseFloor], share: float = STILL) -> np.ndarray:
    """Where (n,) all named signals rest: about a sample each moves less than a share of its range or than its noise.

    Between the samples of a slower raster it does what these do; in its holes nobody knows.
    """
    width = _width(record, names)
    still = np.ones(len(record.time), bool)
    if len(still) < width:
        return ~still
    for name in names:
        values = _between(record.time, record[name])
        known = np.isfinite(values)
        if not known.any():
            return np.zeros_like(still)
        room = _room(values, _sigma(name, noise), share)
        swing = maximum_filter1d(np.where(known, values, np.inf), width) - minimum_filter1d(
            np.where(known, values, -np.inf), width
        )
        still &= swing <= room
    half = width // 2
    still[:half] = still[-half:] = False
    return still


def inputs_rest(record: Record, names: Sequence[str], noise: Mapping[str, NoiseFloor]) -> np.ndarray:
    """Where (n,) all named inputs rest: as `rests`, but from level to level a command moves: levels are no rounding.

    Samples that are unknown lie on the line between those beside them: a hole is a move only between two levels.
    """
    white = {n: dataclasses.replace(noise[n], sigma=noise[n].white) for n in names if n in noise}
    return rests(_bridged(record, names), names, white, HELD)


def _bridged(record: Record, names: Sequence[str]) -> Record:
    """The recording with the unknown samples of signals on the line between the known ones; one never known stays."""
    known = {n: np.isfinite(record[n]) for n in names}
    holes = [n for n, here in known.items() if here.any() and not here.all()]
    lines = {n: np.interp(record.time, record.time[known[n]], record[n][known[n]]) for n in holes}
    return record.with_signals(lines) if lines else record


def settling(
    record: Record, output: str, predicted: np.ndarray, inputs: Sequence[str], noise: Mapping[str, NoiseFloor]
) -> float:
    """Time [s] that a prediction (n,) of an output takes longer than the measurement to settle.

    Each time that the inputs have moved and rest until the measurement rests, too, the settling time of either counts
    from where the inputs rest to where it stays within 5 % of its largest distance from its final value, that of the
    measurement, or, where noise hides so little, moves no more than what rests. A prediction that does not settle takes
    as long as the inputs rest.
    A move that ends inside a hole of an input or of time, nobody knows when, is left out, and one is followed until the
    next hole, behind which a prediction may begin anew, settled. It is the mean size over the moves, so that one that
    settles too late does not make up for one that settles too soon, with the sign of the mean.
    NaN where the measurement never settles after a move. Noise leaves a band late, and is taken out.
    Source: G. Franklin, J. Powell, A. Emami-Naeini, Feedback Control of Dynamic Systems, 7th ed. (2015), section 3.4.
    """
    width, measured, found = _width(record, [output]), record[output], []
    sigma, samples = _sigma(output, noise), width // _rows(record, output)  # of so many rows
    settled, room = rests(record, [output], noise), _room(measured, sigma)
    told = np.all([np.isfinite(_between(record.time, record[n])) for n in inputs], axis=0)
    behind = [gap.index + 1 for gap in record.gaps]
    told[behind] = False
    holes = np.union1d(behind, np.flatnonzero(~np.isfinite(predicted)))
    for move in _after_moves(inputs_rest(record, inputs, noise), _width(record)):
        part = slice(move.start, int(min((h for h in holes if move.start < h < move.stop), default=move.stop)))
        if not np.all(told[part.start - 1 : part.start + 1]):  # the move ended in a hole
            continue
        known = np.isfinite(measured[part]) & np.isfinite(predicted[part])
        time, y, p = (values[part][known] for values in (record.time, measured, predicted))
        if len(y) <= samples or not settled[part.stop - 1 - width // 2]:
            continue
        band = SETTLED * float(np.abs(y - y[-samples:].mean()).max())
        if band < max(_room(measured, 0.0) / 2, LARGEST * sigma / samples**0.5):  # noise hides so little
            band = room / 2
        quiet = _without_noise(y, p, sigma, samples)
        found.append(_settles(time, p, band, samples) - _settles(time, quiet, band, samples))
    return _signed_size(found, np.ones(len(found)))


def at_rest(
    record: Record, output: str, predicted: np.ndarray, inputs: Sequence[str], noise: Mapping[str, NoiseFloor]
) -> float:
    """Size of the mean error of a prediction (n,) at rest, wherever the inputs rest; its mean over these, by samples.

    Errors of either sign do not make up for each other; the sign is that of all together. NaN where nothing rests.
    """
    error, held = predicted - record[output], inputs_rest(record, inputs, noise)
    still = rests(record, [output], noise) & np.isfinite(error)
    parts = [error[first:end][still[first:end]] for first, end in _stretches(held)]
    known = [part for part in parts if len(part)]
    return _signed_size([part.mean() for part in known], [len(part) for part in known])


def _signed_size(values: Sequence[float], weights: Sequence[float]) -> float:
    """The mean size of values, with the sign of their mean; NaN of none."""
    if not len(values):
        return float("nan")
    return float(np.copysign(np.average(np.abs(values), weights=weights), np.average(values, weights=weights)))


def _stretches(still: np.ndarray) -> list[tuple[int, int]]:
    """First sample and end of every stretch of true ones."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]])))
    return list(zip(edges[::2], edges[1::2], strict=True))


def _after_moves(still: np.ndarray, width: int) -> Iterator[slice]:
    """Samples from where something that had moved rests to where it moves again; still : (n,), as of `rests`."""
    for first, end in _stretches(still):
        if first > width // 2:  # else it rests from the beginning of the recording
            yield slice(first - width // 2, end + width // 2)


def _settles(time: np.ndarray, values: np.ndarray, band: float, width: int) -> float:
    """Seconds until values (n,) stay within a band about their last ones."""
    outside = np.flatnonzero(np.abs(values - values[-width:].mean()) > band)
    return float(time[min(outside[-1] + 1, len(time) - 1)] - time[0]) if len(outside) else 0.0


def _without_noise(measured: np.ndarray, predicted: np.ndarray, sigma: float, width: int) -> np.ndarray:
    """What is measured (n,) without what is fast in the error of its prediction, as far as noise is so large."""
    if not sigma or len(measured) < width:
        return measured
    error = measured - predicted
    fast = error - uniform_filter1d(error, width, mode="reflect")
    return measured - np.clip(fast, -LARGEST * sigma, LARGEST * sigma)


def _between(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (n,), those between the samples of a slower raster on the line between them; NaN in its holes."""
    known = np.isfinite(values)
    if known.all() or not known.any():
        return values
    lines, own = np.interp(time, time[known], values[known]), np.unique([time[0], *time[known], time[-1]])
    for at in holes_at(own):
        lines[~known & (time >= own[at]) & (time <= own[at + 1])] = np.nan
    return lines


def _rows(record: Record, name: str) -> int:
    """How many rows it is, usually, from one sample of a signal to its next."""
    apart = np.diff(np.flatnonzero(np.isfinite(record[name])))
    return int(np.median(apart)) if len(apart) else 1


def _width(record: Record, names: Sequence[str] = ()) -> int:
    """How many rows must rest, odd: enough samples of each signal."""
    slowest = max((_rows(record, name) for name in names), default=1)
    return max(slowest * REST_SAMPLES, int(REST * len(record.time))) | 1


def _room(values: np.ndarray, sigma: float, share: float = STILL) -> float:
    """Within what (n,) values move that rest."""
    known = values[np.isfinite(values)]
    return max(share * float(np.ptp(known)) if len(known) else 0.0, NOISE_WIDTH * sigma)


def _sigma(name: str, noise: Mapping[str, NoiseFloor]) -> float:
    return noise[name].sigma if name in noise else 0.0
