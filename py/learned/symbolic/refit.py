"""Runs of a formula over recordings, free or static, with the slopes of its constants, and their refit with SciPy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from ..network.narx import NarxShape
from ..walking import Walk
from .block import Formula, evaluate

TOLERANCE = 1e-4  # of the error: where a refit ends
AT_THE_EDGE = 1e-9  # of an output's scale: a free run so near to a bound of its outputs has been stopped by it


@dataclass(frozen=True)
class Series:
    """One recording over the readable scales: features z (n, nf) and measured outputs y (n, ny)."""

    z: np.ndarray
    y: np.ndarray


@dataclass(frozen=True)
class Piece:
    """Samples ``first`` to ``last`` of a series; ``rest``: it starts standing still, as a block does.

    counted : (begin, end) of the samples that are fitted or judged, all others are only run through; empty: all.
    """

    series: int
    first: int
    last: int
    rest: bool
    counted: tuple[tuple[int, int], ...] = ()

    @property
    def ranges(self) -> tuple[tuple[int, int], ...]:
        """What is counted."""
        return self.counted or ((self.first, self.last),)


@dataclass(frozen=True)
class Bounds:
    """Per output: increment scale over output scale, limit of an increment, lowest and highest output; normalised."""

    ratio: np.ndarray
    limit: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


@dataclass(frozen=True)
class Runs:
    """Pieces side by side, padded to one length: start (s, nx), known (s, n, nk), target (s, n, no), inside (s, n)."""

    start: np.ndarray
    known: np.ndarray
    target: np.ndarray
    inside: np.ndarray


class Run:
    """How a formula runs; subclasses say what its outputs and their derivatives are."""

    formula: Formula

    def outputs(self, constants, runs: Runs) -> np.ndarray:
        """Outputs (s, n, no)."""
        raise NotImplementedError

    def derivatives(self, constants, runs: Runs) -> np.ndarray:
        """d outputs / d constants, (s, n, no, nc)."""
        raise NotImplementedError

    def stays(self, outputs: np.ndarray) -> bool:
        """Whether outputs (n, no) are those of a run that stays where it may be."""
        return bool(np.isfinite(outputs).all())

    def errors(self, constants, runs: Runs) -> tuple[float, float]:
        """Error by which a formula is chosen, and RMS over all samples and outputs, in output scales.

        Both are infinite for a run that leaves the finite numbers, the first for one that diverges as well.
        """
        found = self.outputs(constants, runs)[runs.inside]
        rms = float(np.sqrt(np.mean((found - runs.target[runs.inside]) ** 2)))
        rms = rms if np.isfinite(rms) else np.inf
        return (rms if self.stays(found) else np.inf), rms

    def refit(self, runs: Runs, evaluations: int) -> Formula:
        """The formula with the constants of the least free-run error, by least squares from where they are.

        It stays as it is when its run or the derivatives leave the finite numbers.
        """
        from scipy.optimize import least_squares

        if not self.formula.constants:
            return self.formula

        def residual(c):
            return (self.outputs(c, runs) - runs.target)[runs.inside].ravel()

        def slopes(c):
            return self.derivatives(c, runs)[runs.inside].reshape(-1, len(c))

        first = np.array(self.formula.constants)
        try:
            found = least_squares(residual, first, slopes, x_scale="jac", ftol=TOLERANCE, max_nfev=evaluations)
        except (ValueError, np.linalg.LinAlgError):  # what SciPy raises for values that are not finite
            return self.formula
        return Formula(self.formula.tokens, tuple(float(c) for c in found.x))


class FreeRun(Run):
    """The free run of some outputs under their formulas; the other outputs are taken as measured.

    own : the outputs that run free; ``formula`` holds one expression for each of them.
    """

    def __init__(self, formula: Formula, own: Sequence[int], shape: NarxShape, bounds: Bounds):
        self.formula, self.own, self.shape = formula, tuple(own), shape
        self.fed = own_features(shape, own)
        self.known = [i for i in range(shape.features) if i not in set(self.fed)]
        x, w, c = (ca.SX.sym(n, len(v)) for n, v in zip("xwc", (self.fed, self.known, formula.constants), strict=True))
        z = dict(zip(self.fed, ca.vertsplit(x), strict=True)) | dict(zip(self.known, ca.vertsplit(w), strict=True))
        features = [z[i] for i in range(shape.features)]
        f = evaluate(formula.tokens, ca.vertsplit(c) if c.numel() else [], features, library=ca)
        part = {k: ca.DM(getattr(bounds, k)[list(own)]) for k in ("ratio", "limit", "lower", "upper")}
        d = ca.fmin(ca.fmax(ca.vertcat(*f), -part["limit"]), part["limit"])
        no = len(self.own)
        y = ca.fmin(ca.fmax(x[:no] + part["ratio"] * d, part["lower"]), part["upper"])
        after = ca.densify(ca.vertcat(y, ca.vertcat(d, x[no:, :])[: len(self.fed) - no, :]))
        self._plain = Walk(ca.Function("plain", [x, w, c], [after, x[:no]]))
        s = ca.SX.sym("s", len(self.fed), c.numel())
        moved = ca.densify(ca.mtimes(ca.jacobian(after, x), s) + ca.jacobian(after, c))
        whole, following = ca.vertcat(x, ca.vec(s)), ca.vertcat(after, ca.vec(moved))
        seen = ca.vertcat(x[:no], ca.vec(s[:no, :]))
        self._slopes = Walk(ca.Function("slopes", [whole, w, c], [following, seen]))
        self._ends = tuple(getattr(bounds, side)[list(own)] for side in ("lower", "upper"))

    def outputs(self, constants, runs: Runs) -> np.ndarray:
        """Outputs (s, n, no)."""
        return self._plain(runs.start, runs.known, constants)

    def derivatives(self, constants, runs: Runs) -> np.ndarray:
        """d outputs / d constants, (s, n, no, nc)."""
        no, nc = len(self.own), len(constants)
        start = np.hstack([runs.start, np.zeros((len(runs.start), len(self.fed) * nc))])
        both = self._slopes(start, runs.known, constants)
        return both[:, :, no:].reshape(*both.shape[:2], nc, no).swapaxes(2, 3)

    def stays(self, outputs: np.ndarray) -> bool:
        """Whether no bound of the outputs stopped the run."""
        lower, upper = self._ends
        return bool(np.all((outputs > lower + AT_THE_EDGE) & (outputs < upper - AT_THE_EDGE)))


class StaticRun(Run):
    """Outputs that are functions of the features of the same sample."""

    def __init__(self, formula: Formula, features: int):
        self.formula = formula
        w, c = ca.SX.sym("w", features), ca.SX.sym("c", len(formula.constants))
        f = ca.vertcat(*evaluate(formula.tokens, ca.vertsplit(c) if c.numel() else [], ca.vertsplit(w), library=ca))
        self._plain = ca.Function("plain", [w, c], [ca.densify(f)])
        self._slopes = ca.Function("slopes", [w, c], [ca.densify(ca.vec(ca.jacobian(f, c)))])

    def outputs(self, constants, runs: Runs) -> np.ndarray:
        """Outputs (s, n, no)."""
        return self._mapped(self._plain, constants, runs)

    def derivatives(self, constants, runs: Runs) -> np.ndarray:
        """d outputs / d constants, (s, n, no, nc)."""
        flat = self._mapped(self._slopes, constants, runs)
        return flat.reshape(*flat.shape[:2], len(constants), -1).swapaxes(2, 3)

    def _mapped(self, function: ca.Function, constants, runs: Runs) -> np.ndarray:
        count, length, _ = runs.known.shape
        known, constants = runs.known.reshape(count * length, -1).T, np.array(constants, dtype=float).reshape(-1, 1)
        return function(known, constants).full().T.reshape(count, length, -1)


def own_features(shape: NarxShape, own: Sequence[int]) -> list[int]:
    """Features that the given outputs feed back: the outputs, then their increments, the latest first."""
    return [lag * shape.outputs + i for lag in range(shape.output_lags + 1) for i in own]


def laid_out(series: Sequence[Series], pieces: Sequence[Piece], own: Sequence[int], shape: NarxShape) -> Runs:
    """The pieces side by side; a piece in mid-motion starts from the features there."""
    fed = own_features(shape, own)
    known = [i for i in range(shape.features) if i not in set(fed)]
    length = max(p.last - p.first for p in pieces)
    runs = Runs(
        np.zeros((len(pieces), len(fed))),
        np.zeros((len(pieces), length, len(known))),
        np.zeros((len(pieces), length, len(own))),
        np.zeros((len(pieces), length), dtype=bool),
    )
    for i, p in enumerate(pieces):
        z, y, n = series[p.series].z, series[p.series].y, p.last - p.first
        runs.start[i] = z[p.first, fed]
        if p.rest:
            runs.start[i] = 0.0
            runs.start[i, : len(own)] = y[p.first, own]
        runs.known[i, :n] = z[p.first : p.last, known]
        runs.known[i, n:] = z[p.last - 1, known]
        runs.target[i, :n] = y[p.first : p.last, own]
        for begin, end in p.ranges:
            runs.inside[i, begin - p.first : end - p.first] = True
    return runs


def cut(pieces: Sequence[Piece], length: int) -> list[Piece]:
    """The pieces in stretches of ``length`` samples, each started where the machine was."""
    return [
        Piece(p.series, k, min(k + length, p.last), p.rest and k == p.first)
        for p in pieces
        for k in range(p.first, max(p.last - length // 2, p.first + 1), length)
    ]
