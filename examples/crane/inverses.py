"""The ways from a wanted velocity of a cylinder to a current: learnt, identified, or a straight line.

Each answers ``currents(v, strokes)`` (n,) for wanted velocities (n,) [m/s] at wanted strokes (n, 2) [m].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import isotonic_regression, minimize_scalar

from hydrotwin.identification import identify
from hydrotwin.learned.block_file import LearnedBlock
from hydrotwin.learned.gaussian.dual import learn_dual_gp
from hydrotwin.learned.grey_box.learn import learn_grey_box
from hydrotwin.learned.inverse.curve import static_answer
from hydrotwin.learned.inverse.data import Characteristic
from hydrotwin.learned.inverse.learn import learn_inverse
from hydrotwin.models.effects import add_effect
from hydrotwin.models.language import Model
from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.spool_valve import quasi_static
from hydrotwin.records import Record
from hydrotwin.simulation import Block

from .rehearsal import AXES, PERIOD, SteadyPoints, holding_forces

AREAS = {"boom": (3.117e-3, 2.161e-3), "jib": (1.963e-3, 1.374e-3)}  # m2, bore and annulus on the data sheets
SUPPLY, TANK, VISCOUS = 180e5, 5e5, 1.5e4  # Pa, Pa, N.s/m: gauges, and a guess
Currents = Callable[[np.ndarray, np.ndarray], np.ndarray]


def curve(points: SteadyPoints, axis: str, half_width: float = 0.0) -> Characteristic:
    """The steady points as a characteristic, with the play of the spool taken out of the commands."""
    wanted = Signal(f"wanted_{axis}_velocity", "m/s", "wanted velocity of the cylinder", 0.1, "linear")
    command = points.command - half_width * points.raised
    return Characteristic(Signal(f"{axis}_current", "1"), wanted, command, points.velocity, points.sigma, PERIOD)


def lateness(records: list[Record], axis: str, forward: Characteristic) -> float:
    """How late the cylinder answers [s], dead time and lags together.

    The delay at which the integral of the static characteristic comes closest to the strokes.
    """
    order = np.argsort(forward.commands)
    u, v = forward.commands[order], isotonic_regression(forward.rates[order]).x

    def miss(delay: float) -> float:
        total = 0.0
        for record in records:
            t, command = record.time, record[f"{axis}_current"]
            now = np.where(t < delay, 0.0, np.interp(np.interp(t - delay, t, command), u, v))
            left = record[f"{axis}_stroke"] - np.cumsum(now) * PERIOD
            total += float(np.sum((left - np.polynomial.Polynomial.fit(t, left, 1)(t)) ** 2))  # the rest is the load's
        return total

    grid = np.arange(0.0, 0.3, 0.02)
    best = grid[int(np.argmin([miss(d) for d in grid]))]
    return float(minimize_scalar(miss, bounds=(max(best - 0.02, 0), best + 0.02), method="bounded").x)


def straight_line(points: SteadyPoints) -> Currents:
    """Without any knowledge of the deadband: the line through the origin closest to the points."""
    gain = points.command @ points.velocity / (points.command @ points.command)
    return lambda v, strokes: v / gain


def learned(source, axis: str, method: str = "table", **options) -> Currents:
    """An inverse learnt from a characteristic, or from a forward block or model of the axis."""
    block = learn_inverse(source, f"{axis}_current", f"{axis}_velocity", method=method, **options)
    return lambda v, strokes: static_answer(block, v)


def learned_from_block(block: Block, axis: str, **options) -> Currents:
    """The inverse of a learned forward block of the axis: current in, velocity or stroke among its outputs."""
    names = (f"{axis}_velocity", "velocity", f"{axis}_stroke", "position")
    wanted = [s.name for s in block.outputs if s.name in names]
    if len(block.inputs) != 1 or not wanted:
        raise DataError(
            f"{block.name}: not a forward block of one axis (got inputs {[s.name for s in block.inputs]}, outputs "
            f"{[s.name for s in block.outputs]}). It needs the current alone in, {axis}_velocity or {axis}_stroke out. "
            f"Learn it from the staircases of the {axis}."
        )
    inverse = learn_inverse(block, block.inputs[0], wanted[0], settle=1.0, **options)
    return lambda v, strokes: static_answer(inverse, v)


def dual_process(records: list[Record], axis: str) -> LearnedBlock:
    """The paper's forward model at the paper's 10 Hz: current to measured spool, spool to the rate of the stroke."""
    current, stroke, spool = (f"{axis}_{name}" for name in ("current", "stroke", "spool"))
    return learn_dual_gp(records, [current], [stroke], through=spool, period=0.1)


def grey_box(records: list[Record], axis: str) -> LearnedBlock:
    """Dead time, latent spool, play and a monotone map, from current and stroke alone."""
    return learn_grey_box(records, [f"{axis}_current"], [f"{axis}_stroke"])


def identified(records: list[Record], axis: str) -> tuple[Model, Currents]:
    """The shipped quasi-static valve with null offset and deadband, identified, and the inverse of its steady answer.

    It knows the bores, but not the linkage: the load is one constant force.
    """
    model = add_effect(add_effect(quasi_static(), "null_bias"), "command_deadband", values={"width": 0.1})
    cap, rod = AREAS[axis]
    free = {
        "curve.flow_coefficient": {"value": 6e-8, "free": True},
        "curve.load_force": {"value": 1e4, "bounds": (-1e5, 1e5), "free": True},
        "solenoid.dead_time": {"value": 0.03, "bounds": (0.0, 0.3), "free": True},
    }
    known = {"curve.cap_area": cap, "curve.rod_area": rod, "curve.viscous": VISCOUS, "slide.natural_frequency": 60.0}
    still = {name: {"free": False} for name in ("curve.viscous", "slide.natural_frequency", "slide.damping")}
    model = model.with_settings(free).with_settings(still).with_parameters(known)
    units = {"current": "1", "position": "m"}
    seen = [
        Record(r.time, {"current": r[f"{axis}_current"], "position": r[f"{axis}_stroke"]}, units, r.name)
        for r in records
    ]
    fitted = model.with_parameters(identify(model, seen, starts=1).values)
    block = learn_inverse(fitted, "current", "velocity", settle=0.6)
    return fitted, lambda v, strokes: static_answer(block, v)


@dataclass(frozen=True)
class LoadedValve:
    """Four edges and a cylinder under a known load: ``u = g(v, F)/k + D sign(v) - b + h raised``.

    flow [m3/(s.sqrt(Pa))] : k. deadband : D. offset : b. half_width : h of the play.
    """

    axis: str
    flow: float
    deadband: float
    offset: float
    half_width: float

    def currents(self, v: np.ndarray, strokes: np.ndarray) -> np.ndarray:
        """Currents (n,) for velocities (n,) at strokes (n, 2), without the play."""
        return _opening(v, strokes, self.axis) / self.flow + self.deadband * np.sign(v) - self.offset


def loaded_valve(points: SteadyPoints, axis: str, with_play: bool = True) -> LoadedValve:
    """Identify the valve by linear least squares on the steady points that move, the load from statics."""
    moves = np.abs(points.velocity) > 3e-3
    v, strokes = points.velocity[moves], points.strokes[moves]
    columns = [_opening(v, strokes, axis), np.sign(v), -np.ones_like(v), points.raised[moves] * with_play]
    inverse_flow, deadband, offset, half_width = np.linalg.lstsq(
        np.column_stack(columns), points.command[moves], rcond=None
    )[0]
    return LoadedValve(axis, 1 / inverse_flow, deadband, offset, half_width)


def _opening(v: np.ndarray, strokes: np.ndarray, axis: str) -> np.ndarray:
    """k x for a velocity under the load at the strokes: ``v sqrt(S/(F_0 - b |v|))``, see `FlowCurve`."""
    (cap, rod), load = AREAS[axis], holding_forces(strokes)[:, AXES.index(axis)]
    out, back = cap * SUPPLY - rod * TANK - load, rod * SUPPLY - cap * TANK + load
    return v * np.sqrt((cap**3 + rod**3) / (np.where(v > 0, out, back) - VISCOUS * np.abs(v)))
