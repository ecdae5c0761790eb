"""What was assumed about the recordings, doubted before anything is called converged or missing.

A held input that was linear, a column half a sample late or early, a start in motion where the model begins at rest:
each leaves many times the noise, bends the parameters, and looks like missing physics. So a minimum of free runs is
asked what it would gain by

    starts : free start states where no output measures them
    inputs : each input held or linear, and up to a sample earlier or half a sample later than it is stamped

first by one linear step from its sensitivities (an input half a sample later adds one direction), then, where that
promises to explain most of what is left, by a fit. A whole sample later and more is a dead time, which has a name.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtri

from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import INTERPOLATIONS, Signal
from hydrotwin.simulation import prepare
from hydrotwin.simulation.inputs import as_seen

from .answer import explains
from .descent import Task, whole_runs
from .least_squares import Minimum, minimise
from .uncertainty import without_starts
from .weighing import WORTH_IT, Weighed, misses, score, weighed_by_residual

PROMISED = 0.5  # of what is left beyond the noise: what one linear step must promise before a fit is made
FAR_MORE = {"starts": 0.5, "inputs": 0.9}  # of what is left beyond the noise: what the fit must close
AT_NOISE = 1.25  # times the noise: what a shift of an input, or all at once, must come down to
CHANCE = 1e-3  # that start states which are right explain so much
SHIFTS = (0.0, -0.5, 0.5, -1.0)  # samples; a whole one later is a dead time
NEAR = 0.3  # samples between what is wanted and what is tried
LATEST = 0.6  # samples by which an input may come later than it was taken for: more is a dead time
TELLING = 10.0  # in the likelihood's logarithm: less does not tell changes apart, and the smaller one is taken
MOST = 25  # iterations of a trial
PATIENCE = 3  # assumptions given up one after the other


@dataclass(frozen=True)
class Change:
    """An assumption to give up: what inputs do (see `changed`), whether starts are free, and the sentences that say so.

    ``times`` : what was left over the noise before, and after, of the output that gained most.
    """

    inputs: Mapping[str, dict] = field(default_factory=dict)
    free_starts: bool = False
    times: tuple[float, float] = (np.nan, np.nan)
    sentences: tuple[str, ...] = ()

    @property
    def used(self) -> bool:
        """Whether anything is taken otherwise, and not only said."""
        return bool(self.inputs) or self.free_starts


@dataclass(frozen=True, eq=False)
class _Step:
    """A linear step: gain in the sum of squares, step in q, half samples of each input, and the ``level`` of what it
    leaves: the variance of a sample, noise at least, times how many neighbours say the same thing."""

    gain: float
    q: np.ndarray
    halves: np.ndarray
    level: float


@dataclass(frozen=True, eq=False)
class _Seen:
    """A minimum in directions: per recording residuals (m,), d/dq (m, np), start columns (m, nz), inputs (m, nu)."""

    rows: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]
    floor: float  # of the sum of squares that is noise
    outputs: int  # that are measured: values of one sample

    def step(self, inputs: Sequence[int] = ()) -> _Step:
        """The linear step in q, in the starts and along the ``inputs`` that leaves least."""
        bare = [without_starts(np.hstack([r[:, None], J, D[:, inputs], Z]), 1 + J.shape[1] + len(inputs))
                for r, J, Z, D in self.rows]  # fmt: skip
        whole = np.vstack(bare)
        size = np.linalg.norm(whole[:, 1:], axis=0)
        size = np.where(size > 0, size, 1.0)
        step = -np.linalg.lstsq(whole[:, 1:] / size, whole[:, 0], rcond=1e-9)[0] / size
        left = whole[:, 0] + whole[:, 1:] @ step
        before = sum(float(r @ r) for r, *_ in self.rows)
        energy, lag = float(left @ left), self.outputs
        rho = np.clip(float(left[:-lag] @ left[lag:]) / energy, 0.0, 0.97) if energy > 0 else 0.0
        level = max(energy, self.floor) / max(len(left), 1) * (1 + rho) / (1 - rho)
        shared = self.rows[0][1].shape[1]
        return _Step(before - energy, step[:shared], step[shared:], level)

    @property
    def excess(self) -> float:
        """The sum of squares beyond the noise."""
        return max(sum(float(r @ r) for r, *_ in self.rows) - self.floor, np.finfo(float).tiny)


def doubted(task: Task, found: Minimum, adaptable: np.ndarray) -> Change | None:
    """The assumption that a minimum of free runs should give up; None where those made are good enough.

    ``adaptable`` (ny,) as in `search`. At the noise only starts are asked: they may move a parameter without a trace.
    """
    explained = explains(task, found)
    try:
        auto = _seen(task, found)
        freed = _starts_freed(task, found)
        free = _seen(*freed, inputs=not explained) if freed else None
    except (SolveError, np.linalg.LinAlgError):
        return None
    better = None if explained else _explained_better(task, found, auto, free, freed, adaptable)
    if better is None and bool(np.all(misses(task, found) < WORTH_IT)):
        return _moved_by_starts(task, found, auto, free, freed, adaptable)
    return better


def _explained_better(task, found, auto, free, freed, adaptable) -> Change | None:
    """The simplest change that explains most of what is left beyond the noise."""
    seen = _seen(task, found, inputs=True)
    open_inputs = [j for j, s in enumerate(task.flat.inputs) if s.chosen_by != "user" and not s.shift]
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
        change = _best_of(base, before, starts, _candidates(task, group, promised.halves), adaptable)
        if change:
            return change
    return _hint(task, seen)


def _hint(task: Task, seen: _Seen) -> Change | None:
    """What is only said: an input that is not to be changed, or is a dead time late, and would explain what is left."""
    for j, signal in enumerate(task.flat.inputs):
        step = seen.step((j,))
        samples, share = float(step.halves[0]) / 2, min(step.gain / seen.excess, 1.0)
        if share > FAR_MORE["inputs"] and abs(samples) > NEAR:
            by = f"{abs(samples) * _period(task):.2g} s {'later' if samples > 0 else 'earlier'}"
            words = (
                f"input {signal.name} coming about {by} than it was taken for would explain {100 * share:.0f} % of what "
                "is left. Look at its clock, its interpolation, or for a dead time (dead_time in hydrotwin gap)."
            )
            return Change(sentences=(words,))
    return None


def _candidates(task: Task, group: Sequence[int], halves: np.ndarray) -> list[dict[str, dict]]:
    """What the inputs of a group may do instead, near where a linear step would have them; without shifts first."""
    choices = []
    for j, half in zip(group, halves, strict=True):
        signal = task.flat.inputs[j]
        wanted = _offset(signal.interpolation, 0.0) + half / 2
        options = [(kind, s) for s in SHIFTS for kind in INTERPOLATIONS]
        now, period = _offset(signal.interpolation, 0.0), _period(task)
        options = [o for o in options if abs(_offset(*o) - now) > NEAR and _offset(*o) - now < LATEST]
        options = [o for o in options if abs(_offset(*o) - wanted) < NEAR]
        options.sort(key=lambda o: (o[1] != 0.0, o[0] != signal.interpolation))
        choices.append([{signal.name: {"interpolation": k, "shift": s * period}} for k, s in options])
    return [{n: c for one in picked for n, c in one.items()} for picked in itertools.product(*choices)]


def _offset(kind: str, shift: float) -> float:
    """Samples by which an input comes later than a held one: a linear one is half a sample earlier."""
    return shift - 0.5 * (kind == "linear")


def _best_of(base: tuple[Task, Minimum], before: Weighed, starts: bool, tried, adaptable) -> Change | None:
    """The likeliest of the changes by a fit, one without shift where that is enough; None where none explains most."""
    fits: list[tuple[Weighed, Mapping[str, dict]]] = []
    for inputs in tried:
        try:
            fitted = _fitted(_with_inputs(base[0], inputs), base[1], adaptable)
        except SolveError:
            continue
        shifted = any(c["shift"] for c in inputs.values())
        if _explains_most(before, fitted, starts, bool(inputs), shifted):
            fits.append((fitted, inputs))
    enough = min((fitted.score for fitted, _ in fits), default=np.inf) + TELLING
    return next((_told(before, fitted, starts, inputs) for fitted, inputs in fits if fitted.score < enough), None)


def _explains_most(before: Weighed, after: Weighed, starts: bool, inputs: bool, shifted: bool) -> bool:
    was, now = (_beyond_noise(w) for w in (before, after))
    closed = 1 - now.sum() / was.sum()
    if closed < FAR_MORE["inputs" if inputs else "starts"] or np.any(now > np.maximum(was, 0.1 * was.max())):
        return False
    return not (shifted or (starts and inputs)) or bool(np.all(misses(after.task, after.minimum) < AT_NOISE))


def _moved_by_starts(task, found, auto, free, freed, adaptable) -> Change | None:
    """Free starts where those assumed are refuted and move a parameter by more than its sigma."""
    if freed is None or not len(found.q):
        return None
    promised = free.step()
    least = _by_chance(auto, free, promised)
    if promised.gain - auto.step().gain < least or not np.any(np.abs(promised.q) > _sigma(found)):
        return None
    try:
        fitted = _fitted(*freed, adaptable)
    except SolveError:
        return None
    before = Weighed(task, found, score(task, found))
    moved = np.any(np.abs(fitted.minimum.q - found.q) > _sigma(found))
    return _told(before, fitted, True, {}) if moved and 2 * (before.score - fitted.score) > least else None


def _sigma(found: Minimum) -> np.ndarray:
    """Standard deviations of q, (np,); infinite where nothing is known."""
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = np.diag(np.linalg.pinv(found.information(), hermitian=True))
        return np.where(variance > 0, np.sqrt(np.maximum(variance, 0)), np.inf)


def _by_chance(auto: _Seen, free: _Seen, promised: _Step) -> float:
    """The gain in the sum of squares that further start states reach by chance where those assumed are right."""
    more = sum(b[2].shape[1] - a[2].shape[1] for a, b in zip(auto.rows, free.rows, strict=True))
    return float(chdtri(more, CHANCE)) * promised.level


# -- the pieces --------------------------------------------------------------------------------------------------------
def _seen(task: Task, found: Minimum, inputs: bool = False) -> _Seen:
    """The directions of a minimum. Raises SolveError where a run diverges."""
    shooting, _ = whole_runs(task)
    late = [_with_inputs(task, {s.name: {"shift": 0.5 * _period(task)}}) for s in task.flat.inputs] if inputs else []
    late = [whole_runs(t)[0] for t in late]
    rows, shared = [], len(found.q)
    for i in range(len(task.recordings)):
        row = shooting.sensitivities(i, found.q, found.z[i])
        moved = [one.residuals(i, found.q, found.z[i]) for one in late]
        if row is None or any(m is None for m in moved):
            raise SolveError("a run diverges")
        r, J = task.loss.linearised(*row[:2])
        here = np.isfinite(task.recordings[i].y) & (task.weights > 0)
        now = shooting.residuals(i, found.q, found.z[i]) if inputs else None
        D = np.array([(m - now)[here] for m in moved]).reshape(len(moved), -1).T if inputs else np.zeros((len(r), 0))
        rows.append((r, J[:, :shared], J[:, shared:], D))
    counts = np.sum([np.isfinite(r.y).sum(axis=0) for r in task.recordings], axis=0)
    used = task.weights > 0
    floor = float(counts[used] @ (task.weights[used] * task.noise[used]) ** 2)
    return _Seen(rows, floor, max(int((counts[used] > 0).sum()), 1))


def _starts_freed(task: Task, found: Minimum) -> tuple[Task, Minimum] | None:
    """The same point with every start state free; None where all are, or where they shall not be."""
    shooting, _ = whole_runs(task)
    if task.initial_states != "auto" or shooting.start.whole or not task.flat.states:
        return None
    other = dataclasses.replace(task, initial_states="free", propagator=_propagator(task))
    nominal = np.array([s.nominal for s in task.flat.states])
    p = task.free.vector(found.q)
    known = found.z * shooting.start.nominal
    x = [shooting.start(r.u[0], p, z)[0] for r, z in zip(task.recordings, known, strict=True)]
    z = whole_runs(other)[0].clip(np.array(x) / nominal)
    return other, dataclasses.replace(found, z=z)


def _with_inputs(task: Task, changes: Mapping[str, Mapping]) -> Task:
    """The task whose inputs do something else; what is recorded is moved here, so that nothing below has to."""
    if not changes:
        return task
    flat = task.flat.with_inputs({n: {k: v for k, v in c.items() if k != "shift"} for n, c in changes.items()})
    moved = [(dataclasses.replace(s, shift=changes[s.name]["shift"]) if s.name in changes else s) for s in flat.inputs]
    recordings = tuple(dataclasses.replace(r, u=_columns(moved, r)) for r in task.recordings)
    task = dataclasses.replace(task, flat=flat, recordings=recordings)
    kinds = any("interpolation" in c for c in changes.values())
    return dataclasses.replace(task, propagator=_propagator(task)) if kinds else task


def _columns(signals: Sequence[Signal], recording) -> np.ndarray:
    return np.column_stack([as_seen(s, recording.time, u) for s, u in zip(signals, recording.u.T, strict=True)])


def _propagator(task: Task):
    """What runs the task with every start free, by the step and method that were asked for."""
    states = [s.name for s in task.flat.states]
    step, method = getattr(task.propagator, "asked", (task.propagator.step, "auto"))
    return prepare(task.flat, free_parameters=task.free.names, free_states=states, step=step, method=method)


def _period(task: Task) -> float:
    return float(np.median(np.concatenate([np.diff(r.time) for r in task.recordings])))


def _fitted(task: Task, found: Minimum, adaptable: np.ndarray) -> Weighed:
    """A fit from where another ended, under weights that suit it."""
    reached = minimise(whole_runs(task)[0], found.q, found.z, most=MOST, relative=1e-3)
    return weighed_by_residual(task, reached, adaptable, MOST)


def _beyond_noise(w: Weighed) -> np.ndarray:
    """What is left of every recording beyond the noise, in units of it, squared. (recordings,)"""
    shooting, _ = whole_runs(w.task)
    left = []
    for i in range(len(w.task.recordings)):
        r = shooting.residuals(i, w.minimum.q, w.minimum.z[i])
        used = w.task.weights > 0
        with np.errstate(invalid="ignore"):
            r = r[:, used] / (w.task.weights[used] * w.task.noise[used])
        seen = np.isfinite(r)
        left.append(max(float((r[seen] ** 2).sum() - seen.sum()), 0.0))
    return np.array(left) + 1e-300


# -- words -------------------------------------------------------------------------------------------------------------
def _told(before: Weighed, after: Weighed, starts: bool, inputs: Mapping[str, dict]) -> Change:
    was, now = misses(before.task, before.minimum), misses(after.task, after.minimum)
    most = int(np.argmax(was - now))
    name, times = before.task.flat.outputs[most].name, (float(was[most]), float(now[most]))
    left = f"{name} is left at {times[1]:.3g} times the noise, else at {times[0]:.3g}"
    of = {s.name: s for s in before.task.flat.inputs}
    words, changes = [], {}
    for n, change in inputs.items():
        shift = change["shift"]
        kind, held = ("held" if k == "hold" else "linear" for k in (change["interpolation"], of[n].interpolation))
        said = f"is {kind} between its samples and not {held} as assumed" if kind != held else ""
        late = f"comes {abs(shift):.3g} s {'later' if shift > 0 else 'earlier'} than it is stamped" if shift else ""
        words.append(f"input {n} {' and '.join(w for w in (said, late) if w)}")
        changes[n] = {**change, "chosen_by": "fit", "why": left}
    if starts:
        known = whole_runs(before.task)[0].start.names
        hidden = [s.name for s in after.task.flat.states if s.name not in known]
        few = f"{', '.join(hidden[:4])}{' ...' if len(hidden) > 4 else ''}"
        words.append(f"the start of {few} is not what the model assumes: no output measures it, and it is estimated")
    return Change(changes, starts, times, tuple(f"{w}: {left}. The answer uses this." for w in words))
