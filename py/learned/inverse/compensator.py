"""A compensator in front of a machine: with it the machine follows a curve that was designed, not the one it has.

    u = f^-1(d(u_wanted)),   d(s) = sign(s) (c_1 |s| + ... + c_n |s|^n)

d is a polynomial through waypoints (command, rate), mirrored for the other direction: no deadband, centred, the same
both ways. f^-1 is learnt as any inverse (see `inverse`).
Source: Taheri et al., Nonlinear Model Learning for Compensation and Feedforward Control of Real-World Hydraulic
Actuators Using Gaussian Processes, IEEE RA-L 7 (2022), section IV-C, Fig. 7.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.simulation.block import TrainingDomain

from ..block_file import Certificate, LearnedBlock, LearnedKind, Shapes, assemble, register_kind
from .curve import (
    EXPRESSIONS,
    GRID,
    INVERSE_NETWORK,
    INVERSE_TABLE,
    network_shapes,
    refuse_falling,
    static_answer,
    static_functions,
    table_shapes,
)
from .data import characteristic
from .learn import TOLERANCE, learn_inverse


@dataclass(frozen=True)
class DesiredCurve:
    """Rates wanted at commands: ``d(s) = sign(s) sum_k c_k |s|^k``; coefficients (n,) from the first power on, SI.

    full : the command up to which it is designed; beyond it the rate stays.
    """

    coefficients: tuple[float, ...]
    full: float

    def __call__(self, commands: np.ndarray) -> np.ndarray:
        """Rates [SI] at commands (n,)."""
        s = np.asarray(commands, float)
        size = np.minimum(np.abs(s), self.full)
        return np.sign(s) * sum(c * size**k for k, c in enumerate(self.coefficients, 1))


def desired_curve(waypoints: Sequence[tuple[float, float]], degree: int | None = None) -> DesiredCurve:
    """A polynomial through waypoints ``(command, rate)`` of the positive direction, mirrored for the other.

    It starts at (0, 0). Of ``degree`` below the number of waypoints it is the least-squares one; None: through all.

    >>> curve = desired_curve([(0.5, 0.02), (1.0, 0.06)])
    >>> [round(float(r), 4) for r in curve([-1.0, 0.0, 0.5])]
    [-0.06, 0.0, 0.02]

    Raises DataError for waypoints that are no pairs, not positive, or joined by a curve that falls.
    """
    points = np.array([tuple(p) for p in waypoints if len(tuple(p)) == 2], float)
    if len(points) != len(list(waypoints)) or not len(points) or not np.isfinite(points).all() or (points <= 0).any():
        raise DataError(
            f"desired_curve: waypoints must be pairs (command, rate), both positive (got {list(waypoints)}). "
            "The curve starts at (0, 0) and is mirrored: give the positive direction."
        )
    degree = len(points) if degree is None else degree
    if not 1 <= degree <= len(points):
        raise DeclarationError(f"desired_curve: degree must be 1 to {len(points)} (got {degree}). Leave it out.")
    full = float(points[:, 0].max())
    powers = np.arange(1, degree + 1)
    solved = np.linalg.lstsq((points[:, :1] / full) ** powers, points[:, 1], rcond=None)[0]
    curve = DesiredCurve(tuple((solved / full**powers).tolist()), full)
    rates = curve(np.linspace(0, full, GRID))
    if (np.diff(rates) < 0).any():
        at = np.linspace(0, full, GRID)[int(np.argmin(np.diff(rates)))]
        raise DataError(
            f"desired_curve: the polynomial of degree {degree} falls near a command of {at:.3g}. "
            "A larger command must not ask for a smaller rate. Move the waypoints or lower the degree."
        )
    return curve


def learn_compensator(
    source,
    input: Signal | str | None,
    output: Signal | str | None,
    waypoints: Sequence[tuple[float, float]],
    *,
    degree: int | None = None,
    name: str = "compensator",
    **learning,
) -> LearnedBlock:
    """Learn what to command instead, so that ``output`` follows the curve through ``waypoints``.

    Args:
        source, input, output, learning: as `learn_inverse` takes them; the same source, recordings or a model.
        waypoints, degree: see `desired_curve`; commands in the unit of ``input``, rates in SI.

    The block goes before the machine: ``wanted_<input>`` in, ``<input>`` out. ``provenance`` holds the curve and the
    inverse's round trip.

    Raises:
        DataError: a curve that falls, or that asks for more than the machine reaches in either direction.
        SolveError, DeclarationError: see `learn_inverse`.
    """
    curve = desired_curve(waypoints, degree)
    options = {k: learning.pop(k) for k in tuple(learning) if k in characteristic.__kwdefaults__}
    forward = characteristic(source, input, output, **options)
    inverse = learn_inverse(forward, name=f"{name}_inverse", **learning)
    _check_reach(curve, inverse, name)
    structure = {"powers": len(curve.coefficients), "knots": 0, "hidden": 0} | inverse.structure
    arrays = {"coefficients": np.array(curve.coefficients), "full": np.array([curve.full]), **inverse.arrays}
    command = inverse.outputs[0]
    wanted = replace(command, name=f"wanted_{command.name}", description=f"wanted {command.description}".strip())
    block = assemble(
        COMPENSATOR,
        arrays,
        structure,
        name=name,
        inputs=(wanted,),
        outputs=(command,),
        states=(),
        parameters=(),
        period=inverse.period,
        domain=TrainingDomain((wanted.name,), (-curve.full,), (curve.full,)),
        description=f"{command.name} so that {forward.rate.name} follows a polynomial of degree {structure['powers']}",
        provenance={
            **inverse.provenance, "kind": "compensator", "waypoints": [list(map(float, p)) for p in waypoints],
        },
    )  # fmt: skip
    refuse_falling(block, "Learn the inverse again, or take method='table'.")
    return replace(block, certificate=_certify(block, curve, inverse))


def _check_reach(curve: DesiredCurve, inverse: LearnedBlock, name: str) -> None:
    (low,), (high,) = inverse.domain.lower, inverse.domain.upper
    most = float(curve(np.array([curve.full]))[0])
    if not (low <= -most and most <= high):
        unit, within = inverse.inputs[0].unit, max(min(-low, high), 0.0)
        raise DataError(
            f"{name}: the desired curve asks for up to +-{most:.4g} {unit} (the machine reaches {low:.4g} to "
            f"{high:.4g} {unit}). Mirrored it must stay within +-{within:.4g} {unit}. "
            f"Scale the waypoints by {within / most:.3g}."
        )


def _certify(block: LearnedBlock, curve: DesiredCurve, inverse: LearnedBlock) -> Certificate:
    """Largest |deployed - inverse of the curve in numpy| up to a fifth beyond full, relative to the commands' range."""
    grid = np.linspace(-1.2 * curve.full, 1.2 * curve.full, GRID)
    expected = static_answer(inverse, curve(grid))
    difference = float(np.abs(static_answer(block, grid) - expected).max()) / max(float(np.ptp(expected)), 1e-300)
    reference = f"numpy polynomial, inverse with {inverse.certificate.reference}"
    return Certificate(max(difference, inverse.certificate.difference), TOLERANCE, GRID, reference)


def _shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    if set(structure) != {"powers", "knots", "hidden"} or (structure["knots"] > 0) == (structure["hidden"] > 0):
        raise TypeError("powers, and either knots or hidden")
    kept = {name: structure[name] for name in ("knots", "hidden") if structure[name]}
    shapes = table_shapes if structure["knots"] else network_shapes
    return {"coefficients": (structure["powers"],), "full": (1,)} | shapes(kept, inputs, outputs)


def _functions(arrays: Mapping[str, np.ndarray], structure: Mapping[str, int]) -> tuple[ca.Function, ca.Function]:
    s = ca.SX.sym("u")
    size = ca.fmin(ca.fabs(s), float(arrays["full"][0]))
    rate = ca.SX(0)
    for coefficient in arrays["coefficients"][::-1]:
        rate = (rate + float(coefficient)) * size
    expression = EXPRESSIONS[(INVERSE_TABLE if structure["knots"] else INVERSE_NETWORK).name]
    return static_functions(expression(arrays, ca.sign(s) * rate), s)


COMPENSATOR = register_kind(LearnedKind("compensator", 1, _shapes, _functions))
