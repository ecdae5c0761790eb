"""FMI 3.0 Co-Simulation: intermediate update and early return, through the C interface and through FMPy."""

from __future__ import annotations

import contextlib
import ctypes as c
import math
import xml.etree.ElementTree as ET

import pytest
from fmpy import extract, read_model_description
from fmpy.simulation import instantiate_fmu

from tests.export.raw import DISCARD, ERROR, OK, UPDATE3
from tests.export.test_description import read

FMI3 = ("fmi", 3)
IMPLICIT, ADAPTIVE = ("method", "implicit"), ("method", "adaptive")
SOLVERS = {"explicit": ("cehA",), "implicit": ("cehA", IMPLICIT), "adaptive": ("cehA", ADAPTIVE)}
STEP, SIZE = 1e-3, 1e-2  # internal, communication
OUTPUTS = ("arm_angle", "pressure_cap", "motor_speed")


class Watched:
    """An instance whose intermediate updates are noted; ``act`` is called in each, its answer asks to return then."""

    def __init__(self, library, act=None, early=True, outputs=OUTPUTS, inputs=("command",)):
        self.seen, self.act, self.outputs = [], act, outputs
        self._update = UPDATE3(self._updated)
        self.instance = library.instance(update=self._update, early=early, required=(*outputs, *inputs))
        self.instance.initialise()

    def _updated(self, owner, time, may_set, may_get, finished, can_return, requested, when):
        values = self.instance.get(*self.outputs) if may_get else None
        self.seen.append({"time": time, "set": may_set, "finished": finished, "early": can_return, "values": values})
        wanted = self.act(self, time) if self.act else None
        if wanted is not None:
            requested[0], when[0] = True, wanted


@pytest.fixture(params=list(SOLVERS))
def library(request, exchangers):
    return exchangers[*SOLVERS[request.param], FMI3]


def stepped(library, count: int, size: float, command: float = 1.0):
    """Outputs after each step of a plain instance."""
    instance, rows = library.instance().initialise(command=command), []
    for k in range(count):
        assert instance.step(k * size, size) == OK
        rows.append(instance.get(*OUTPUTS))
    instance.free()
    return rows


def test_every_internal_step_is_shown_with_its_outputs(library):
    watched = Watched(library, early=False)
    assert watched.instance.set("command", 1.0) == OK
    assert watched.instance.step(0.0, SIZE) == OK
    assert [p["time"] for p in watched.seen] == pytest.approx([STEP * (k + 1) for k in range(10)], rel=1e-12)
    assert all(p["finished"] and p["set"] and not p["early"] for p in watched.seen)
    for shown, expected in zip(watched.seen, stepped(library, 10, STEP), strict=True):
        assert shown["values"] == pytest.approx(expected, rel=1e-9)
    assert watched.instance.get(*OUTPUTS) == watched.seen[-1]["values"]
    assert len({tuple(p["values"]) for p in watched.seen}) == 10


def test_who_only_watches_changes_nothing(exchangers):
    library = exchangers["cehA", FMI3]
    watched, alone = Watched(library), library.instance().initialise()
    for k in range(20):
        for instance in (watched.instance, alone):
            assert instance.set("command", math.sin(0.3 * k)) == OK
            assert instance.step(k * SIZE, SIZE) == OK
        assert watched.instance.get(*OUTPUTS) == alone.get(*OUTPUTS)


def test_a_return_at_once_leaves_the_state_that_was_shown(library):
    watched = Watched(library, lambda w, t: t if len(w.seen) == 4 else None)
    instance = watched.instance
    assert instance.set("command", 1.0) == OK
    status, early, reached = instance.step_until(0.0, SIZE)
    assert (status, early) == (OK, True)
    assert reached == watched.seen[-1]["time"] == pytest.approx(4 * STEP, rel=1e-12)
    assert len(watched.seen) == 4
    assert watched.seen[-1]["early"]
    assert instance.get(*OUTPUTS) == watched.seen[-1]["values"]
    assert instance.step(0.0, SIZE) == ERROR  # time has gone on
    assert instance.step(reached, SIZE - reached) == OK
    assert instance.get(*OUTPUTS) == pytest.approx(stepped(library, 10, STEP)[-1], rel=1e-9)


def test_a_return_later_ends_exactly_there(library):
    wanted = 0.00657
    watched = Watched(library, lambda w, t: wanted)
    assert watched.instance.set("command", 1.0) == OK
    assert watched.instance.step_until(0.0, SIZE) == (OK, True, wanted)
    assert watched.seen[-1]["time"] == wanted
    assert not watched.seen[-1]["early"]  # there is nothing left to be spared
    plain = library.instance().initialise(command=1.0)
    assert plain.step(0.0, 6 * STEP) == OK
    assert plain.step(6 * STEP, wanted - 6 * STEP) == OK
    assert watched.instance.get(*OUTPUTS) == pytest.approx(plain.get(*OUTPUTS), rel=1e-9)


@pytest.mark.parametrize("wanted", [SIZE, 5.0, math.nan, math.inf])
def test_a_return_at_the_end_or_at_no_time_is_none(library, wanted):
    watched = Watched(library, lambda w, t: wanted)
    assert watched.instance.step_until(0.0, SIZE) == (OK, False, SIZE)
    assert len(watched.seen) == 10


def test_a_return_that_was_not_allowed_is_not_offered_and_not_made(library):
    watched = Watched(library, lambda w, t: t, early=False)
    assert watched.instance.step_until(0.0, SIZE) == (OK, False, SIZE)
    assert not any(p["early"] for p in watched.seen)


def test_inputs_moved_inside_a_step_act_from_there_on(library):
    """As if the importer had taken the internal steps itself."""

    def command(t):
        return math.sin(300.0 * t) + 0.2

    def act(w, t):
        assert w.instance.set("command", command(t)) == OK

    watched = Watched(library, act)
    small = library.instance().initialise(command=command(0.0))
    assert watched.instance.set("command", command(0.0)) == OK
    for k in range(30):
        assert small.set("command", command(k * STEP)) == OK
        assert small.step(k * STEP, STEP) == OK
    for k in range(3):
        assert watched.instance.step(k * SIZE, SIZE) == OK
    assert watched.instance.get(*OUTPUTS) == pytest.approx(small.get(*OUTPUTS), rel=1e-8)


def test_an_input_with_a_dead_time_remembers_what_it_was_inside_a_step(exchangers):
    library, outputs = exchangers["delayed mass", FMI3], ("place", "seen_force")

    def act(w, t):
        assert w.instance.set("force", math.sin(40.0 * t)) == OK

    watched = Watched(library, act, outputs=outputs, inputs=("force",))
    small = library.instance().initialise()
    for k in range(10):
        assert watched.instance.step(k * SIZE, SIZE) == OK
    for k in range(100):
        assert small.set("force", math.sin(40.0 * k * STEP)) == OK
        assert small.step(k * STEP, STEP) == OK
    assert abs(watched.instance.get("seen_force")[0] - 0.5) > 0.1
    assert watched.instance.get(*outputs) == pytest.approx(small.get(*outputs), rel=1e-8)


def test_inside_a_step_nothing_else_is_allowed(library):
    statuses = {}

    def act(w, t):
        one, reference = w.instance, w.instance.library.references
        zero, state = c.c_size_t(0), c.c_void_p()
        calls = {
            "a step": lambda: one.step_until(t, SIZE)[0],
            "reset": one.Reset,
            "terminate": one.Terminate,
            "saving": lambda: one.GetFMUState(c.byref(state)),
            "loading": lambda: one.SetFMUState(kept),
            "a parameter set": lambda: one.set("motor.gain", 1.0),
            "a parameter read": lambda: one.status_of_get(reference["motor.gain"]),
            "a state read": lambda: one.status_of_get(reference["arm.angle"]),
            "derivatives": lambda: one.GetDirectionalDerivative(None, zero, None, zero, None, zero, None, zero),
            "adjoints": lambda: one.GetAdjointDerivative(None, zero, None, zero, None, zero, None, zero),
            "initialising": one.EnterInitializationMode,
        }
        statuses.update({name: call() for name, call in calls.items()})
        one.free()  # ignored: the step still needs the instance
        assert one.set("command", math.nan) == DISCARD

    watched = Watched(library, act)
    kept = watched.instance.get_state()
    assert watched.instance.step(0.0, SIZE) == OK
    assert statuses
    assert set(statuses.values()) == {ERROR}, statuses
    assert watched.instance.get(*OUTPUTS) == pytest.approx(stepped(library, 1, SIZE, 0.0)[-1], rel=1e-9)
    assert watched.instance.free_state(kept) == OK
    watched.instance.free()


def test_a_step_that_fails_inside_is_undone_as_a_whole(exchangers):
    """The importer's own input makes the motor overflow after a few internal steps."""

    def act(w, t):
        if len(w.seen) == 3:
            w.instance.set("command", 1e308)

    watched = Watched(exchangers["cehA", FMI3], act)
    before = watched.instance.get(*OUTPUTS)
    status, early, reached = watched.instance.step_until(0.0, SIZE)
    assert (status, early, reached) == (DISCARD, False, 0.0)
    assert watched.instance.get(*OUTPUTS) == before
    watched.act = None
    assert watched.instance.step(0.0, SIZE) == OK


@pytest.mark.parametrize("name", ["lag", "lag in MX"])
def test_a_block_is_shown_at_its_samples_and_returns_there(exchangers, name):
    """Period 20 ms, steps of 100 ms: its outputs are held, so that only its inputs are at hand inside a step."""
    library = exchangers[name, FMI3]

    def act(w, t):
        assert w.instance.status_of_get(library.references["angle"]) == ERROR
        assert w.instance.set("command", 0.3 + t) == OK
        return t if len(w.seen) == 3 and t < 0.1 else None

    watched = Watched(library, act, outputs=())
    instance, plain = watched.instance, library.instance().initialise()
    assert instance.set("command", 0.3) == OK
    assert instance.step_until(0.0, 0.1) == (OK, True, pytest.approx(0.06))
    assert [p["time"] for p in watched.seen] == pytest.approx([0.02, 0.04, 0.06])
    assert not any(p["values"] for p in watched.seen)
    for k in range(3):
        assert plain.set("command", 0.3 + 0.02 * k) == OK
        assert plain.step(0.02 * k, 0.02) == OK
    plain.set("command", 0.36)
    assert instance.get("angle", "rate") == pytest.approx(plain.get("angle", "rate"), rel=1e-12)
    assert instance.step(0.06, 0.14) == OK
    for k in range(3, 10):
        assert plain.set("command", 0.3 + 0.02 * k) == OK
        assert plain.step(0.02 * k, 0.02) == OK
    plain.set("command", 0.5)
    assert instance.get("angle", "rate") == pytest.approx(plain.get("angle", "rate"), rel=1e-12)


def test_what_is_asked_for_must_be_an_intermediate_variable(exchangers):
    update = UPDATE3(lambda *_: None)
    for name, good, bad in (("cehA", "arm_angle", "motor.gain"), ("lag", "command", "angle")):
        library = exchangers[name, FMI3]
        library.dll.fmi3FreeInstance(c.c_void_p(library.instantiate(update=update, required=(good,))))
        assert not library.instantiate(update=update, required=(good, bad))
        assert "intermediateUpdate is false" in library.messages[-1][1]
        assert not library.instantiate(required=(good,))
        assert "callback" in library.messages[-1][1]


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        (("cehA", FMI3), {"command", *OUTPUTS, "rod_position", "pressure_rod", "piston_force"}),
        (("lag", FMI3), {"command"}),
        (("cehA", FMI3, ("kind", "me")), set()),
    ],
)
def test_the_description_tells_what_can_be_accessed(variants, key, expected):
    root = ET.fromstring(read(variants[key]))
    marked = {v.get("name") for v in root.find("ModelVariables") if v.get("intermediateUpdate") == "true"}
    assert marked == expected
    names = ("providesIntermediateUpdate", "canReturnEarlyAfterIntermediateUpdate", "mightReturnEarlyFromDoStep")
    flags = [v.get(name) for v in root.findall("CoSimulation") for name in names]
    assert flags == (["true", "true", None] if expected else [])


def test_fmpy_is_called_in_every_internal_step_and_returns_early(variants, tmp_path):
    description = read_model_description(str(variants["cehA", FMI3]))
    reference = {v.name: v.valueReference for v in description.modelVariables}
    seen = []

    def update(owner, time, may_set, may_get, finished, can_return, requested, when):
        seen.append((time, fmu.getFloat64([reference["motor_speed"]])[0]))
        requested[0], when[0] = can_return and seen[-1][1] > 40.0, time

    fmu = instantiate_fmu(
        extract(str(variants["cehA", FMI3]), str(tmp_path)), description, "CoSimulation", early_return_allowed=True,
        intermediate_update=update, required_intermediate_variables=[reference["motor_speed"]],
    )  # fmt: skip
    fmu.enterInitializationMode(startTime=0.0)
    fmu.exitInitializationMode()
    fmu.setFloat64([reference["command"]], [1.0])
    _, _, early, reached = fmu.doStep(currentCommunicationPoint=0.0, communicationStepSize=0.1)
    assert early
    assert reached == seen[-1][0] == pytest.approx(0.013)  # 120 rad/s (1 - exp(-t / 30 ms)) passes 40 at 12.2 ms
    assert fmu.getFloat64([reference["motor_speed"]]) == [seen[-1][1]]
    with contextlib.suppress(Exception):
        fmu.terminate()
    fmu.freeInstance()
