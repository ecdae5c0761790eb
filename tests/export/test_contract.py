"""What every exported FMU must do, called through its C interface."""

from __future__ import annotations

import ctypes as c
import importlib.util
import math
import re
import resource
import subprocess
import threading
from pathlib import Path

import pytest

from tests.export.raw import DISCARD, ERROR, OK

SIZE, STEPS = 0.01, 25


def run(instance, outputs, first=0, steps=STEPS, feed=True):
    """Outputs after each step under a moving input; the instance is initialised."""
    rows = []
    for k in range(first, first + steps):
        for n, name in enumerate(instance.library.names("input") if feed else ()):
            assert instance.set(name, 0.5 * math.sin(0.3 * (k + n))) == OK
        assert instance.step(k * SIZE, SIZE) == OK, instance.library.messages
        rows.append(instance.get(*outputs))
    return rows


@pytest.fixture
def outputs(library):
    return library.names("output")


@pytest.fixture
def instance(library):
    made = library.instance()
    yield made
    made.free()


def test_exactly_the_functions_of_the_interface_are_exported(library):
    listed = subprocess.run(["nm", "-D", "--defined-only", library.path], capture_output=True, text=True, check=True)
    names = {line.split()[-1] for line in listed.stdout.splitlines()}
    assert names == (of_fmi2() if library.fmi == 2 else of_fmi3())


def of_fmi2() -> set[str]:
    """The functions that an FMU for Co-Simulation alone needs."""
    common = "GetTypesPlatform GetVersion SetDebugLogging Instantiate FreeInstance SetupExperiment Terminate Reset"
    phases = "EnterInitializationMode ExitInitializationMode GetDirectionalDerivative"
    values = " ".join(f"{w}{t}" for w in ("Get", "Set") for t in ("Real", "Integer", "Boolean", "String"))
    states = "GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate"
    steps = "SetRealInputDerivatives GetRealOutputDerivatives DoStep CancelStep GetStatus GetRealStatus"
    more = "GetIntegerStatus GetBooleanStatus GetStringStatus"
    return {f"fmi2{n}" for n in " ".join((common, phases, values, states, steps, more)).split()}


def of_fmi3() -> set[str]:
    """All that the header of the standard declares, whatever the kind: importers ask for every one."""
    folder = Path(importlib.util.find_spec("fmpy").submodule_search_locations[0])
    return set(re.findall(r"fmi3FullName\((fmi3\w+)\)", (folder / "c-code" / "fmi3Functions.h").read_text()))


def test_a_wrong_guid_an_empty_name_and_model_exchange_are_refused(library):
    assert not library.instantiate(guid="{wrong}")
    assert ("GUID" if library.fmi == 2 else "token") in library.messages[-1][1]
    assert not library.instantiate(name=b"")
    assert not library.instantiate(kind=0)


def test_the_name_is_copied(library):
    name = c.create_string_buffer(b"mine")
    instance = library.instance(name=name)
    name.raw = b"XXXX\0"
    assert instance.step(0.0, SIZE) == ERROR
    instance.free()


def test_calls_out_of_their_phase_are_errors(library, instance):
    reference = library.references[library.names("output")[0]]
    assert instance.status_of_get(reference) == ERROR
    assert instance.step(0.0, SIZE) == ERROR
    assert instance.ExitInitializationMode() == ERROR
    assert instance.Terminate() == ERROR
    instance.initialise()
    assert library.fmi == 3 or instance.setup() == ERROR
    assert instance.EnterInitializationMode() == ERROR
    assert instance.step(0.0, SIZE) == OK
    assert instance.Terminate() == OK
    assert instance.step(SIZE, SIZE) == ERROR
    assert instance.status_of_get(reference) == OK


def test_outputs_and_states_cannot_be_set(library, instance):
    instance.initialise()
    for name in library.names("output") + library.names("local"):
        assert instance.set(name, 1.0) == ERROR


def test_an_unknown_value_reference_is_an_error(library, instance):
    instance.initialise()
    for reference in (len(library.variables), 10**6, 2**32 - 1):
        assert instance.status_of_get(reference) == ERROR
        assert instance.set_reference(reference, 1.0) == ERROR


def test_there_are_only_real_variables(instance):
    instance.initialise()
    if instance.library.fmi == 3:
        for kind in ("Int32", "Float32", "Boolean", "String"):
            get, one = getattr(instance, f"Get{kind}"), c.c_size_t(1)
            assert get(c.byref(c.c_uint(0)), one, c.byref(c.c_double()), one) == ERROR
            assert get(None, c.c_size_t(0), None, c.c_size_t(0)) == OK
        return
    assert instance.GetInteger(c.byref(c.c_uint(0)), c.c_size_t(1), c.byref(c.c_int())) == ERROR
    assert instance.GetInteger(None, c.c_size_t(0), None) == OK


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_an_input_that_is_no_number_is_discarded_and_leaves_no_trace(library, instance, outputs, value):
    instance.initialise()
    first = run(instance, outputs)
    instance.Reset()
    instance.initialise()
    again = []
    for k in range(STEPS):
        for name in library.names("input"):
            assert instance.set(name, value) == DISCARD
        again += run(instance, outputs, k, 1)
    assert again == first


def test_reset_equals_a_fresh_instance_bit_by_bit(instance, outputs):
    instance.initialise()
    first = run(instance, outputs, steps=5)
    for _ in range(100):
        assert instance.Reset() == OK
        instance.initialise()
        assert run(instance, outputs, steps=5) == first


def test_reset_forgets_changed_parameters(library, instance, outputs):
    instance.initialise()
    first = run(instance, outputs)
    for name in library.names("parameter"):
        if library.variables[name].get("variability") == "tunable":
            assert instance.set(name, 0.5 * instance.get(name)[0]) == OK
    instance.Reset()
    instance.initialise()
    assert run(instance, outputs) == first


def test_interleaved_instances_equal_one_alone(library, outputs):
    alone, one, other = (library.instance().initialise() for _ in range(3))
    expected = run(alone, outputs)
    for k in range(STEPS):
        assert run(one, outputs, k, 1) == run(other, outputs, k, 1) == [expected[k]]
    for instance in (alone, one, other):
        instance.free()


def test_threads_equal_one_run(library, outputs):
    alone = library.instance().initialise()
    expected, found = run(alone, outputs), []
    instances = [library.instance().initialise() for _ in range(4)]
    threads = [threading.Thread(target=lambda i=i: found.append(run(i, outputs))) for i in instances]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [expected] * 4


def test_a_saved_state_goes_on_bit_by_bit_even_in_another_instance(library, instance, outputs):
    instance.initialise()
    run(instance, outputs, steps=7)
    stored = instance.serialized()
    first = run(instance, outputs, 7, 10)
    assert instance.restore(stored) == OK
    assert run(instance, outputs, 7, 10) == first
    fresh = library.instance()
    assert fresh.restore(stored) == OK
    assert run(fresh, outputs, 7, 10) == first
    fresh.free()


def test_a_state_of_another_fmu_is_refused(instance):
    instance.initialise()
    stored = instance.serialized()
    assert instance.restore(b"{x" + stored[2:]) == ERROR
    assert instance.restore(stored[:-8]) == ERROR


@pytest.mark.parametrize("size", [0.0, -0.01, math.nan, math.inf])
def test_a_step_of_impossible_size_is_an_error(instance, outputs, size):
    instance.initialise()
    before = instance.get(*outputs)
    assert instance.step(0.0, size) == ERROR
    assert instance.get(*outputs) == before


def test_a_step_from_another_time_or_past_the_stop_time_is_an_error(instance):
    instance.initialise(stop=3 * SIZE)
    assert instance.step(0.5, SIZE) == ERROR
    assert [instance.step(k * SIZE, SIZE) for k in range(3)] == [OK, OK, OK]
    assert instance.step(3 * SIZE, SIZE) == ERROR


def test_a_huge_step_ends(instance, outputs):
    instance.initialise()
    assert instance.step(0.0, 1e12) in (OK, DISCARD)
    assert all(math.isfinite(v) for v in instance.get(*outputs))


def test_two_half_steps_equal_a_whole_one(library, instance, outputs):
    instance.initialise()
    for k in range(50):
        assert instance.step(k * 0.02, 0.02) == OK
    halves = library.instance().initialise()
    for k in range(100):
        assert halves.step(k * 0.01, 0.01) == OK
    assert instance.get(*outputs) == pytest.approx(halves.get(*outputs), rel=1e-6, abs=1e-9)
    halves.free()


def test_another_start_time_changes_nothing_but_the_clock(library, instance):
    outputs = [n for n in library.names("output") if n != "clock"]
    instance.initialise()
    shifted = library.instance().initialise(start=100.0)
    for k in range(STEPS):
        assert instance.step(k * SIZE, SIZE) == shifted.step(100.0 + k * SIZE, SIZE) == OK
    assert instance.get(*outputs) == pytest.approx(shifted.get(*outputs), rel=1e-9, abs=1e-12)
    shifted.free()


def test_every_tunable_parameter_can_be_set_while_running(library, instance):
    instance.initialise()
    for name in library.names("parameter"):
        tunable = library.variables[name].get("variability") == "tunable"
        assert instance.set(name, instance.get(name)[0]) == (OK if tunable else ERROR)


def test_without_a_logger_errors_are_silent(library):
    instance = library.instance(logger=False)
    assert instance.step(0.0, SIZE) == ERROR
    instance.free()


def test_ten_thousand_lives_leave_no_memory_behind(library, outputs):
    def live(times):
        for _ in range(times):
            instance = library.instance()
            instance.initialise()
            instance.free_state(instance.get_state())
            instance.free()

    live(500)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    live(10_000)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2000  # kB


def test_directional_derivatives_at_work_equal_finite_differences(library, instance, outputs):
    instance.initialise()
    run(instance, outputs, steps=3)
    for output in outputs:
        for name in library.knowns("Output", output):
            if library.variables[name].get("causality") != "input":
                continue
            h, [value] = 1e-4, instance.get(name)
            instance.set(name, value + h)
            [above] = instance.get(output)
            instance.set(name, value - h)
            [below] = instance.get(output)
            instance.set(name, value)
            assert instance.directional(output, name) == pytest.approx((above - below) / (2 * h), rel=1e-5, abs=1e-6)


def test_directional_derivatives_at_the_start_equal_finite_differences(library, instance, outputs):
    assert instance.setup() == OK
    assert instance.EnterInitializationMode() == OK
    for output in outputs:
        for name in library.knowns("InitialUnknown", output):
            if name == "time":
                continue
            [value] = instance.get(name)
            h = 1e-6 * (abs(value) or 1.0)
            instance.set(name, value + h)
            [above] = instance.get(output)
            instance.set(name, value - h)
            [below] = instance.get(output)
            instance.set(name, value)
            scale = max(abs(above), 1e-3) / (abs(value) or 1.0)
            expected = (above - below) / (2 * h)
            assert instance.directional(output, name) == pytest.approx(expected, rel=1e-4, abs=1e-5 * scale)


def test_what_is_not_declared_as_a_dependency_changes_nothing(library, instance, outputs):
    """At the start: inputs, parameters and start parameters one by one against the list of InitialUnknowns."""
    assert instance.setup() == OK
    assert instance.EnterInitializationMode() == OK
    before = dict(zip(outputs, instance.get(*outputs), strict=True))
    for name in library.names("input") + library.names("parameter"):
        [value] = instance.get(name)
        instance.set(name, value * 1.01 + 0.01)
        for output, after in zip(outputs, instance.get(*outputs), strict=True):
            if after != before[output]:
                assert name in library.knowns("InitialUnknown", output)
        instance.set(name, value)


def test_adjoint_derivatives_are_the_transposed_of_the_directional_ones(library3):
    """At work and at the start, for every output, input, parameter and start parameter: entry by entry."""
    library, instance, outputs = library3, library3.instance(), library3.names("output")
    assert instance.setup(0.7) == OK
    assert instance.EnterInitializationMode() == OK
    for phase in ("start", "work"):
        knowns = library.names("input") + library.names("parameter")
        if phase == "work":
            assert instance.ExitInitializationMode() == OK
            for k in range(3):
                for name in library.names("input"):
                    assert instance.set(name, 0.3 * k) == OK
                assert instance.step(0.7 + k * SIZE, SIZE) == OK
            knowns = [n for n in knowns if library.variables[n].get("variability") != "fixed"]
        for output in outputs:
            for name in knowns:
                forward, backward = instance.directional(output, name), instance.adjoint(output, name)
                assert backward == pytest.approx(forward, rel=1e-11, abs=1e-300)
    instance.free()


def test_event_mode_and_other_interfaces_are_refused_as_declared(library3):
    library = library3
    declared = library.root.find("CoSimulation")
    for flag in ("hasEventMode", "mightReturnEarlyFromDoStep"):
        assert declared.get(flag, "false") == "false"
    create, token, log = library.dll.fmi3InstantiateCoSimulation, library.guid.encode(), library._logger3
    assert not create(b"one", token, None, False, False, True, False, None, c.c_size_t(0), None, log, None)
    assert "hasEventMode" in library.messages[-1][1]
    assert not library.instantiate(kind=2)
