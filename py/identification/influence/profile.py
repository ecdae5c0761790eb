"""Profile likelihoods: how far a parameter may move before the recordings contradict it, the others fitted again.

    2 (cost(p_j) - cost) / scale_j <= 3.84,     scale_j = C_jj / C_white,jj

A quadratic interval (value -+ 1.96 sigma) holds where the cost is a parabola that far. Where parameters trade places,
or saturate, it is not: then a profile is lopsided, or never crosses the level, and the parameter is not identifiable
from these recordings in that direction. ``scale`` allows for coloured residuals as the covariance of the fit does: of
an exact parabola both intervals are the same.
Source: A. Raue et al., Bioinformatics 2009; J. Kent, Biometrika 1982 (the scale of a likelihood ratio).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from hydrotwin.models.language.amounts import amount
from hydrotwin.models.language.errors import DataError, DeclarationError, SolveError
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.records import distinct
from hydrotwin.simulation import prepare

from ..answer import at_bounds, differentiated, weighted_rows
from ..descent import Task, whole_runs
from ..fit import Fit, FittedParameter
from ..identify import processors
from ..least_squares import Minimum, minimise
from ..loss import Loss
from ..outliers import FAR, outlying, without
from ..problem import free_parameters, matching, recordings, unbroken_for
from ..shooting import Shooting
from ..uncertainty import Errors, uncertainty
from .intervals import SIGMAS
from .profiles import Profile, Profiles
from .walk import BOUND, CROSSED, FLAT, LEVEL, LOWER, Budget, FoundLower, Side, Walk

MOST_FITS = 60  # of one parameter
BASE = 50  # iterations to the minimum itself, ...
EXACT = 1e-6  # half a chi-square: ... from which rises are counted
ROUNDS = 3  # times a lower minimum is taken for the start
GOES_ALONG = 0.1  # in q, of its logarithm or its size: what moves so far along the way makes up for it


def profile(
    fit: Fit,
    records: Sequence,
    *,
    parameters: Sequence[str] | None = None,
    most: int = MOST_FITS,
    threads: int | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Profiles:
    """Profile likelihoods of the free parameters of a fit, or of those that match the globs in ``parameters``.

    records : those that were fitted to, as `identify` had them. most : fits of the others for each parameter, at most.
    progress : a function ``(parameter, done, total)``.

    A fit that found several minima is profiled from the lowest; where a walk comes to a lower one, from that.

    Raises DeclarationError (a parameter that was not free), DataError (other recordings), SolveError (all runs diverge
    at the fit).
    """
    began = time.perf_counter()
    if not fit.parameters:
        raise DeclarationError(f"profile: the fit of {fit.name} has no free parameter. Free some.")
    chosen = profiled(fit.flat, [p.name for p in fit.parameters], parameters)
    task = _task(fit, records, threads)
    shooting, z = _fitted_starts(task, fit)
    around = _Around(fit, task, shooting, most, progress or (lambda parameter, done, total: None))
    fitted = base = minimise(shooting, task.free.scaled(task.free.start), z, absolute=EXACT, most=BASE)
    found = None
    for _ in range(ROUNDS + 1):
        try:
            found = around(base, chosen)
            break
        except FoundLower as met:
            base = minimise(shooting, met.minimum.q, met.minimum.z, absolute=EXACT, most=BASE)
    if found is None:
        raise SolveError(
            f"profile: the cost of {fit.name} has minimum after minimum ({ROUNDS} lower ones were met on the way), so "
            "that no interval means anything. Identify with more starts, or free fewer parameters."
        )
    lower = _lower(task, fitted.cost, base)
    return Profiles(fit.name, task.free.names, found, around.fits, lower, time.perf_counter() - began)


class _Around:
    """Profiles around a minimum; ``fits`` counts those of the others."""

    def __init__(self, fit: Fit, task: Task, shooting: Shooting, most: int, told: Callable[[str, int, int], None]):
        self.fit, self.task, self.shooting, self.most, self.told, self.fits = fit, task, shooting, most, told, 0

    def __call__(self, base: Minimum, chosen: Sequence[int]) -> tuple[Profile, ...]:
        """Those of the parameters ``chosen``. Raises FoundLower."""
        scale, sigma = _scales(self.task, self.shooting, base)
        done = []
        for number, j in enumerate(chosen):
            self.told(self.task.free.names[j], number, len(chosen))
            budget = Budget(self.most)
            walk = Walk(self.shooting, base, j, float(scale[j]), float(sigma[j]), budget)
            try:
                done.append(_profile(self.fit, self.shooting, walk, walk.side(-1.0), walk.side(1.0)))
            finally:
                self.fits += budget.spent
        return tuple(done)


def profiled(flat: FlatModel, free: Sequence[str], globs: Sequence[str] | None) -> list[int]:
    """Positions among the free parameters of those that match a glob; all for None.

    Raises DeclarationError for a glob that matches none of them.
    """
    if globs is None:
        return list(range(len(free)))
    for glob in globs:
        wanted = matching(flat, [glob])
        if not wanted & set(free):
            raise DeclarationError(
                f"profile: {min(wanted)} was not free in the fit. Free it, or choose of {', '.join(free)}."
            )
    wanted = matching(flat, globs)
    return [j for j, name in enumerate(free) if name in wanted]


def _task(fit: Fit, records: Sequence, threads: int | None) -> Task:
    """What was fitted, as it was fitted."""
    flat, settings = fit.flat, fit.settings
    trained = [r for r in fit.records if r.role == "train"]
    records = unbroken_for(flat, distinct(records)[0])
    names = ", ".join(t.name for t in trained)
    same = len(records) == len(trained) and all(
        (r.digest or t.digest) == t.digest and len(r.time) == t.samples for r, t in zip(records, trained, strict=True)
    )
    if not same:
        raise DataError(
            f"profile: these are not the recordings that {fit.name} was fitted to, {names} "
            f"(got {', '.join(r.name for r in records) or 'none'}). Give those, in their order."
        )
    names, bounds = [p.name for p in fit.parameters], {p.name: p.bounds for p in fit.parameters}
    free = free_parameters(flat, names, bounds=bounds)
    fitted = recordings(flat, records, list(fit.allowed), "record")
    noise = np.array([fit.noise.get(s.name, np.nan) for s in flat.outputs])
    weights = np.array([1 / fit.allowed[s.name] if s.name in fit.allowed else 0.0 for s in flat.outputs])
    propagator = prepare(
        flat, free_parameters=names, free_states=[s.name for s in flat.states], step=settings.get("step"),
        method=settings.get("method", "auto"),
    )  # fmt: skip
    kind = settings.get("loss", "auto")
    loss = Loss("linear" if kind == "auto" else kind, settings.get("loss_scale", 2.0))
    task = Task(
        flat, free, propagator, fitted, weights, loss, settings.get("initial_states", "auto"), threads or processors(),
        lambda stage, iteration, cost: None, noise,
    )  # fmt: skip
    return _spared(task, fit) if settings.get("spared") else task


def _spared(task: Task, fit: Fit) -> Task:
    """Without the samples that the fit left out."""
    shooting, z = _fitted_starts(task, fit)
    found = minimise(shooting, task.free.scaled(task.free.start), z, most=0)
    return without(task, outlying(task, found, FAR))


def _fitted_starts(task: Task, fit: Fit) -> tuple[Shooting, np.ndarray]:
    """The runs over the whole recordings, and the start states that the fit found."""
    shooting, z = whole_runs(task)
    trained = [r for r in fit.records if r.role == "train"]
    for i, record in enumerate(trained):
        for k, name in enumerate(shooting.start.names):
            if name in record.start:
                z[i, k] = record.start[name] / shooting.start.nominal[k]
    return shooting, z


def _scales(task: Task, shooting: Shooting, base: Minimum) -> tuple[np.ndarray, np.ndarray]:
    """Of each parameter the scale of its rise, and its white standard deviation in q, nan where it is unknown."""
    rows, _ = differentiated(task, shooting, base)
    *weighted, errors = weighted_rows(rows, shooting)
    known = uncertainty(*weighted, at_bounds(task.free, base), Errors(errors))
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.diag(known.sandwich) / np.diag(known.white)
        sigma = np.sqrt(np.diag(known.white))
    finite = np.isfinite(scale) & (scale > 0)
    usual = scale[finite].max() if finite.any() else max(1.0, 2 * base.cost / shooting.count)
    return np.where(finite, scale, usual), sigma


def _profile(fit: Fit, shooting: Shooting, walk: Walk, below: Side, above: Side) -> Profile:
    free, j = shooting.free, walk.j
    points = [*below.points[:0:-1], *above.points]
    q = np.array([p.minimum.q for p in points])
    others = np.array([free.values(row) for row in q])
    row, ends = fit.parameter(free.names[j]), []
    unknown = _no_sigma(fit, row)
    for side, never in ((below, -np.inf), (above, np.inf)):
        at = walk.base.q.copy()
        at[j] = side.end
        ends.append(float(free.values(at)[j]) if side.why == CROSSED else never)
    return Profile(
        name=free.names[j],
        unit=free.units[j],
        value=float(free.values(walk.base.q)[j]),
        low=ends[0],
        high=ends[1],
        below=below.why,
        above=above.why,
        quadratic=None if unknown else (row.value - SIGMAS * row.sigma, row.value + SIGMAS * row.sigma),
        grid=others[:, j],
        rise=LEVEL * np.square([p.root for p in points]),
        others=others,
        along=_along(free.names, j, q, (below, above)),
        unknown=unknown,
    )


def _no_sigma(fit: Fit, row: FittedParameter) -> str:
    """Why a fitted parameter has no standard deviation, and what next, as a clause; empty where it has one."""
    if np.isfinite(row.sigma):
        return ""
    if row.at_bound:
        return "the fit rests on its bound and found no minimum there. Widen its bounds, or take what the profile says"
    kinds = {f.kind: f for f in fit.findings if row.name in f.parameters}
    if "no_effect" in kinds:
        return "the cost has no minimum in it, for these recordings do not show it. Fix it"
    if "indistinguishable" in kinds:
        rest = " and ".join(n for n in kinds["indistinguishable"].parameters if n != row.name)
        return f"the cost has no minimum in it, for {rest} can make up for it. Fix one of them"
    if any(f.kind == "no_minimum" for f in fit.findings):
        next_ = "Shorten the recordings, give a smaller step, or fix the parameter"
        return f"the fit found no minimum, for runs do not follow their derivatives there. {next_}"
    return "the derivatives at the fit do not determine it. Free fewer parameters, or record another output"


def _along(names: Sequence[str], j: int, q: np.ndarray, sides: Sequence[Side]) -> tuple[str, ...]:
    """Other parameters that move with one that nothing contradicts, the furthest first."""
    if all(side.why not in (BOUND, FLAT) for side in sides):
        return ()
    moved = np.ptp(q, axis=0)
    return tuple(names[k] for k in np.argsort(-moved) if k != j and moved[k] > GOES_ALONG)[:2]


def _lower(task: Task, fitted: float, base: Minimum) -> str:
    if not base.cost < fitted - LOWER:
        return ""
    values = ", ".join(
        f"{n} = {amount(v, u)}"
        for n, v, u in zip(task.free.names, task.free.values(base.q), task.free.units, strict=True)
    )
    return (
        f"The profiles met a minimum that is lower than that of the fit by {2 * (fitted - base.cost):.3g} in "
        f"chi-square ({values}); they are around that one. Identify again with more starts."
    )
