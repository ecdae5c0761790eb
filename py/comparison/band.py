"""Which 95 % band a model has of each output, what it was made of, and whether it is to be trusted.

    sensitivities  the covariance of an identified model's parameters, through the exact sensitivities of each run
    own            standard deviations that a block gives beside its outputs (``<name>.sd``): Gaussian processes
    conformal      one width, from the misses of a block's free run on what was held out of its training

Where nothing was held out, a block without deviations has no band. A model that is no Model and no learned block (an
FMU) has the deviations among its outputs, or none. Sources: `identification.bands`, `learned.bands`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hydrotwin.learned.bands import CONFORMAL, OWN, known_bands
from hydrotwin.models.language.flat import SD
from hydrotwin.models.language.provenance import SPREAD, made_from

SENSITIVITIES = "sensitivities"
LEAST_INSIDE = 0.90  # of a 95 % band: what it should hold of a recording; less may be a draw of what is not known ...
CHANCE = 1e-4  # ... unless that has a smaller chance: right ones had 0.026 at least where so little lay inside
NO_CHANCE = (
    "lies in it, fewer than chance explains. Something is missing in the model there, or the sensor is noisier than in "
    "the recordings of the fit"
)
FEW_INSIDE = 0.75  # mean over recordings, of a band of which nobody knows what may be a draw
MISSING = "its fit left more than noise. Something is missing in it, and elsewhere the machine may be further off."
SEEN = ", though its physics was identified on these recordings to their end"


@dataclass(frozen=True)
class Band:
    """The band of one output: its ``source``, see above; ``half_width`` (SI) of a conformal one, else None.

    trusted : None where it was never judged on anything that was held out. why : what there is to say of it.
    before, held : what was known of it before this comparison, and what of each recording here it held.
    """

    output: str
    source: str
    trusted: bool | None
    why: str = ""
    half_width: float | None = None
    before: Band | None = field(default=None, compare=False, repr=False)
    held: tuple[Held, ...] = field(default=(), compare=False, repr=False)

    def on(self, records: Iterable[str]) -> Band:
        """The same as these recordings alone judge it: what others show is of other conditions."""
        names = set(records)
        return _held(self.before, [one for one in self.held if one.record in names]) if self.before else self


def bands_of(contender) -> tuple[Band, ...]:
    """The bands of a contender in free run, in the order of its outputs; none for an output without one."""
    own = {s.name for s in contender.outputs}
    known, found = _known(contender), []
    for name in (s.name for s in contender.outputs if not s.name.endswith(SD)):
        if name in known:
            found.append(known[name])
        elif f"{name}{SD}" in own:
            found.append(Band(name, OWN, None, "it was judged on nothing that was held out"))
    return tuple(found)


@dataclass(frozen=True)
class Held:
    """What of one recording lay in a band: share inside; chance : of errors as far off, see `Moved.chance`, or NaN.

    or_else : what else than the model and its sensors may be the reason there, in words that follow those.
    """

    record: str
    inside: float
    chance: float = float("nan")
    or_else: str = ""


def held_here(bands: Sequence[Band], held: Mapping[str, Sequence[Held]]) -> tuple[Band, ...]:
    """The bands, those doubted that did not hold what was measured here; held : of each recording, by output.

    Whatever a band was judged on before, one that misses the recordings at hand is wrong there. Of a fit it is known
    what may be a draw of parameters and start, and one recording that it misses by more than that is enough.
    """
    found = [(band, tuple(held.get(band.output, ()))) for band in bands]
    return tuple(replace(_held(band, known), before=band, held=known) for band, known in found)


def _held(band: Band, held: Sequence[Held]) -> Band:
    known = [one for one in held if not np.isnan(one.inside)]
    if not known or (band.trusted is False and band.source == SENSITIVITIES):
        return band
    mean = float(np.mean([one.inside for one in known]))
    if any(np.isnan(one.chance) for one in known):
        why = f"only {100 * mean:.2g} % of what was measured here lies in it"
        before = f"{band.why.rstrip('.')}; " if band.why else ""
        return replace(band, trusted=False, why=before + why) if mean < FEW_INSIDE else band
    low = [one for one in known if one.inside < LEAST_INSIDE and one.chance < CHANCE / len(known)]
    if not low:
        return band
    worst = min(low, key=lambda one: one.inside)
    why = f"only {100 * worst.inside:.3g} % of {worst.record} {NO_CHANCE}{worst.or_else}"
    return replace(band, trusted=False, why=why)


def _known(contender) -> dict[str, Band]:
    told = getattr(contender, "provenance", None) or {}
    if hasattr(contender, "deviations") and SPREAD in told:
        return _of_fit(told[SPREAD])
    found = _of_block({s.name for s in contender.outputs}, told, getattr(contender, "half_widths", {}))
    physics, residual = (made_from({key: told.get(key, ())}) for key in ("physics_trained_on", "trained_on"))
    if physics & residual:  # of a hybrid
        return {n: replace(band, why=f"{band.why}{SEEN}") for n, band in found.items()}
    return found


def _of_fit(told: Mapping) -> dict[str, Band]:
    explained = set(told.get("explained", ()))
    return {n: Band(n, SENSITIVITIES, n in explained, "" if n in explained else MISSING) for n in told.get("left", ())}


def _of_block(outputs: set[str], provenance: Mapping, widths: Mapping[str, float]) -> dict[str, Band]:
    """Conformal bands that the contender draws, and own ones that were judged."""
    found = {}
    for name, told in known_bands(provenance).items():
        if told.source == CONFORMAL and name in widths:
            found[name] = Band(name, CONFORMAL, told.trustworthy, told.says, widths[name])
        elif told.source == OWN and f"{name}{SD}" in outputs:
            found[name] = Band(name, OWN, told.trustworthy, told.says)
    return found
