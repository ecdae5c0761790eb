"""Small experiments on a Model Exchange FMU, as in `probes`, each a function of an `ExchangeTrial`."""

from __future__ import annotations

import itertools

import numpy as np
from fmpy.fmi1 import FMICallException

from .exchange import SolverFailure
from .exchanger import LATER, SAMPLES, SECONDS, Exchanger, ExchangeTrial, continuous_outputs, moving_inputs
from .master import abilities_of
from .probes import gives_up, not_finite
from .reading import Reader, every_variable
from .start_values import start_values
from .states import number_of_states
from .trial import REPEATS, SHARE, TINY, off, real_inputs, refused, same
from .verdicts import FAIL, PASS, REMARK, NotTried

SEED, POINTS, CALLS = 35, 25, 12  # of calls in any order: where answers are compared, and calls before each
MOST_KNOWNS = 40  # states and inputs moved one by one
SLOPE = 1e-3  # of the largest: difference of a directional derivative to finite differences
SMALL = 1e-6  # of nominal, for differences


def _runs(trial: ExchangeTrial):
    """A second with CVODES at the start values; then with real inputs that move within its steps."""
    inputs = real_inputs(trial.description)
    trial.exchange().close()  # one that gives no instance at all fails
    try:
        still = trial.run(share=0.0)
    except SolverFailure as failure:
        return REMARK, f"CVODES does not get on with it, see the rows below for why: {failure}"
    except (FMICallException, RuntimeError) as failure:
        return gives_up(failure, inputs)
    if not np.isfinite(still).all():
        return not_finite(trial.names, still, inputs)
    done = f"{SECONDS:g} s in {SAMPLES - 1} steps with CVODES, {still.shape[1]} values finite"
    if refusal := refused(lambda: trial.run(SHARE)) if moving_inputs(trial.description) else None:
        return REMARK, f"{done} at the start values of its inputs; moved by a tenth of nominal: {refusal}"
    return PASS, done


def _reading(trial: ExchangeTrial):
    return every_variable(trial.description.modelVariables, _reader(trial))


def _start_values(trial: ExchangeTrial):
    return start_values(trial.description.modelVariables, _reader(trial))


def _reader(trial: ExchangeTrial) -> Reader:
    def computes(instance):
        instance.rates() if instance.count else instance.fmu.setTime(0.0)

    return Reader(trial.exchange, computes)


def _nominals(trial: ExchangeTrial):
    exchanger = trial.exchanger()
    if not exchanger.count:
        raise NotTried("no continuous state")
    values, states = exchanger.nominals(), [u.variable.derivative for u in trial.description.derivatives]
    bad = np.flatnonzero(~(values > 0.0))
    if not len(bad):
        return PASS, f"all {len(values)} are above zero"
    named = len(states) == len(values) and states[bad[0]] is not None
    first = f"'{states[bad[0]].name}'" if named else f"state {bad[0] + 1}"
    told = f"the nominal value of {first} is {values[bad[0]]:g}, where solvers need one above zero"
    return FAIL, f"{told} ({len(bad)} of {len(values)} states)"


def _order_of_states(trial: ExchangeTrial):
    """States and derivatives come in the order in which the derivatives are listed."""
    exchanger, rows = trial.exchanger(), trial.description.derivatives
    if not exchanger.count:
        raise NotTried("no continuous state")
    rates = [u.variable for u in rows]
    if any(v.dimensions or v.derivative is None for v in rates):
        raise NotTried("states that are arrays, or that no variable shows")
    exchanger.move(*trial.points(exchanger)[1])
    for kind, found, names in (
        ("derivatives", exchanger.rates(), [v.name for v in rates]),
        ("states", exchanger.states(), [v.derivative.name for v in rates]),
    ):
        shown = np.array(exchanger.read(names))
        for name, own, other in zip(names, found, shown, strict=True):
            if off(np.array([[own]]), np.array([[other]])) > REPEATS:
                told = f"'{name}' is {other:.6g} as a variable and {own:.6g} where it stands in the list"
                return FAIL, f"{kind} do not come in the order in which they are listed: {told}"
    return PASS, f"{len(rates)} states and derivatives are the variables that are listed"


def _order_of_setting(trial: ExchangeTrial):
    """The answer at a point must not depend on how one came to it, nor on what was asked on the way."""
    exchanger = trial.asked()
    start, other = trial.points(exchanger)
    expected = _reached(exchanger, start, other, ("time", "states", "inputs"), ask=False)
    orders = list(itertools.permutations(("time", "states", "inputs")))
    found = {order: off(_reached(exchanger, start, other, order, ask=True), expected) for order in orders}
    exchanger.close()
    worst = max(found, key=found.__getitem__)
    if found[worst] > REPEATS:
        told = f"setting {', '.join(worst)} with questions between gives another answer (off by {found[worst]:.3g})"
        return FAIL, f"stale: {told}"
    exact = "bit by bit" if not found[worst] else f"to {found[worst]:.1g}"
    return PASS, f"{len(orders)} orders of setting time, states and inputs give one answer, {exact}"


def _reached(exchanger: Exchanger, start: tuple, other: tuple, order: tuple[str, ...], ask: bool) -> np.ndarray:
    exchanger.move(*start)
    exchanger.answers()
    for what in order:
        exchanger.set(what, *other)
        if ask:
            exchanger.answers()
    return exchanger.answers()[None]


def _any_calls(trial: ExchangeTrial):
    """After hundreds of calls in any order, time going back too, the answers are those of a fresh instance.

    Solvers evaluate ahead of a step and come back, and move inputs within it: derivatives and outputs must follow from
    time, states and inputs alone. A fresh instance gets its inputs before the end of initialization, so that an FMU
    that takes inputs at events only is found; not where there are event indicators, whose branches are then others.
    """
    random, worn = np.random.default_rng(SEED), trial.asked()
    smooth = not trial.description.numberOfEventIndicators
    (_, x, u), (_, far_x, far_u) = trial.points(worn)
    middle = {"time": np.array(LATER), "states": x, "inputs": u}
    size = {"time": LATER, "states": far_x - x, "inputs": far_u - u}
    found, expected, points, point = [], [], [], dict(middle)
    for _ in range(POINTS):
        for what in random.choice(("time", "states", "inputs", "ask"), CALLS):
            if what == "ask":
                worn.answers()
                continue
            point[what] = middle[what] + random.uniform(*_sides(what), middle[what].shape) * size[what]
            worn.set(what, float(point["time"]), point["states"], point["inputs"])
        found.append(worn.answers())
        early = {v.name: value for v, value in zip(worn.inputs, point["inputs"], strict=True)} if smooth else {}
        fresh = trial.exchanger(early)
        fresh.move(float(point["time"]), point["states"], point["inputs"])
        expected.append(fresh.answers())
        fresh.close()
        points.append((float(point["time"]), point["states"], point["inputs"]))
    worn.close()
    return _compared(trial, np.array(found), np.array(expected), points)


def _sides(what: str) -> tuple[float, float]:
    """Inputs move to the side that their min and max allow."""
    return (0.0, 1.0) if what == "inputs" else (-1.0, 1.0)


def _compared(trial: ExchangeTrial, found: np.ndarray, expected: np.ndarray, points: list[tuple]):
    """Each answer by its largest size among the points."""
    if not np.isfinite(found).all() or not np.isfinite(expected).all():
        return REMARK, "an answer is not finite somewhere within a tenth of nominal around the start"
    errors = np.abs(found - expected) / np.maximum(np.abs(expected).max(axis=0, initial=0.0), TINY)
    if errors.max(initial=0.0) > REPEATS:
        at, column = np.unravel_index(errors.argmax(), errors.shape)
        if _late_outputs(trial, errors, points[at], expected[[at]]):
            return REMARK, "outputs follow inputs only after completedIntegratorStep: read them after it"
        return FAIL, (
            f"the answer depends on the calls before: at t = {points[at][0]:.3g} s it is off by "
            f"{errors[at, column]:.2g} of its size from that of a fresh instance with the same time, states and inputs"
        )
    return PASS, f"{POINTS} points, reached by {POINTS * CALLS} calls in any order, answer as a fresh instance"


def _late_outputs(trial: ExchangeTrial, errors: np.ndarray, point: tuple, expected: np.ndarray) -> bool:
    """Whether all that is wrong are outputs, wrong after a single move as well, and right once a step is complete.

    No solver is led astray by them, and importers that read outputs of complete steps see what is right.
    """
    exchanger = trial.exchanger()
    if errors[:, : exchanger.count].max(initial=0.0) > REPEATS:
        return False
    exchanger.move(*point)
    before = exchanger.answers()[None]
    exchanger.completed()
    after = exchanger.answers()[None]
    exchanger.close()
    return off(before, expected) > REPEATS >= off(after, expected)


def _reset(trial: ExchangeTrial):
    exchanger = trial.asked()
    if trial.refusal is None:
        exchanger.move(*exchanger.points(SHARE)[1])
    first, other = (_everything(trial.exchanger()) for _ in range(2))
    if off(first, other) > REPEATS:
        raise NotTried("two fresh instances do not repeat each other, so there is nothing to compare with")
    exchanger.answers()
    exchanger.fmu.reset()
    exchanger.initialise(0.0, None, {}, {})
    again = _everything(exchanger)
    exchanger.close()
    return same(first, again, "after reset states, derivatives and outputs are those of the start")


def _everything(exchanger: Exchanger) -> np.ndarray:
    return np.r_[exchanger.states(), exchanger.answers()][None]


def _state(trial: ExchangeTrial):
    """A saved state brings back time, states, inputs and what follows from them, after answers elsewhere."""
    if not trial.description.modelExchange.canGetAndSetFMUstate:
        raise NotTried("the FMU says that it cannot save its state")
    exchanger = trial.asked()
    start, other = trial.points(exchanger)
    exchanger.move(*other)
    first = _everything(exchanger)
    state = exchanger.fmu.getFMUState()
    exchanger.move(*start)
    exchanger.answers()
    exchanger.fmu.setFMUState(state)
    again = _everything(exchanger)
    exchanger.close()
    return same(first, again, f"a state saved at t = {LATER:g} s comes back with derivatives and outputs")


def _dependencies(trial: ExchangeTrial):
    """A derivative or output that does not list a state or an input must not answer to it."""
    smooth = {v.name for v in continuous_outputs(trial.description)}
    outputs = [u for u in trial.description.outputs if u.variable.name in smooth]
    declared, names = [*trial.description.derivatives, *outputs], [u.variable.name for u in outputs]
    if not declared or all(u.dependencies is None for u in declared):
        raise NotTried("no dependencies are declared, an importer must assume all")
    exchanger = trial.asked()
    knowns = _knowns(trial, exchanger)[:MOST_KNOWNS]
    (_, x, u), (_, far_x, far_u) = trial.points(exchanger)
    expected, far, wrong, itself = _at(exchanger, np.r_[x, u], names), np.r_[far_x, far_u], [], []
    for column, known in knowns:
        moved = np.r_[x, u]
        moved[column] = far[column]
        found = _at(exchanger, moved, names)
        for row in np.flatnonzero(np.abs(found - expected) > REPEATS * np.maximum(np.abs(expected), TINY)):
            unknown = declared[row]
            if unknown.dependencies is not None and known not in unknown.dependencies:
                own = unknown.variable.valueReference == known.valueReference
                (itself if own else wrong).append(f"{unknown.variable.name} on {known.name}")
    exchanger.close()
    if wrong:
        return FAIL, f"not declared, yet seen: {', '.join(wrong)}"
    if itself:
        told = f"outputs that are states do not list themselves: {', '.join(itself)}"
        return REMARK, f"{told}; who takes the sparsity from the list gets zeros there"
    return PASS, f"{len(knowns)} states and inputs moved, all that answers to them is declared"


def _at(exchanger: Exchanger, point: np.ndarray, names: list[str]) -> np.ndarray:
    """Derivatives, then these outputs, with states and inputs at ``point``."""
    exchanger.move(LATER, point[: exchanger.count], point[exchanger.count :])
    return np.r_[exchanger.rates(), exchanger.read(names)]


def _knowns(trial: ExchangeTrial, exchanger: Exchanger):
    """Column in (states, inputs) and variable. NotTried where states are not shown one by one."""
    states = [u.variable.derivative for u in trial.description.derivatives]
    if len(states) != exchanger.count or any(s is None for s in states):
        raise NotTried("states that are arrays, or that no variable shows")
    return list(enumerate([*states, *exchanger.inputs]))


def _directional(trial: ExchangeTrial):
    """Derivatives and outputs by states and inputs against central differences, away from the start."""
    declared = abilities_of(trial.unzipped, "ModelExchange")
    if not declared & {"providesDirectionalDerivative", "providesDirectionalDerivatives"}:
        raise NotTried("not offered")
    exchanger = trial.asked()
    time, x, u = trial.points(exchanger)[1]
    knowns = _knowns(trial, exchanger)[:MOST_KNOWNS]
    rates = [row.variable.valueReference for row in trial.description.derivatives]
    unknowns = [*rates, *(exchanger.variables[n].valueReference for n in exchanger.outputs)]
    names = [*(row.variable.name for row in trial.description.derivatives), *exchanger.outputs]
    worst, where = 0.0, ""
    for column, known in knowns:
        error, row = _slope_error(exchanger, (time, x, u), column, known, unknowns)
        if not error <= worst:
            worst, where = error, f" (of {names[row]} to {known.name})"
    exchanger.close()
    detail = f"largest difference to finite differences {worst:.2g}{where}, at t = {time:g} s"
    return PASS if worst < SLOPE else FAIL, detail


def _slope_error(exchanger: Exchanger, point: tuple, column: int, known, unknowns) -> tuple[float, int]:
    """How far one column of directional derivatives is off, relative to its largest, and in which row."""
    time, x, u = point
    h, sides = SMALL * abs(float(known.nominal or 1.0)), []
    for sign in (1.0, -1.0):
        moved = np.r_[x, u]
        moved[column] += sign * h
        exchanger.move(time, moved[: len(x)], moved[len(x) :])
        sides.append(exchanger.answers())
    exchanger.move(time, x, u)
    exact = np.array(exchanger.fmu.getDirectionalDerivative(unknowns, [known.valueReference], [1.0]))
    rounding = 1e-10 * np.abs(sides[0]) / h
    scale = np.maximum(np.abs(exact), SLOPE * np.abs(exact).max(initial=0.0)) + rounding + 1e-300
    errors = np.abs((sides[0] - sides[1]) / (2 * h) - exact) / scale
    return float(errors.max(initial=0.0)), int(errors.argmax()) if errors.size else 0


def _nan_input(trial: ExchangeTrial):
    """NaN at an input, or at a state where there is no input."""
    exchanger = trial.asked()
    time, x, u = exchanger.points(SHARE)[0]
    what, name = ("inputs", exchanger.inputs[0].name) if exchanger.inputs else ("states", "the first state")
    if not len(u) and not len(x):
        raise NotTried("no real input and no state")
    (u if len(u) else x)[0] = np.nan
    try:
        exchanger.set(what, time, x, u)
        found = exchanger.answers()
    except FMICallException as refusal:
        return PASS, f"NaN at '{name}' is refused (status {refusal.status})"
    exchanger.close()
    if np.isfinite(found).all():
        return REMARK, f"NaN at '{name}' is taken without a word, derivatives and outputs stay finite"
    return REMARK, f"NaN at '{name}' is taken as a value and reaches derivatives or outputs"


EXCHANGE_PROBES = {
    "runs": _runs,
    "reading": _reading,
    "start values": _start_values,
    "number of states": number_of_states,
    "nominal values": _nominals,
    "order of states": _order_of_states,
    "order of setting": _order_of_setting,
    "any order of calls": _any_calls,
    "reset": _reset,
    "state": _state,
    "dependencies": _dependencies,
    "directional derivatives": _directional,
    "NaN input": _nan_input,
}
