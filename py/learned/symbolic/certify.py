"""How far the deployed step of a formula is from the formula as SymPy's NumPy printer evaluates it."""

from __future__ import annotations

import numpy as np

from ..block_file import Certificate, LearnedBlock
from ..network.narx import random_steps
from .block import Formula, formula_shape
from .static_block import STATIC

TOLERANCE = 1e-12  # of the outputs' scale, and of values beyond it: deployed against trained


def certify(block: LearnedBlock, formula: Formula, points: int = 20_000) -> Certificate:
    """The largest |deployed - trained| of one step, relative to the outputs' scale.

    Looked at over `random_steps`, and for a static formula all over the training domain.
    """
    import sympy

    static = block.kind == STATIC.name
    deployed, trained = (_static if static else _dynamic)(block, formula, points)
    size = np.maximum(np.abs(trained), block.arrays["output_scale"]) if static else block.arrays["output_scale"]
    difference = np.abs((deployed - trained) / size)
    worst = float(np.max(difference, initial=0.0, where=np.isfinite(trained)))
    return Certificate(worst, TOLERANCE, points, f"sympy {sympy.__version__} float64")


def _dynamic(block: LearnedBlock, formula: Formula, points: int) -> tuple[np.ndarray, np.ndarray]:
    a, shape = block.arrays, formula_shape(block.structure, len(block.inputs), len(block.outputs))
    states, inputs, z = random_steps(a, shape, points)
    deployed = np.array(block.step.map(points)(states.T, inputs.T, np.zeros((0, points)))[0]).T
    f = np.clip(_values(formula, z), -a["increment_limit"], a["increment_limit"]) * a["increment_scale"]
    trained = np.clip(states[:, : shape.outputs] + f, a["output_lower"], a["output_upper"])
    return deployed[:, : shape.outputs], trained


def _static(block: LearnedBlock, formula: Formula, points: int) -> tuple[np.ndarray, np.ndarray]:
    a, box = block.arrays, block.domain
    u = np.random.default_rng(0).uniform(box.lower, box.upper, (points, len(block.inputs)))
    deployed = np.array(block.step.map(points)(np.zeros((0, points)), u.T, np.zeros((0, points)))[1]).T
    trained = a["output_centre"] + a["output_scale"] * _values(formula, (u - a["input_centre"]) / a["input_scale"])
    return deployed, trained


def _values(formula: Formula, z: np.ndarray) -> np.ndarray:
    """Values (points, outputs) of the expressions; not finite where they have none."""
    import sympy

    from .text import as_expressions

    symbols = sympy.symbols(f"z:{z.shape[1]}", real=True)
    functions = [sympy.lambdify(symbols, e, "numpy") for e in as_expressions(formula, symbols)]
    with np.errstate(all="ignore"):
        return np.column_stack([np.broadcast_to(g(*z.T), len(z)) for g in functions])
