"""Models whose sensitivities are known on paper, and recordings for them."""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from tests.simulation.small_models import small_model

ISHIGAMI_FIRST = (0.3139, 0.4424, 0.0)  # a = 7, b = 0.1; T. Ishigami and T. Homma, ISUMA 1990
ISHIGAMI_TOTAL = (0.5576, 0.4424, 0.2437)
PI = {name: (-np.pi, np.pi) for name in "abc"}


def ishigami():
    """y = sin a + 7 sin^2 b + 0.1 c^4 sin a, the same at all times; a state that does nothing."""

    def equations(t, x, u, p):
        return -x, ca.sin(p[0]) + 7 * ca.sin(p[1]) ** 2 + 0.1 * p[2] ** 4 * ca.sin(p[0])

    return small_model("ishigami", ["x"], {"a": 1.0, "b": 1.0, "c": 1.0}, equations, outputs=("y",))


def waves():
    """y = b sin(a t): the frequency and the size act together, and no few shapes make the courses."""
    return small_model(
        "waves", ["x"], {"a": 10.0, "b": 1.0}, lambda t, x, u, p: (-x, p[1] * ca.sin(p[0] * t)), outputs=("y",)
    )


def weighted(idle: bool = False):
    """y = a u + b v, z = a u; with ``idle`` a parameter that nothing depends on."""

    def equations(t, x, u, p):
        return -x, ca.vertcat(p[0] * u[0] + p[1] * u[1], p[0] * u[0])

    inputs = tuple(Signal(name, "1", interpolation="linear") for name in "uv")
    parameters = {"a": 1.0, "b": 2.0, **({"idle": 1.0} if idle else {})}
    return small_model("weighted", ["x"], parameters, equations, inputs=inputs, outputs=("y", "z"))


def product():
    """x' = (a b u - x) / tau with x and, by another sensor, a alone: a and b act together on x."""

    def equations(t, x, u, p):
        return (p[0] * p[1] * u[0] - x[0]) / p[2], ca.vertcat(x[0], p[0] * u[0])

    signal = Signal("u", "1", interpolation="hold")
    parameters = {"a": 2.0, "b": 3.0, "tau": 0.2}
    return small_model("product", ["x"], parameters, equations, inputs=(signal,), outputs=("x_seen", "a_seen"))


def exploding():
    """x' = a x^2 from x = 1: infinite at t = 1 / a."""
    return small_model("exploding", ["x"], {"a": 0.4}, lambda t, x, u, p: (p[0] * x[0] ** 2, x), start=[1.0])


def record(name="run", seconds=2.0, period=0.01, **signals) -> Record:
    """A recording of dimensionless signals."""
    time = np.arange(0.0, seconds, period)
    columns = {
        key: np.broadcast_to(np.asarray(of(time) if callable(of) else of, float), time.shape).copy()
        for key, of in signals.items()
    }
    return Record(time=time, signals=columns, units=dict.fromkeys(columns, "1"), name=name)


def steps(time: np.ndarray) -> np.ndarray:
    """A command of steps."""
    return np.sign(np.sin(2 * np.pi * time)) * (1 + (time > 1.0))


def saturating(k: float):
    """y = 1 - exp(-k), the same at all times: the larger k, the less it shows."""

    def equations(t, x, u, p):
        return -x, 1 - ca.exp(-p[0])

    return small_model("saturating", ["x"], {"k": k}, equations, outputs=("y",))


def hollows(k: float):
    """y = 0.02 (k^2 - 1)^2 + 0.01 (k + 1), the same at all times: near 0 at k = 1, and 0 at -1."""

    def equations(t, x, u, p):
        return -x, 0.02 * (p[0] ** 2 - 1) ** 2 + 0.01 * (p[0] + 1)

    return small_model("hollows", ["x"], {"k": k}, equations, outputs=("y",))
