"""What was assumed about the recordings, doubted before anything is called converged or missing.

A held input that was linear, a column half a sample late or early, a start in motion where the model begins at rest:
each leaves many times the noise, bends the parameters, and looks like missing physics. So a minimum of free runs is
asked what it would gain by

    starts : free start states where no output measures them
    smooth : linear inputs on the curve through their samples: nothing is free in that, so the likelihood tells
    inputs : each input held or linear, and up to a sample earlier or half a sample later than it is stamped
    loads  : each force or torque that the model has as a constant and nobody freed

first by one linear step from its sensitivities (an input half a sample later, or a constant, adds one direction), then,
where that promises to explain most of what is left, by a fit. A whole sample later and more is a dead time, which has a
name; an offset of a sensor is told, for the model has no place for it.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtri

from hydrotwin.models.language.errors import SolveError

from .answer import explains
from .descent import Task, whole_runs
from .directions import Seen, Step, loads_of, period_of, propagator_of, seen_from, with_inputs
from .hints import hint
from .least_squares import Minimum
from .problem import free_parameters
from .trials import FAR_MORE, MOST_OF_IT, NEAR, explains_most, fitted
from .weighing import WORTH_IT, Weighed, misses, score

PROMISED = 0.5  # of what is left beyond the noise: what one linear step must promise before a fit is made
CHANCE = 1e-3  # that start states which are right explain so much
FAINT = 0.02  # of the noise's sum of squares: a load that explains less may be what interpolation leaves
SHIFTS = (0.0, -0.5, 0.5, -1.0)  # samples; a whole one later is a dead time
LATEST = 0.6  # samples by which an input may come later than it was taken for: more is a dead time
TELLING = 10.0  # in the likelihood's logarithm: less does not tell changes apart, and the smaller one is taken
MATTERS = 0.1  # of the noise: what an input between its samples must change to be asked
HELD = {"hold": "held", None: "held"}  # what an input is said to be
PATIENCE = 3  # assumptions given up one after the other


@dataclass(frozen=True)
class Change:
    """An assumption to give up: what inputs do (see `changed`), free starts, loads to free, and what is said of it.

    ``times`` : what was left over the noise before, and after, of the output that gained most.
    """

    inputs: Mapping[str, dict] = field(default_factory=dict)
    free_starts: bool = False
    freed: tuple[str, ...] = ()
    times: tuple[float, float] = (np.nan, np.nan)
    sentences: tuple[str, ...] = ()

    @property
    def used(self) -> bool:
        """Whether anything is taken otherwise, and not only said."""
        return bool(self.inputs) or self.free_starts or bool(self.freed)


def doubted(
    task: Task,
    found: Minimum,
    adaptable: np.ndarray,
    loads: bool = True,
    enough: float = FAR_MORE,
    only_starts: bool = False,
) -> Change | None:
    """The assumption that a minimum of free runs should give up; None where those made are good enough.

    ``adaptable`` (ny,) as in `search`; ``enough``: share of what is left that another input must explain. At the noise
    starts and ``loads`` alone are asked: they may move a parameter without a trace. ``only_starts``: no input is asked
    for that is not smooth, each of which takes fits.
    """
    explained = explains(task, found)
    try:
        auto = seen_from(task, found)
        freed = _starts_freed(task, found)
        free = seen_from(*freed, inputs=not explained) if freed else None
    except (SolveError, np.linalg.LinAlgError):
        return None
    better = _smooth(task, found, adaptable)
    if better is None and not explained:
        better = _explained_better(task, found, auto, free, freed, adaptable, enough, only_starts)
    near = bool(np.all(misses(task, found) < WORTH_IT))
    if better is None and near:
        better = _moved_by_starts(task, found, auto, free, freed, adaptable)
    if better is None and loads:
        better = _load_freed(task, found, auto, near, adaptable)
    if better is None and not (explained or only_starts) and (told := hint(task, found)):
        return Change(sentences=(told,))
    return better


def _smooth(task: Task, found: Minimum, adaptable: np.ndarray) -> Change | None:
    """Linear inputs on the curve through their samples, where that is likelier by far."""
    bent = [s for s in task.flat.inputs if s.interpolation == "linear" and s.chosen_by != "user" and not s.shift]
    if not bent:
        return None
    inputs = {s.name: {"interpolation": "smooth", "shift": 0.0} for s in bent}
    other, shooting = with_inputs(task, inputs), whole_runs(task)[0]
    curved, matters = whole_runs(other)[0], MATTERS * np.nan_to_num(task.noise * task.weights)
    for i in range(len(task.recordings)):
        runs = [one.residuals(i, found.q, found.z[i]) for one in (shooting, curved)]
        if any(run is None for run in runs):
            return None
        if np.any(np.sqrt(np.mean(np.nan_to_num(runs[1] - runs[0]) ** 2, axis=0)) > matters):
            break
    else:
        return None
    try:
        before, after = Weighed(task, found, score(task, found)), fitted(other, found, adaptable)
    except SolveError:
        return None
    return _told(before, after, False, inputs) if before.score - after.score > TELLING else None


def _explained_better(task, found, auto, free, freed, adaptable, enough, only_starts) -> Change | None:
    """The simplest change that explains most of what is left beyond the noise."""
    seen = seen_from(task, found, inputs=True)
    known = [s.chosen_by == "user" or s.shift or s.interpolation == "smooth" for s in task.flat.inputs]
    open_inputs = [j for j, settled in enumerate(known) if not (settled or only_starts)]
    groups = [(j,) for j in open_inputs] + ([tuple(open_inputs)] if len(open_inputs) > 1 else [])
    tries = [(True, ())] if freed else []
    tries += [(False, group) for group in groups]
    tries += [(True, group) for group in groups] if freed else []
    before = Weighed(task, found, score(task, found))
    for starts, group in tries:
        directions = free if starts else seen
        promised = directions.step(group)
        if starts and not group and promised.gain - auto.step().gain < _by_chance(auto, free, promised):
            continue
        if promised.gain < PROMISED * directions.excess:
            continue
        base = freed if starts else (task, found)
        change = _best_of(base, before, starts, _candidates(task, group, promised.others), adaptable, enough)
        if change:
            return change
    return None


def _load_freed(task: Task, found: Minimum, auto: Seen, near: bool, adaptable: np.ndarray) -> Change | None:
    """A constant force or torque of the model that nobody freed, where it explains far more, or moves a parameter."""
    before, first = Weighed(task, found, score(task, found)), len(task.flat.inputs)
    for k, name in enumerate(loads_of(task)):
        promised = auto.step((first + k,))
        least = max(float(chdtri(1, CHANCE)) * promised.level, FAINT * auto.floor)
        moves = near and bool(np.any(np.abs(promised.q) > _sigma(found)))
        if promised.gain - auto.step().gain < least or not (moves or promised.gain > PROMISED * auto.excess):
            continue
        try:
            after = fitted(*_with_free(task, found, name), adaptable)
        except SolveError:
            continue
        gained = 2 * (before.score - after.score) > least
        if gained and (moves or explains_most(before, after, MOST_OF_IT)):
            p = after.task.free
            value = p.values(after.minimum.q)[p.names.index(name)]
            was = task.flat.parameters[task.flat.index_of(name)]
            words = f"{name} is not {was.value:.4g} {was.unit} as assumed but about {value:.4g}, and is estimated"
            return dataclasses.replace(_told(before, after, False, {}, words), freed=(name,))
    return None


def _with_free(task: Task, found: Minimum, name: str) -> tuple[Task, Minimum]:
    """The same point with one more parameter free."""
    free = task.free
    start = dict(zip([p.name for p in task.flat.parameters], free.vector(found.q).tolist(), strict=True))
    bounds = dict(zip(free.names, zip(free.lower.tolist(), free.upper.tolist(), strict=True), strict=True))
    other = dataclasses.replace(task, free=free_parameters(task.flat, [*free.names, name], start, bounds), prior=None)
    other = dataclasses.replace(other, propagator=propagator_of(other))
    return other, dataclasses.replace(found, q=other.free.scaled(other.free.start))


def _candidates(task: Task, group: Sequence[int], halves: np.ndarray) -> list[dict[str, dict]]:
    """What the inputs of a group may do instead, near where a linear step would have them; without shifts first."""
    choices = []
    for j, half in zip(group, halves, strict=True):
        signal = task.flat.inputs[j]
        wanted = _offset(signal.interpolation, 0.0) + half / 2
        options = [(kind, s) for s in SHIFTS for kind in ("hold", "linear")]
        now, period = _offset(signal.interpolation, 0.0), period_of(task)
        options = [o for o in options if abs(_offset(*o) - now) > NEAR and _offset(*o) - now < LATEST]
        options = [o for o in options if abs(_offset(*o) - wanted) < NEAR]
        options.sort(key=lambda o: (o[1] != 0.0, o[0] != signal.interpolation))
        choices.append([{signal.name: {"interpolation": k, "shift": s * period}} for k, s in options])
    return [{n: c for one in picked for n, c in one.items()} for picked in itertools.product(*choices)]


def _offset(kind: str, shift: float) -> float:
    """Samples by which an input comes later than a held one: a linear one is half a sample earlier."""
    return shift - 0.5 * (kind != "hold")


def _best_of(base: tuple[Task, Minimum], before: Weighed, starts: bool, tried, adaptable, enough) -> Change | None:
    """The likeliest of the changes by a fit, one without shift where that is enough; None where none explains most."""
    fits: list[tuple[Weighed, Mapping[str, dict]]] = []
    for inputs in tried:
        try:
            after = fitted(with_inputs(base[0], inputs), base[1], adaptable)
        except SolveError:
            continue
        shifted = any(c["shift"] for c in inputs.values())
        at_noise = shifted or (starts and bool(inputs))
        if explains_most(before, after, enough if inputs else MOST_OF_IT, at_noise):
            fits.append((after, inputs))
    enough = min((after.score for after, _ in fits), default=np.inf) + TELLING
    return next((_told(before, after, starts, inputs) for after, inputs in fits if after.score < enough), None)


def _moved_by_starts(task, found, auto, free, freed, adaptable) -> Change | None:
    """Free starts where those assumed are refuted and move a parameter by more than its sigma."""
    if freed is None or not len(found.q):
        return None
    promised = free.step()
    least = _by_chance(auto, free, promised)
    if promised.gain - auto.step().gain < least or not np.any(np.abs(promised.q) > _sigma(found)):
        return None
    try:
        after = fitted(*freed, adaptable)
    except SolveError:
        return None
    before = Weighed(task, found, score(task, found))
    moved = np.any(np.abs(after.minimum.q - found.q) > _sigma(found))
    return _told(before, after, True, {}) if moved and 2 * (before.score - after.score) > least else None


def _sigma(found: Minimum) -> np.ndarray:
    """Standard deviations of q, (np,); infinite where nothing is known."""
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = np.diag(np.linalg.pinv(found.information(), hermitian=True))
        return np.where(variance > 0, np.sqrt(np.maximum(variance, 0)), np.inf)


def _by_chance(auto: Seen, free: Seen, promised: Step) -> float:
    """The gain in the sum of squares that further start states reach by chance where those assumed are right."""
    more = sum(b[2].shape[1] - a[2].shape[1] for a, b in zip(auto.rows, free.rows, strict=True))
    return float(chdtri(more, CHANCE)) * promised.level


# -- points and fits ---------------------------------------------------------------------------------------------------
def _starts_freed(task: Task, found: Minimum) -> tuple[Task, Minimum] | None:
    """The same point with every start state free; None where all are, or where they shall not be."""
    shooting, _ = whole_runs(task)
    if task.initial_states != "auto" or shooting.start.whole or not task.flat.states:
        return None
    other = dataclasses.replace(task, initial_states="free", propagator=propagator_of(task))
    nominal = np.array([s.nominal for s in task.flat.states])
    p = task.free.vector(found.q)
    known = found.z * shooting.start.nominal
    x = [shooting.start(r.u[0], p, z)[0] for r, z in zip(task.recordings, known, strict=True)]
    z = whole_runs(other)[0].clip(np.array(x) / nominal)
    return other, dataclasses.replace(found, z=z)


# -- words -------------------------------------------------------------------------------------------------------------
def _told(before: Weighed, after: Weighed, starts: bool, inputs: Mapping[str, dict], *words: str) -> Change:
    was, now = misses(before.task, before.minimum), misses(after.task, after.minimum)
    most = int(np.argmax(was - now))
    name, times = before.task.flat.outputs[most].name, (float(was[most]), float(now[most]))
    left = f"{name} is left at {times[1]:.3g} times the noise, else at {times[0]:.3g}"
    of = {s.name: s for s in before.task.flat.inputs}
    words, changes = [*words], {}
    for n, change in inputs.items():
        shift = change["shift"]
        kind, was_kind = (HELD.get(k, k) for k in (change["interpolation"], of[n].interpolation))
        said = f"is {kind} between its samples and not {was_kind} as assumed" if kind != was_kind else ""
        late = f"comes {abs(shift):.3g} s {'later' if shift > 0 else 'earlier'} than it is stamped" if shift else ""
        words.append(f"input {n} {' and '.join(w for w in (said, late) if w)}")
        changes[n] = {**change, "chosen_by": "fit", "why": left}
    if starts:
        known = whole_runs(before.task)[0].start.names
        hidden = [s.name for s in after.task.flat.states if s.name not in known]
        few = f"{', '.join(hidden[:4])}{' ...' if len(hidden) > 4 else ''}"
        words.append(f"the start of {few} is not what the model assumes: no output measures it, and it is estimated")
    told = tuple(f"{w}: {left}. The answer uses this." for w in words)
    return Change(inputs=changes, free_starts=starts, times=times, sentences=told)
