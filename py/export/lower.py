"""From a FlatModel or a Block to the functions, sizes and default values that the C runtime needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from graphlib import CycleError, TopologicalSorter

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.flat import FlatModel, ParameterValue, Signal, StateVariable
from hydrotwin.simulation.block import INSIDE_TRAINING, ON_THE_EDGE, TRAINING_DISTANCE, Block, TrainingDomain

UNSET, LIMIT = 1e308, 1e307  # what stands for "nobody has set it", and below what everything else lies


@dataclass(frozen=True)
class StartParameter:
    """A fixed parameter that sets an initial value.

    output : the output whose first sample a run takes it from. measured : the one that measures it, taken where every
        state is set at once.
    follows : until somebody sets it, the state follows from the other starts, the inputs and the parameters.
    written_in : the unit in which the state is declared; "" for SI.
    """

    name: str
    unit: str
    value: float
    description: str
    nominal: float = 1.0
    bounds: tuple[float, float] = (-np.inf, np.inf)
    output: str | None = None
    measured: str | None = None
    follows: bool = False
    written_in: str = ""


@dataclass(frozen=True, eq=False)
class Lowered:
    """A system ready to be written as C.

    method : "explicit" (Runge-Kutta, fixed step), "implicit" (Rosenbrock, fixed step), "adaptive" (Rosenbrock) or
        "sampled" (held between samples).
    step : longest internal step or sample period [s].
    functions : the generated functions by role: start, start_forward, output, present, forward, derivative, advance.
    """

    name: str
    method: str
    step: float
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    states: tuple[StateVariable, ...]
    parameters: tuple[ParameterValue, ...]
    starts: tuple[StartParameter, ...]
    functions: dict[str, ca.Function]
    description: str = ""
    provenance: dict = field(default_factory=dict)

    @property
    def sampled(self) -> bool:
        """Whether the system only moves at its sample times."""
        return self.method == "sampled"

    @property
    def unset(self) -> np.ndarray:
        """What the ``start`` function gets for the start parameters that nobody has set."""
        return np.array([UNSET if s.follows else s.value for s in self.starts])

    @property
    def restarts(self) -> bool:
        """Whether the start parameters determine the whole state: one for each, and no input with a memory."""
        named = {s.name.removesuffix(".start") for s in self.starts}
        return not self.sampled and named == {s.name for s in self.states} and max(self.dead_times, default=-1) < 0

    @property
    def dead_times(self) -> tuple[int, ...]:
        """Per input the place of the parameter that delays it, or -1."""
        names = [p.name for p in self.parameters]
        return tuple(names.index(s.dead_time) if s.dead_time else -1 for s in self.inputs)

    @property
    def defaults(self) -> np.ndarray:
        """Start values of inputs, parameters and start parameters, in this order."""
        return np.array(
            [s.default for s in self.inputs] + [p.value for p in self.parameters] + [s.value for s in self.starts]
        )


def lower_model(
    flat: FlatModel, given: Sequence[str] | None, method: str, step: float, tolerance: float, name: str
) -> Lowered:
    """A continuous model with a ``<state>.start`` parameter for every state.

    Those in ``given`` are known to the equations of the start; the others follow from them unless they are set.
    ``given=None`` takes the states that have an output measuring a position or an angle (unit m or rad): where a
    recording begins is what differs from one to the next, the rest follows from equilibrium.
    """
    known = _given_states(flat, given)
    starts = _state_starts(flat, known)
    start = _with_own_starts(flat, known)
    functions = {
        "start": _named("ht_start", start),
        "start_forward": _tangent("ht_start_forward", start, ["x"]),
        "output": _named("ht_output", flat.ode),
        "present": _outputs(flat.ode),
        "forward": _tangent("ht_forward", flat.ode, ["xdot", "y"]),
        "derivative": _rate(flat.ode),
    }
    if method in ("implicit", "adaptive"):
        functions["advance"] = implicit_advance(flat) if method == "implicit" else adaptive_advance(flat, tolerance)
    return Lowered(
        name, method, step, flat.inputs, flat.outputs, flat.states, flat.parameters, starts, functions,
        flat.description, dict(getattr(flat, "provenance", None) or {}),
    )  # fmt: skip


def lower_block(block: Block, name: str) -> Lowered:
    """A sampled block; its ``start`` function reads ``<output>.start`` where it depends on measured outputs.

    Their defaults are the middle of the training data, where the block knows it: elsewhere it would start with a guess.
    """
    step, outputs = block.step, block.outputs
    if block.domain is not None:
        step, outputs = _with_training_distance(block)
    start = _start_of_block(block)
    starts = tuple(
        StartParameter(
            f"{s.name}.start",
            s.unit,
            middle_of_training(block, s.name, s.default),
            f"{s.name} at the start",
            s.nominal,
            output=s.name,
            written_in=s.written_in,
        )
        for s in _start_outputs(block)
    )
    functions = {
        "start": _named("ht_start", start),
        "start_forward": _tangent("ht_start_forward", start, ["x"]),
        "advance": _named("ht_advance", step),
        "output": _sampled_output(step),
        "forward": _tangent("ht_forward", _sampled_output(step), ["y"], lead=["xdot"]),
    }
    return Lowered(
        name, "sampled", block.period, block.inputs, outputs, block.states, block.parameters, starts, functions,
        block.description, dict(block.provenance),
    )  # fmt: skip


def with_adjoints(lowered: Lowered) -> Lowered:
    """The same with the reverse derivatives of its functions, for adjoint derivatives (FMI 3)."""
    output = lowered.functions["output"]
    functions = {
        "start_reverse": _reverse("ht_start_reverse", lowered.functions["start"]),
        "reverse": _reverse("ht_reverse", output, lead=["xdot"] if lowered.sampled else []),
    }
    return replace(lowered, functions={**lowered.functions, **functions})


def adaptive_advance(flat: FlatModel, tolerance: float) -> ca.Function:
    """``(t, h, x, u, p) -> x`` after h by CasADi's Rosenbrock method of order 5(4), inputs constant, steps adaptive."""
    return _rosenbrock(flat, {"reltol": tolerance, "abstol": tolerance})


def implicit_advance(flat: FlatModel) -> ca.Function:
    """The same in one step: one Jacobian, one factorization, eight stages, whatever the state: a bounded cost."""
    return _rosenbrock(flat, {"step_size": 1.0})


def _rosenbrock(flat: FlatModel, options: dict) -> ca.Function:
    """The unit interval is integrated with ``dz/dtau = h f(t + tau h, N z, u, p) / N``.

    So one compiled function serves every step size, and the nominal values N make tolerances the same for Pa and rad.
    """
    n = [np.array([abs(s.nominal) or 1.0 for s in flat.states])]
    sizes = [len(flat.states), len(flat.inputs), len(flat.parameters)]
    sym = _symbols_for(flat.ode)
    tau, z, q = sym.sym("tau"), sym.sym("z", sizes[0]), sym.sym("q", 2 + sizes[1] + sizes[2])
    t, h, u, p = ca.vertsplit(q, [0, 1, 2, 2 + sizes[1], q.shape[0]])
    rate = h * flat.ode(t + tau * h, z * n[0], u, p)[0] / n[0]
    solver = ca.integrator("rosenbrock", "rosenbrock", {"x": z, "p": q, "t": tau, "ode": rate}, 0, 1, options)
    t, h = ca.MX.sym("t"), ca.MX.sym("h")
    x, u, p = ca.MX.sym("x", sizes[0]), ca.MX.sym("u", sizes[1]), ca.MX.sym("p", sizes[2])
    after = solver(x0=x / n[0], p=ca.vertcat(t, h, u, p))["xf"] * n[0]
    return ca.Function("ht_advance", [t, h, x, u, p], [after], ["t", "h", "x", "u", "p"], ["x_next"])


def _given_states(flat: FlatModel, given: Sequence[str] | None) -> list[str]:
    if given is None:
        return [s.name for s in flat.states if s.measured_by and s.unit in ("m", "rad")]
    known = [s.name for s in flat.states]
    for name in given:
        if name not in known:
            raise DeclarationError(f"{flat.name}: no state '{name}' to give a start. {nearest(name, known)}")
    return list(given)


def _state_starts(flat: FlatModel, given: list[str]) -> tuple[StartParameter, ...]:
    u0 = [s.default for s in flat.inputs]
    x0 = np.array(flat.start_given(())(u0, flat.parameter_vector(), [])).ravel()
    position = {s.name: k for k, s in enumerate(flat.states)}

    def parameter(name: str) -> StartParameter:
        s, follows = flat.states[position[name]], name not in given
        text = f"start of: {s.description or s.name}{'; follows from the others unless set' if follows else ''}"
        return StartParameter(
            f"{s.name}.start", s.unit, float(x0[position[name]]), text, s.nominal, s.bounds,
            None if follows else s.measured_by, s.measured_by, follows, s.written_in,
        )  # fmt: skip

    return tuple(parameter(name) for name in (*given, *(n for n in position if n not in given)))


def _with_own_starts(flat: FlatModel, given: list[str]) -> ca.Function:
    """``(u, p, z) -> x`` with ``z`` the given states, then the others, each its value or `UNSET`.

    A state that is not set follows from those that are, as in ``start_given`` with just these.
    """
    names = [s.name for s in flat.states]
    others = [n for n in names if n not in given]
    start = flat.start_given(given)
    sizes = (len(flat.inputs), len(flat.parameters), len(names))
    u, p, z = (_symbols_for(start).sym(n, size) for n, size in zip("upz", sizes, strict=True))
    found = {n: z[k] for k, n in enumerate(given)}
    together = dict(zip(names, ca.vertsplit(ca.densify(start(u, p, z[: len(given)]))), strict=True)) if names else {}
    for name, alone in _one_after_the_other(flat, given, others):
        rest = [found.get(n, 0.0) for n in (*given, *others) if n != name]
        follows = alone(u, p, ca.vertcat(*rest))[names.index(name)] if alone else together[name]
        own = z[len(given) + others.index(name)]
        found[name] = ca.if_else(ca.fabs(own) < LIMIT, own, follows)
    x = ca.densify(ca.vertcat(*(found[n] for n in names)))
    return ca.Function("start", [u, p, z], [x], ["u", "p", "z"], ["x"])


def _one_after_the_other(flat: FlatModel, given: list[str], others: list[str]):
    """The other states, each after those that it follows from, with its start from all the rest.

    Without that function where states follow from each other in a circle: they are known together only.
    """
    alone = {n: flat.start_given([*given, *(m for m in others if m != n)]) for n in others}
    needs = {}
    for name, start in alone.items():
        rest = [n for n in (*given, *others) if n != name]
        row, column = start.jac_sparsity(0, 2).get_triplet() if rest else ([], [])
        place = [s.name for s in flat.states].index(name)
        needs[name] = {rest[j] for i, j in zip(row, column, strict=True) if i == place} - set(given)
    try:
        return [(name, alone[name]) for name in TopologicalSorter(needs).static_order()]
    except CycleError:
        return [(name, None) for name in others]


def middle_of_training(system, name: str, otherwise: float) -> float:
    """The middle of what a block saw of an input or output in training, where it knows."""
    domain = getattr(system, "domain", None)
    if domain is None or name not in domain.names:
        return otherwise
    k = domain.names.index(name)
    return 0.5 * (domain.lower[k] + domain.upper[k])


def _start_outputs(block: Block) -> list[Signal]:
    """The outputs whose measured start the block's ``start`` function uses."""
    if not block.states or not block.outputs:
        return []
    used = set(block.start.jac_sparsity(0, 1).get_triplet()[1])
    return [s for k, s in enumerate(block.outputs) if k in used]


def _start_of_block(block: Block) -> ca.Function:
    """``(u, y, p) -> x`` as ``(u, p, z) -> x`` with z the used outputs alone."""
    sym = _symbols_for(block.start)
    used = _start_outputs(block)
    u, p, z = (sym.sym(c, n) for c, n in zip("upz", (len(block.inputs), len(block.parameters), len(used)), strict=True))
    y = ca.vertcat(*(z[used.index(s)] if s in used else 0.0 for s in block.outputs))
    return ca.Function("start", [u, p, z], [sym(ca.densify(block.start(u, y, p)))], ["u", "p", "z"], ["x"])


def _with_training_distance(block: Block) -> tuple[ca.Function, tuple[Signal, ...]]:
    """The step with two more outputs: how far the block is outside the box of its training data, and whether it is."""
    x, u, p = _arguments(block.step)
    after, y = block.step(x, u, p)
    distance = _distance_from(block.domain, [s.name for s in block.inputs], [s.name for s in block.outputs], u, y)
    inside = ca.if_else(distance <= ON_THE_EDGE, 1.0, 0.0)
    step = ca.Function("step", [x, u, p], [after, ca.vertcat(y, distance, inside)], ["x", "u", "p"], ["x_next", "y"])
    far = Signal(TRAINING_DISTANCE, "1", "distance outside the box of the training data, in box widths; 0 inside")
    return step, (*block.outputs, far, Signal(INSIDE_TRAINING, "1", "1 inside the box of the training data, else 0"))


def _distance_from(domain: TrainingDomain, inputs: list[str], outputs: list[str], u, y):
    distance = 0.0
    for name, low, high in zip(domain.names, domain.lower, domain.upper, strict=True):
        if name not in inputs and name not in outputs:
            raise DeclarationError(
                f"training domain: '{name}' is neither an input nor an output of the block. "
                f"{nearest(name, [*inputs, *outputs])}"
            )
        value = u[inputs.index(name)] if name in inputs else y[outputs.index(name)]
        width = high - low if high > low else 1.0
        distance = ca.fmax(distance, ca.fmax(low - value, value - high) / width)
    return distance


def _sampled_output(step: ca.Function) -> ca.Function:
    x, u, p = _arguments(step)
    t = type(x).sym("t")
    return ca.Function("ht_output", [t, x, u, p], [step(x, u, p)[1]], ["t", "x", "u", "p"], ["y"])


def _outputs(ode: ca.Function) -> ca.Function:
    arguments = _arguments(ode)
    y = ca.densify(ode(*arguments)[1])
    return ca.Function("ht_present", arguments, [y], ["t", "x", "u", "p"], ["y"])


def _rate(ode: ca.Function) -> ca.Function:
    arguments = _arguments(ode)
    rate = ca.densify(ode(*arguments)[0])
    return ca.Function("ht_derivative", arguments, [rate], ["t", "x", "u", "p"], ["xdot"])


def _named(name: str, f: ca.Function) -> ca.Function:
    """The same function under the name it has in C, with dense results."""
    arguments = _arguments(f)
    results = [ca.densify(r) for r in f.call(arguments)]
    return ca.Function(name, arguments, results, f.name_in(), f.name_out())


def _tangent(name: str, f: ca.Function, results: list[str], lead: Sequence[str] = ()) -> ca.Function:
    """``(args, seeds of the args) -> tangents``; ``lead`` names empty results that go first."""
    arguments = _arguments(f)
    sym = _symbols_for(f)
    known = [f"d{n}" for n in f.name_in()]
    seeds = [sym.sym(n, a.shape) for n, a in zip(known, arguments, strict=True)]
    tangents = f.forward(1).call([*arguments, *f.call(arguments), *seeds])
    wanted = [ca.densify(tangents[f.name_out().index(r)]) for r in results]
    empty = [sym(0, 1) for _ in lead]
    return ca.Function(
        name, [*arguments, *seeds], [*empty, *wanted],
        [*f.name_in(), *known], [*(f"d{r}" for r in lead), *(f"d{r}" for r in results)],
    )  # fmt: skip


def _reverse(name: str, f: ca.Function, lead: Sequence[str] = ()) -> ca.Function:
    """``(args, seeds of the results) -> adjoints of the args``; ``lead`` names empty seeds that go first."""
    arguments = _arguments(f)
    sym = _symbols_for(f)
    known = [f"bar_{n}" for n in (*lead, *f.name_out())]
    seeds = [sym.sym(known[len(lead) + k], *f.size_out(k)) for k in range(f.n_out())]
    adjoints = f.reverse(1).call([*arguments, *f.call(arguments), *seeds])
    return ca.Function(
        name, [*arguments, *(sym.sym(n, 0, 1) for n in known[: len(lead)]), *seeds], [ca.densify(a) for a in adjoints],
        [*f.name_in(), *known], [f"bar_{n}" for n in f.name_in()],
    )  # fmt: skip


def _symbols_for(f: ca.Function):
    return ca.SX if f.is_a("SXFunction") else ca.MX


def _arguments(f: ca.Function) -> list:
    sym = _symbols_for(f)
    return [sym.sym(n, *f.size_in(k)) for k, n in enumerate(f.name_in())]
