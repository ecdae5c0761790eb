"""From short windows to the whole recording: how a poor start is led into the right valley.

A free run from a wrong start can leave the recording altogether (a gain 30 % too high drives into the end stop), and a
lightly damped mode makes its cost multi-modal: a frequency error of df over T seconds turns the phase by df T. Windows
of a fraction of a second, each from its own start states, have one valley; then the windows grow.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel

from .problem import Recording
from .shooting import Segment
from .start_states import StartStates

PERIODS = 3.0  # of the fastest lightly damped mode in the shortest window: 15 % frequency error is then half a turn
LIGHTLY_DAMPED = 0.3
GROWTH = 4
SOON = 10  # samples within which a sensor must have begun for a start to be measured


def first_guess(flat: FlatModel, recordings: Sequence[Recording], propagator, p: np.ndarray, seconds: float):
    """State trajectories (n, nx) per recording: runs over windows, measured states reset at each window's start."""
    measured = measured_states(flat)
    return [_stitched(flat, recording, propagator, p, seconds, measured) for recording in recordings]


def measured_states(flat: FlatModel) -> dict[int, int]:
    """State index -> index of the output that measures it."""
    outputs = [s.name for s in flat.outputs]
    return {i: outputs.index(s.measured_by) for i, s in enumerate(flat.states) if s.measured_by in outputs}


def measured_start(flat: FlatModel, recording: Recording, at: int = 0) -> dict[str, float]:
    """Values at sample ``at``, or the nearest that is known, of the states that are measured as the recording starts.

    The states are the same all along: a sensor may miss any sample, or be read at every twentieth. Of a recording that
    begins in motion they only say where a search begins.
    """
    found = {}
    for i, j in measured_states(flat).items():
        known = np.flatnonzero(np.isfinite(recording.y[:, j]))
        if len(known) and (known[0] < SOON or recording.in_motion):
            found[flat.states[i].name] = float(recording.y[known[np.argmin(np.abs(known - at))], j])
    return found


def _stitched(flat, recording, propagator, p, seconds, measured) -> np.ndarray:
    states = np.full((len(recording.time), len(flat.states)), np.nan)
    x = start_from_measured(flat, recording, p)
    for segment in cut([recording], seconds):
        x = _reset(x, recording, segment.first, measured)
        until = min(segment.last + 1, len(recording.time))
        part = slice(segment.first, until)
        try:
            _, run = propagator.run(recording.time[part], recording.u[part], p, x)
        except SolveError:
            run = None
        if run is None or not _plausible(flat, run):
            x = start_from_measured(flat, recording, p, segment.first)
            run = np.tile(x, (until - segment.first, 1))
        states[segment.first : segment.last] = run[: segment.last - segment.first]
        x = run[-1]
    return states


def _plausible(flat: FlatModel, states: np.ndarray) -> bool:
    nominal = np.array([s.nominal for s in flat.states])
    return bool(np.isfinite(states).all() and np.all(np.abs(states) < 1e4 * nominal))


def _reset(x: np.ndarray, recording: Recording, k: int, measured: dict[int, int]) -> np.ndarray:
    x = x.copy()
    for i, j in measured.items():
        if np.isfinite(recording.y[k, j]):
            x[i] = recording.y[k, j]
    return x


def start_from_measured(flat: FlatModel, recording: Recording, p: np.ndarray, at: int = 0) -> np.ndarray:
    """The model's start states when the measured ones have their sample at ``at``. Shape (nx,)."""
    given = measured_start(flat, recording, at)
    names = tuple(s.name for s in flat.states if s.name in given)
    x = flat.start_given(names)(recording.u[at], p, [given[n] for n in names])
    return np.array(x).ravel()


def cut(recordings: Sequence[Recording], seconds: float, delay: float = 0.0) -> list[Segment]:
    """Segments of about ``seconds`` of every recording; a segment begins ``delay`` early to fill the delay lines."""
    segments = []
    for r, recording in enumerate(recordings):
        time, n = recording.time, len(recording.time)
        pieces = max(1, int((time[-1] - time[0]) / seconds)) if np.isfinite(seconds) else 1
        edges = np.searchsorted(time, np.linspace(time[0], time[-1], pieces + 1))
        edges[0], edges[-1] = 0, n
        edges = np.unique(edges)
        for first, last in itertools.pairwise(edges):
            lead_in = int(np.searchsorted(time, time[first] - delay, side="right")) - 1
            segments.append(Segment(r, max(lead_in, 0), int(first), int(last)))
    return segments


def window_starts(segments: Sequence[Segment], states: Sequence[np.ndarray], start: StartStates) -> np.ndarray:
    """Scaled start states (segments, nz) of windows, read off known state trajectories."""
    z = np.array([states[s.recording][s.begin, start.columns] for s in segments]) / start.nominal
    return np.nan_to_num(z)


def horizons(flat: FlatModel, recordings: Sequence[Recording], p: np.ndarray) -> list[float]:
    """Window lengths [s], growing; the whole recording comes after them. None for what cannot start in the middle."""
    if flat.black_box:
        return []
    longest = max(r.time[-1] - r.time[0] for r in recordings)
    period = float(np.median(np.concatenate([np.diff(r.time) for r in recordings])))
    outputs = max(np.isfinite(r.y).any(axis=0).sum() for r in recordings)
    needed = period * (np.ceil(2 * len(flat.states) / outputs) + 8)
    frequency = fastest_oscillation(flat, recordings, p)
    shortest = max(needed, PERIODS / frequency if frequency else 0.0, 20 * period if not frequency else 0.0)
    lengths = []
    while shortest < longest / 2:
        lengths.append(float(shortest))
        shortest *= GROWTH
    return lengths


def fastest_oscillation(flat: FlatModel, recordings: Sequence[Recording], p: np.ndarray) -> float | None:
    """Frequency [Hz] of the fastest lightly damped mode at the starts of the recordings; None when all are damped."""
    mode = lightly_damped(flat, recordings)(p)
    return abs(mode) / (2 * np.pi) if mode else None


def lightly_damped(flat: FlatModel, recordings: Sequence[Recording]) -> Callable[[np.ndarray], complex | None]:
    """The eigenvalue [1/s] of the fastest lightly damped mode as a function of the parameters."""
    t, x, u, q = (ca.SX.sym(n, flat.ode.size1_in(i)) for i, n in enumerate("txup"))
    jacobian = ca.Function("modes", [t, x, u, q], [ca.densify(ca.jacobian(flat.ode(t, x, u, q)[0], x))])
    points = [(r, int(k)) for r in recordings for k in np.linspace(0, len(r.time) - 1, 4)]

    def fastest(p: np.ndarray) -> complex | None:
        found = 0j
        for r, k in points:
            A = np.array(jacobian(r.time[k], start_from_measured(flat, r, p, k), r.u[k], p))
            if not np.isfinite(A).all():
                continue
            modes = np.linalg.eigvals(A)
            light = np.abs(modes.imag) > np.abs(modes) * np.sqrt(1 - LIGHTLY_DAMPED**2)
            found = max([found, *modes[light].tolist()], key=abs)
        return found or None

    return fastest


def longest_delay(flat: FlatModel, p: np.ndarray, seconds: float) -> float:
    """Lead-in [s] that fills every delay line: twice the present dead time, at least a quarter of the window."""
    delays = [p[flat.index_of(s.dead_time)] for s in flat.inputs if s.dead_time]
    return max(2 * max(delays), seconds / 4) if delays else 0.0
