"""How much a block's band is worth: coverage, NLPD and CRPS on recordings that took no part in training.

A band is the Gaussian of the *measured* value about the block's output: from the outputs ``<name>.sd`` where the block
has them, else a constant one from the misses themselves (split conformal). With miss e and deviation s, z = e / s:

    coverage  share of |z| <= 1.96            at the level 95 %
    NLPD      mean of log(s sqrt(2 pi)) + z^2 / 2
    CRPS      mean of s (z (2 Phi(z) - 1) + 2 phi(z) - 1 / sqrt(pi))

Sources: Gneiting, Raftery, J. American Statistical Association 102 (2007) 359-378; Lei, G'Sell, Rinaldo, Tibshirani,
Wasserman, J. American Statistical Association 113 (2018) 1094-1111 (conformal).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr, ndtri

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.provenance import BAND, CARD
from hydrotwin.records import Record
from hydrotwin.simulation import Block, predict_one_step, simulate
from hydrotwin.simulation.stops import Diverged

from .block_file import LearnedBlock, assemble, learned_kinds
from .held_out import Part, as_parts, through

LEVEL = 0.95
WIDE = float(ndtri(0.5 + LEVEL / 2))  # standard deviations of a band of that level
OWN, CONFORMAL = "own", "conformal"  # what a band is made of
GOOD = (0.90, 0.99)  # coverage at `LEVEL` of a band to be trusted
FAR = 2.0  # factor of a correction, either way, from which on the band's own shape is not to be trusted
WORTH = 0.1  # of a factor: a smaller correction is not worth words
FOLDS = 4  # parts of a recording: a conformal band is judged on each with the width that the others give
CHANCE = 2.0  # standard deviations of a coverage of independent misses: within them it may be the one wanted
FEWEST = 20  # samples to judge a band on; independent misses that tell a quantile, and that a block's own band is worth
LEAST = 1e-12  # of the spread of the measured output: a deviation below it is taken as this
SCALES = {"free_run": "run_scale", "one_step": "step_scale"}  # arrays of a block that scale its deviations
RUNS = {"free_run": simulate, "one_step": predict_one_step}


def scores(miss: np.ndarray, sd: np.ndarray, level: float = LEVEL) -> dict[str, float]:
    """Coverage, NLPD, CRPS, median half width (the unit of ``miss``) and the factor that makes it cover ``level``.

    miss, sd : (n,), measured less predicted and the standard deviation. The factor is the quantile of |z| over the
    Gaussian's: above 1, the band is too narrow; ``largest``: the same of the largest |z|. ``independent``: what the
    misses, alike from sample to sample, are worth; a coverage of a few independent misses says little.
    """
    z, wide = miss / sd, float(ndtri(0.5 + level / 2))
    density = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    return {
        "coverage": float(np.mean(np.abs(z) <= wide)),
        "nlpd": float(np.mean(np.log(sd * np.sqrt(2 * np.pi)) + 0.5 * z**2)),
        "crps": float(np.mean(sd * (z * (2 * ndtr(z) - 1) + 2 * density - 1 / np.sqrt(np.pi)))),
        "half_width": wide * float(np.median(sd)),
        "factor": float(_quantile(np.abs(z), level)) / wide,
        "largest": float(np.abs(z).max()) / wide,
        "independent": independent(z),
    }


def independent(z: np.ndarray) -> float:
    """How many independent samples tell as much as the correlated ones of z (n,), by their autocorrelation."""
    n = 1 << (2 * len(z) - 1).bit_length()
    shared = np.fft.irfft(np.abs(np.fft.rfft(z, n)) ** 2)[: len(z)]
    if not shared[0] > 0:
        return float(len(z))
    ends = np.flatnonzero(shared <= 0)
    return len(z) / float(1 + 2 * shared[1 : ends[0] if len(ends) else len(z)].sum() / shared[0])


def band_of(block: Block, records: Sequence[Record | Part], level: float = LEVEL) -> dict[str, dict]:
    """How the band of every measured output holds on ``records``, or on parts of recordings, by output.

    Each holds ``unit``, ``level``, ``samples``, ``source`` ("own" or "conformal"), and ``free_run`` and ``one_step``
    with the `scores` (SI). A conformal band is constant; its coverage is of parts whose misses took no part in its
    width. Where delay lines still fill with inputs of before the recording, nothing is judged. ``trustworthy``: the
    free run's coverage is within `GOOD`. A run that diverged, or fewer than `FEWEST` samples, leave a sentence in
    ``why`` instead of the scores.
    """
    return band_of_all([(block, records)], level)


def band_of_all(pairs: Sequence[tuple[Block, Sequence[Record | Part]]], level: float = LEVEL) -> dict[str, dict]:
    """`band_of` of blocks with the same outputs, each on recordings of its own, taken together."""
    pairs = [(block, as_parts(given)) for block, given in pairs]
    first, records = pairs[0][0], [part.whole for _, parts in pairs for part in parts]
    own = {s.name for s in first.outputs}
    found = {}
    for signal in first.outputs:
        if records and all(signal.name in r for r in records):
            source = OWN if f"{signal.name}.sd" in own else CONFORMAL
            found[signal.name] = {"unit": signal.unit, "level": level, "source": source}
    for mode, run in RUNS.items():
        try:
            runs = [pair for block, parts in pairs for pair in _runs(run, block, parts)]
        except (Diverged, DataError) as error:
            for told in found.values():
                told["why"] = str(error)
            continue
        for name, told in found.items():
            _judge(told, mode, name, runs, level)
    for told in found.values():
        inside = told.get("free_run", {}).get("coverage", 0.0)
        told["trustworthy"] = bool(GOOD[0] <= inside <= GOOD[1])
    return found


def _runs(run: Callable, block: Block, parts: Sequence[Part]) -> list[tuple[Record, Record]]:
    """Run and measurement in every part, from where the block's delay lines hold recorded inputs."""
    lags = [int(s.name.rsplit(".lag_", 1)[1]) for s in block.states if ".lag_" in s.name]
    behind = max(lags, default=0) * block.period
    answer = []
    for found, part in zip(through(lambda r: run(block, r), parts), parts, strict=True):
        since = part.whole.time[0] + behind
        since = since if since < part.end else None
        answer.append((found.window(since, None), part.seen.window(since, None)))
    return answer


def _judge(told: dict, mode: str, name: str, runs: Sequence[tuple[Record, Record]], level: float) -> None:
    """Put the scores of one output into ``told``."""
    misses = [r[name] - run[name] for run, r in runs]
    fine = [np.isfinite(e) for e in misses]
    measured = np.concatenate([r[name][k] for (_, r), k in zip(runs, fine, strict=True)])
    miss = np.concatenate([e[k] for e, k in zip(misses, fine, strict=True)])
    told["samples"] = len(miss)
    if len(miss) < FEWEST:
        told["why"] = f"only {len(miss)} samples to judge the band on (at least {FEWEST} are needed)"
        return
    least = LEAST * max(float(np.std(measured)), 1e-300)
    if told["source"] == OWN:
        sd = np.concatenate([run[f"{name}.sd"][k] for (run, _), k in zip(runs, fine, strict=True)])
        told[mode] = scores(miss, np.maximum(sd, least), level)
    else:
        told[mode] = _conformal(miss, least, level)


def _conformal(miss: np.ndarray, least: float, level: float) -> dict[str, float]:
    """Scores of a constant band: width from all misses, coverage of each part with the width of the others."""
    wide = float(ndtri(0.5 + level / 2))
    parts = np.array_split(np.abs(miss), FOLDS)
    inside = [
        parts[k] <= _quantile(np.concatenate([p for n, p in enumerate(parts) if n != k]), level) for k in range(FOLDS)
    ]
    told = scores(miss, np.full(len(miss), max(_quantile(np.abs(miss), level) / wide, least)), level)
    return told | {"coverage": float(np.mean(np.concatenate(inside)))}


def _quantile(values: np.ndarray, level: float) -> float:
    """The conformal quantile: of n values, the ceil((n + 1) level)-th."""
    rank = min(int(np.ceil((len(values) + 1) * level)), len(values))
    return float(np.partition(values, rank - 1)[rank - 1])


def calibrated(block: LearnedBlock, pairs: Sequence[tuple[Block, Sequence[Record | Part]]]) -> LearnedBlock:
    """The block with deviations scaled so that they cover `LEVEL`.

    Misses that are alike over most of a recording are few, whatever the number of samples. Where chance may explain
    the coverage, the band that the block came with counts as `FEWEST` independent misses beside those found. Where it
    does not, the factor is taken whole; but with less than `FEWEST` a band is not narrowed, and one that covers too
    little is widened to the largest miss.

    pairs : what the band is judged on: recordings with the block, or its like that was not trained on them.

    ``provenance["band"]`` holds by output ``coverage`` before and ``calibrated`` (the factor, 1 where none was needed)
    of both ways to run, ``trustworthy`` (the factor of the free run is within `FAR`) and a sentence, ``says``. Blocks
    without own deviations keep their arrays; their conformal band is told instead.
    """
    if not any(records for _, records in pairs):
        return replace(block, provenance={**block.provenance, BAND: {}})
    before = band_of_all(pairs)
    names = [n for n, told in before.items() if told["source"] == OWN]
    factors = {mode: np.array([_factor(before[n].get(mode)) for n in names]) for mode in RUNS}
    scaled = block
    known = {SCALES[mode]: factor for mode, factor in factors.items() if SCALES[mode] in block.arrays}
    if names and known:
        scaled = rescaled(block, known)
    by_name = {n: {mode: float(factors[mode][j]) for mode in RUNS} for j, n in enumerate(names)}
    told = {name: _told(name, entry, by_name.get(name, {})) for name, entry in before.items()}
    return replace(scaled, provenance={**block.provenance, BAND: told})


def rescaled(block: LearnedBlock, factors: Mapping[str, np.ndarray]) -> LearnedBlock:
    """The block with the arrays of `SCALES` times ``factors`` (outputs,)."""
    return with_arrays(block, {name: block.arrays[name] * factor for name, factor in factors.items()})


def with_arrays(block: LearnedBlock, changed: Mapping[str, np.ndarray]) -> LearnedBlock:
    """The block built anew with some of its arrays changed."""
    kind = next(k for k in learned_kinds() if k.name == block.kind)
    arrays = dict(block.arrays) | dict(changed)
    kept = ("name", "inputs", "outputs", "states", "parameters", "period", "domain", "description", "provenance")
    frame = {name: getattr(block, name) for name in (*kept, "certificate")}
    return assemble(kind, arrays, block.structure, **frame)


def _factor(told: dict | None) -> float:
    """What the deviations are to be multiplied with."""
    if told is None:
        return 1.0
    count, inside = told["independent"], told["coverage"]
    if abs(inside - LEVEL) <= CHANCE * np.sqrt(LEVEL * (1 - LEVEL) / count):
        return max(told["factor"], LEAST) ** (count / (count + FEWEST))
    if count >= FEWEST:
        return max(told["factor"], LEAST)
    return 1.0 if inside > LEVEL else told["largest"]


def _told(name: str, before: dict, factors: dict[str, float]) -> dict:
    """The entry of one output in the provenance."""
    if "free_run" not in before:
        why = before.get("why", "no free run")
        return {"trustworthy": False, "says": f"The band of {name} could not be judged: {why}"}
    inside = {mode: before[mode]["coverage"] for mode in RUNS if mode in before}
    told = {"source": before["source"], "coverage": inside, "samples": before["samples"]}
    told["independent"] = before["free_run"]["independent"]
    if before["source"] == CONFORMAL:
        width = before["free_run"]["half_width"]
        says = (
            f"The block tells no deviation of {name}; 95 % of held out samples lay within {width:.3g} {before['unit']}."
        )
        return told | {"half_width": width, "trustworthy": before["trustworthy"], "says": says}
    factor = factors["free_run"]
    share = f"{100 * inside['free_run']:.0f} % of what was held out lay in the 95 % band of {name} in free run"
    says = f"{share}." if abs(factor - 1.0) < WORTH else f"{share}; the band was scaled by {factor:.2g}."
    fine = 1 / FAR <= factor <= FAR
    if not fine:
        says += " The model errs by other means than its band knows of: do not trust the band beyond what was recorded."
    return told | {"calibrated": factors, "trustworthy": fine, "says": says}


@dataclass(frozen=True)
class KnownBand:
    """What a block's provenance tells of the free run's band of an output: ``half_width`` in SI, None of an own band.

    trustworthy : whether it covered what it should of what was held out. says : what it covered.
    """

    source: str
    trustworthy: bool
    says: str
    half_width: float | None = None


def known_bands(provenance: Mapping) -> dict[str, KnownBand]:
    """The bands that were judged on something held out, by output; {} where nothing was.

    The card of `learn` has the last word: what it judged on had no part in the training, nor in scaling a band. An own
    band that had to be scaled by more than `FAR` is not trusted, whatever the card says. What is garbled is left out.
    """
    found = {}
    trained, card = _table(provenance, BAND), _table(_table(provenance, CARD), "outputs")
    for name in dict.fromkeys([*trained, *card]):
        own, judged = _table(trained, name), _table(_table(card, name), "band")
        told = _known(judged) or _known(own)
        if told is None:
            continue
        if told.source == OWN and own.get("trustworthy") is False:
            told = replace(told, trustworthy=False, says=str(own.get("says", told.says)))
        found[name] = told
    return found


def _table(of: Mapping, key: str) -> Mapping:
    found = of.get(key)
    return found if isinstance(found, Mapping) else {}


def _known(told: Mapping) -> KnownBand | None:
    """Of one entry; None where it tells no band."""
    source, wide, inside = told.get("source"), told.get("half_width"), told.get("coverage")
    inside = inside.get("free_run") if isinstance(inside, Mapping) else inside
    if source not in (OWN, CONFORMAL) or not isinstance(inside, (int, float)):
        return None
    if source == CONFORMAL and not (isinstance(wide, (int, float)) and np.isfinite(wide) and wide > 0):
        return None
    says = f"{100 * inside:.3g} % of what was held out lay in it"
    if not GOOD[0] <= inside <= GOOD[1]:
        says += f", and a right one of {100 * LEVEL:.0f} % holds {100 * GOOD[0]:.0f} to {100 * GOOD[1]:.0f} %"
    return KnownBand(source, told.get("trustworthy") is True, says, float(wide) if source == CONFORMAL else None)
