"""`sensitivity`: which parameters drive which output where, over recordings."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from hydrotwin.models.language.amounts import amount
from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.models.language.provenance import SPREAD

from ..bands import Spread
from ..fit import Finding, Fit
from ..identify import processors
from .answer import Sensitivity, StudiedRecord
from .information import Known, known, not_told_apart
from .intervals import AUTO, OF_FIT, OF_VALUE, Interval, intervals
from .local import Local, local
from .measurements import measurements
from .runs import Runs, runs_over
from .sobol import COURSE, Global, Sampling, sobol

STRETCHES = 6  # of time, into which a recording is cut
TOGETHER = 0.7  # of the variance: where parameters alone make less, local sensitivities say little of their intervals
CORRELATED = 0.7  # between parameters of a fit: their intervals then say more than their covariance
BEYOND = 2.0  # times the spread of the sampled runs that local sensitivities may make it, or the other way round
NEAR_ZERO = 0.01  # of its nominal value: a share of a value of either sign below that is no interval
UNSURE = 0.2  # half width of an index from which on more samples are worth a word

Told = Callable[[str, int, int], None]


def sensitivity(
    model,
    records: Sequence,
    *,
    parameters: Sequence[str] | None = None,
    over: str = AUTO,
    given: Mapping[str, tuple[float, float]] | None = None,
    noise: Mapping[str, float] | None = None,
    samples: int = 512,
    of: str = COURSE,
    stretches: int = STRETCHES,
    seed: int = 0,
    goal: Sequence[str] = (),
    start: Mapping[str, float] | None = None,
    interpolation: Mapping[str, str] | None = None,
    threads: int | None = None,
    progress: Told | None = None,
) -> Sensitivity:
    """Which parameters drive which output of a model where, locally and over their intervals.

    Args:
        model: a Model, FlatModel, or a Fit, whose model and intervals are then taken.
        records: recordings with the inputs of the model; those of its outputs tell what cannot be told apart.
        parameters: globs over parameter paths; None asks about what the model declares free.
        over: where intervals come from: "fit", "bounds", "10%" or "auto", see `intervals`.
        given: intervals by path, SI, in place of those.
        noise: standard deviation by output, SI, in place of that of the fit, or of the estimate from the recordings;
            also of outputs without recording, of which a sensor may come.
        samples: base points of the Sobol indices, a power of two; each costs a run per parameter and two. 0: none.
        of: "course" (outputs over time) or "deviation" (how far they are from the nominal run), see `Sampling`.
        stretches: equal parts of the time of each recording, which are told by themselves.
        goal: parameters or outputs that are wanted better; what to measure next is then ranked for them.
        start: start states by name, SI, in place of measured first samples and the model's own.
        interpolation: "hold" or "linear" by input, as in `identify`.
        progress: a function ``(stage, done, total)``.

    Raises DeclarationError (unknown parameter, an interval without width, no effect at all, an option), DataError (no
    recording, a missing input, all sets diverge), Diverged (the model as it is does).
    """
    began = time.perf_counter()
    progress = progress or (lambda stage, done, total: None)
    thing = model.flat if isinstance(model, Fit) else model
    flat = getattr(thing, "flat", thing)
    asked = intervals(flat, parameters, over, given)
    sampling = Sampling(samples, of, seed, threads or processors())
    progress("compile", 0, 0)
    runs = runs_over(thing, records, [i.name for i in asked], stretches, interpolation, start)
    progress("local", 0, 0)
    near = local(runs, asked)
    _check_effect(runs, near)
    errors = {**_noise_of(model), **(noise or {})}
    sure = known(runs, asked, near, errors)
    far = sobol(runs, asked, sampling, lambda done, total: progress("sobol", done, total)) if samples else None
    further = measurements(runs, near, sure, goal, errors, lambda done, total: progress("measure next", done, total))
    return Sensitivity(
        name=runs.flat.name,
        parameters=asked,
        outputs=runs.flat.outputs,
        records=tuple(
            StudiedRecord(r.name, r.digest, len(r.time), tuple(float(r.time[min(e, len(r.time) - 1)]) for e in r.edges))
            for r in runs.runs
        ),
        local=near,
        sobol=far,
        known=sure,
        measurements=further,
        findings=(
            *(Finding("hole", (), f"sensitivity: {sentence}") for sentence in runs.cuts),
            *_effects(asked, near),
            *_near_zero(runs.flat, asked),
            *_told_apart(runs, near, sure),
            *_correlated(asked, sure),
            *_of_indices(runs, far, near),
        ),
        seconds=time.perf_counter() - began,
        settings={"over": over, "samples": samples, "of": of, "stretches": stretches, "seed": seed, "goal": list(goal)},
    )


def _noise_of(model) -> dict[str, float]:
    """Noise by output, SI, where a fit tells it."""
    if isinstance(model, Fit):
        return dict(model.noise)
    told = (getattr(model, "provenance", None) or {}).get(SPREAD)
    return dict(Spread.from_told(told).noise) if told else {}


def _check_effect(runs: Runs, near: Local) -> None:
    if near.without_effect.all():
        what = runs.names[0] if len(runs.names) == 1 else "none of the parameters asked about"
        verb = "moves no output" if len(runs.names) == 1 else "moves any output"
        raise DeclarationError(
            f"sensitivity: {what} {verb} of {runs.flat.name} in these recordings. Ask about other parameters, or "
            "record what excites them."
        )


def _effects(asked: Sequence[Interval], near: Local) -> list[Finding]:
    return [
        Finding("without_effect", (asked[k].name,), (
            f"sensitivity: {asked[k].name} moves no output in these recordings. What they hold does not depend on it."
        ))
        for k in np.flatnonzero(near.without_effect)
    ]  # fmt: skip


def _near_zero(flat: FlatModel, asked: Sequence[Interval]) -> list[Finding]:
    """Parameters of either sign whose interval is a share of a value that happens to be near zero."""
    found = []
    for one in asked:
        p = flat.parameters[flat.index_of(one.name)]
        small = 0 < abs(p.value) < NEAR_ZERO * abs(p.nominal) and p.bounds[0] < 0 < p.bounds[1]
        if small and one.source.startswith(OF_VALUE):
            found.append(Finding("near_zero", (one.name,), (
                f"sensitivity: {one.name} is near zero ({amount(p.value, p.unit)}), and {one.source} of that moves "
                f"next to nothing, whatever it may drive. Give its interval: --interval {one.name}=LOW:HIGH."
            )))  # fmt: skip
    return found


def _told_apart(runs: Runs, near: Local, sure: Known) -> list[Finding]:
    """What `identifiability` finds, but for parameters that move nothing at all: those are told already."""
    if not np.isfinite(sure.worth).any():
        return []
    still = {runs.names[k] for k in np.flatnonzero(near.without_effect)}
    found = [f for f in not_told_apart(runs.flat, near, sure) if not set(f.parameters) <= still]
    return [Finding(f.kind, f.parameters, f.sentence.replace("identify:", "sensitivity:", 1)) for f in found]


def _correlated(asked: Sequence[Interval], sure: Known) -> list[Finding]:
    """Intervals of a fit whose errors go together, and are taken as independent."""
    from_fit = np.array([i.source.startswith(OF_FIT) for i in asked])
    strong = np.triu(np.abs(np.nan_to_num(sure.correlation)) > CORRELATED, 1) & np.outer(from_fit, from_fit)
    pairs = [(asked[a].name, asked[b].name) for a, b in np.argwhere(strong)]
    if not pairs:
        return []
    names = dict.fromkeys(name for pair in pairs for name in pair)
    return [Finding("correlated", tuple(names), (
        f"sensitivity: the fit knows {', '.join(names)} better together than alone. Taken as independent over their "
        "intervals they move outputs further than the fit allows: its band is narrower. Read who drives what."
    ))]  # fmt: skip


def _of_indices(runs: Runs, far: Global | None, near: Local) -> list[Finding]:
    """What to mind about the indices."""
    if far is None:
        return []
    found, outputs = [], [s.name for s in runs.flat.outputs]
    if far.diverged:
        found.append(Finding("diverged", (), (
            f"sensitivity: {far.diverged} of {far.sets} parameter sets diverged, and {far.sampling.samples - far.used} "
            f"of {far.sampling.samples} base samples count for nothing with them: the indices are those of the rest. "
            f"The first: {far.reason} Take narrower intervals."
        )))  # fmt: skip
    alone = np.nansum(far.whole.first, axis=1)
    sure = (far.whole.spread > 0) & ~far.whole.vague
    bent = [n for n, s, v in zip(outputs, alone, sure, strict=True) if v and 0 < s < TOGETHER]
    if bent:
        found.append(Finding("together", (), (
            f"sensitivity: parameters act together on {', '.join(bent)}: one at a time they make "
            f"{100 * min(alone[outputs.index(n)] for n in bent):.0f} % of the variance or more. Over these intervals "
            "the local sensitivities are only a hint; read the total indices."
        )))  # fmt: skip
    linear = np.sqrt((near.moved**2).sum(axis=1) / 3)  # spread of a linear model over uniform intervals
    beyond = [n for n, s, there, sure in zip(outputs, linear, far.whole.spread, sure, strict=True)
              if sure and not there / BEYOND < s < BEYOND * there]  # fmt: skip
    if beyond:
        found.append(Finding("beyond", (), (
            f"sensitivity: over these intervals {', '.join(beyond)} are far from linear: the local sensitivities would "
            f"spread them more than {BEYOND:g} times as far as the sets do, or not half as far. They are derivatives "
            "at the model's values; the Sobol indices say what the intervals do. Take narrower ones to compare them."
        )))  # fmt: skip
    vague = [n for n, unknown in zip(outputs, far.whole.vague, strict=True) if unknown]
    if vague:
        found.append(Finding("vague", (), (
            f"sensitivity: the samples do not tell what drives {', '.join(vague)}: a few sets move them so far that "
            "these make most of the variance. Take narrower intervals, so that no run comes near a singularity or a "
            f"stop, or more samples ({4 * far.sampling.samples}). The local sensitivities hold near the model's values."
        )))  # fmt: skip
    if far.whole.error > UNSURE:
        found.append(Finding("unsure", (), (
            f"sensitivity: indices are known to ±{far.whole.error:.2g} only. Take more samples "
            f"({4 * far.sampling.samples})."
        )))  # fmt: skip
    return found
