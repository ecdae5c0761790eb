"""Model Exchange: the importer integrates, the FMU answers with derivatives."""

from __future__ import annotations

import ctypes as c
import itertools
import math
import subprocess

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from hydrotwin.export import check_fmu, export_fmu, read_fmu, reference_run
from hydrotwin.models.language.errors import DeclarationError
from tests.export.raw import DISCARD, ERROR, OK
from tests.export.systems import arm_record
from tests.export.test_agreement import WITHIN, cvodes
from tests.export.test_description import read

ME, BOTH = ("kind", "me"), ("kind", "both")
VERSIONS = [("fmi", 2), ("fmi", 3)]
NAMES = ["cehA", "clocked mass", "stiff"]
VARIANTS = list(itertools.product(NAMES, [ME, BOTH], VERSIONS))


def label(variant) -> str:
    """A variant in words."""
    return f"{variant[0]} {variant[1][1]} {variant[2][1]}"


@pytest.fixture(params=VARIANTS, ids=label)
def library(request, exchangers):
    return exchangers[request.param]


@pytest.fixture
def instance(library):
    made = library.instance(kind=0)
    yield made
    made.free()


def states_of(library) -> list[str]:
    return [n.removeprefix("der(").removesuffix(")") for n in library.names("local") if n.startswith("der(")]


def moved(instance, share: float = 0.3) -> list[float]:
    """States away from the start, of the size of their nominal values."""
    count = len(states_of(instance.library))
    x, nominal = (instance.vector(w, count) for w in ("ContinuousStates", "NominalsOfContinuousStates"))
    return [a + share * b / (k + 2) for k, (a, b) in enumerate(zip(x, nominal, strict=True))]


@pytest.mark.parametrize("variant", VARIANTS, ids=label)
def test_fmpy_finds_no_problem(variants, variant):
    assert validate_fmu(str(variants[variant])) == []


def test_both_interfaces_export_the_functions_of_both(exchangers):
    def functions(kind):
        path = exchangers["cehA", kind, ("fmi", 2)].path
        listed = subprocess.run(["nm", "-D", "--defined-only", path], capture_output=True, text=True, check=True)
        return {line.split()[-1] for line in listed.stdout.splitlines()}

    exchange = (
        "EnterEventMode NewDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep SetTime SetContinuousStates "
        "GetDerivatives GetEventIndicators GetContinuousStates GetNominalsOfContinuousStates"
    )
    me, both = functions(ME), functions(BOTH)
    assert {f"fmi2{n}" for n in exchange.split()} < me < both
    assert "fmi2DoStep" in both - me


@pytest.mark.parametrize("version", VERSIONS)
def test_derivatives_name_their_state_and_list_what_they_follow_from(exchangers, version):
    library = exchangers["clocked mass", ME, version]
    names, first = list(library.variables), 1 if library.fmi == 2 else 0
    for state in ("mass.s", "mass.v"):
        row = library.variables[f"der({state})"]
        row = row.find("Real") if library.fmi == 2 else row
        assert names[int(row.get("derivative")) - first] == state
    assert library.knowns("ContinuousStateDerivative", "der(mass.s)") == ["mass.v"]
    assert set(library.knowns("ContinuousStateDerivative", "der(mass.v)")) == {"mass.s", "mass.v", "force", "time"}
    initial = {n: set(library.knowns("InitialUnknown", n)) for n in ("mass.s", "mass.v", "der(mass.s)", "power")}
    speed = {"mass.v.start"}
    assert initial == {"mass.s": {"mass.s.start"}, "mass.v": speed, "der(mass.s)": speed, "power": {"force", *speed}}


def test_an_interface_that_is_not_offered_is_refused(exchangers, libraries):
    stepping = [libraries["cehA"], exchangers["cehA", ("fmi", 3)]]
    exchanging = [exchangers["cehA", ME, version] for version in VERSIONS]
    for library, kind in [*((one, 0) for one in stepping), *((one, 1) for one in exchanging)]:
        assert not library.instantiate(kind=kind)
        assert "interface" in library.messages[-1][1]


def test_time_states_and_inputs_can_be_set_in_any_order(library, instance, systems):
    """24 orders of setting and asking in between: the last answer is that of the equations."""
    flat = systems[library.root.get("modelName")]
    [u], count = library.names("input"), len(flat.states)
    instance.exchange()
    first, x, outputs = instance.vector("ContinuousStates", count), moved(instance), library.names("output")
    xdot, y = (np.array(v).ravel() for v in flat.ode(1.7, x, 0.4, flat.parameter_vector()))
    acts = {
        "time": lambda: instance.set_time(1.7),
        "states": lambda: instance.set_states(x),
        "input": lambda: instance.set(u, 0.4),
        "ask": lambda: OK if instance.vector("Derivatives", count) else ERROR,
    }
    for order in itertools.permutations(acts):
        instance.set_time(0.0), instance.set_states(first), instance.set(u, 0.0)
        instance.get(*outputs)
        assert [acts[a]() for a in order] == [OK] * 4
        assert instance.vector("Derivatives", count) == pytest.approx(xdot.tolist(), rel=1e-12)
        assert instance.get(*outputs) == pytest.approx(y.tolist(), rel=1e-12)
        assert instance.get(*states_of(library)) == x


def test_directional_derivatives_are_exact_at_any_point(library, instance, systems):
    """Against CasADi's Jacobians of the same equations, with t != 0 and states away from the start."""
    flat = systems[library.root.get("modelName")]
    [u] = library.names("input")
    instance.exchange()
    x = moved(instance)
    instance.set_time(1.7), instance.set_states(x), instance.set(u, 0.4)
    unknowns = {"xdot": [f"der({n})" for n in states_of(library)], "y": library.names("output")}
    knowns = {"x": states_of(library), "u": [u], "p": [p.name for p in flat.parameters]}
    if "time" in library.references:
        knowns["t"] = ["time"]
    jacobians = flat.ode.jacobian()(1.7, x, 0.4, flat.parameter_vector(), 0, 0)
    position = {n: k for k, n in enumerate(flat.ode.jacobian().name_out())}
    for result, rows in unknowns.items():
        for argument, columns in knowns.items():
            expected = np.array(jacobians[position[f"jac_{result}_{argument}"]])
            found = [[instance.directional(row, column) for column in columns] for row in rows]
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
            if library.fmi == 3:
                found = [[instance.adjoint(row, column) for column in columns] for row in rows]
                np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


_FLAGS3 = [c.c_bool() for _ in range(3)]
_LAST3 = c.c_double()
_ANY_STEP = {
    2: (c.c_double(0.0), c.c_double(0.01), 1),
    3: (c.c_double(0.0), c.c_double(0.01), True, *map(c.byref, _FLAGS3), c.byref(_LAST3)),
}


def test_the_state_machine_is_kept(library, instance):
    count = len(states_of(library))
    assert instance.set_time(0.0) == ERROR
    instance.initialise()
    x = instance.vector("ContinuousStates", count)
    parameter = next(n for n in library.names("parameter") if library.variables[n].get("variability") == "tunable")
    if library.fmi == 3 or hasattr(library.dll, "fmi2DoStep"):
        assert instance.DoStep(*_ANY_STEP[library.fmi]) == ERROR
    assert instance.set(parameter, instance.get(parameter)[0]) == OK
    assert instance.EnterEventMode() == ERROR
    assert instance.EnterContinuousTimeMode() == OK
    assert instance.set(parameter, instance.get(parameter)[0]) == OK
    fixed = [n for n in library.names("parameter") if library.variables[n].get("variability") == "fixed"]
    assert [instance.set(n, 1.0) for n in fixed] == [ERROR] * len(fixed)
    assert instance.set(library.names("output")[0], 1.0) == ERROR
    assert instance.set_states([*x, 1.0]) == ERROR
    assert instance.set_states([math.nan, *x[1:]]) == DISCARD
    assert instance.vector("ContinuousStates", count) == x
    assert instance.EnterEventMode() == OK
    assert instance.Terminate() == OK
    assert instance.set_time(1.0) == ERROR
    assert instance.Reset() == OK
    instance.exchange()
    assert instance.vector("ContinuousStates", count) == x


def test_nominal_values_are_those_of_the_states(library, instance, systems):
    flat = systems[library.root.get("modelName")]
    instance.initialise()
    nominals = [s.nominal for s in flat.states]
    assert instance.vector("NominalsOfContinuousStates", len(nominals)) == nominals


@pytest.mark.parametrize("version", VERSIONS)
def test_a_state_of_the_other_interface_is_refused(exchangers, version):
    library = exchangers["cehA", BOTH, version]
    exchanging, stepping = library.instance(kind=0).exchange(), library.instance(kind=1).initialise()
    stored = exchanging.serialized()
    assert stepping.restore(stored) == ERROR
    exchanging.set_states(moved(exchanging))
    assert exchanging.restore(stored) == OK
    assert exchanging.serialized() == stored
    exchanging.free(), stepping.free()


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpys_cvode_agrees_with_a_tight_cvodes_in_every_output(variants, systems, version):
    record = arm_record(2.0)
    expected = cvodes(systems["cehA"], record, {"arm.angle": 0.1})
    found = read_fmu(variants["cehA", ME, version]).free_run(record)
    errors = {n: np.abs(found[n] - expected[n]).max() / np.ptp(expected[n]) for n in expected}
    assert max(errors.values()) < WITHIN, errors


@pytest.mark.parametrize("version", VERSIONS)
def test_co_simulation_is_the_same_beside_model_exchange_and_in_both_versions(variants, fmus, version):
    record = arm_record(1.0)
    alone, beside = (read_fmu(f).free_run(record) for f in (fmus["cehA"], variants["cehA", BOTH, version]))
    assert all(np.array_equal(alone[n], beside[n]) for n in alone.signals)


@pytest.mark.parametrize(("kind", "fmi"), [("me", 2), ("both", 2), ("cs", 3), ("me", 3), ("both", 3)])
def test_check_passes_every_kind(systems, tmp_path, kind, fmi):
    flat = systems["cehA"]
    reference = reference_run(flat, fine=kind == "me")
    check = check_fmu(export_fmu(flat, tmp_path / "x.fmu", kind=kind, fmi=fmi, reference=reference))
    assert check.passed, str(check)
    assert check["reference"].passed
    assert kind == "me" or check["directional derivatives"].passed


@pytest.mark.parametrize(("name", "words"), [("lag", "sampled block"), ("delayed mass", "delayed: force")])
@pytest.mark.parametrize("kind", ["me", "both"])
def test_what_model_exchange_cannot_do_is_said(systems, tmp_path, name, words, kind):
    with pytest.raises(DeclarationError, match=words):
        export_fmu(systems[name], tmp_path / "x.fmu", kind=kind)
    assert not list(tmp_path.iterdir())


def test_the_documentation_names_the_interfaces_and_who_integrates(variants):
    both, me = (read(variants["cehA", kind, VERSIONS[0]], "documentation/index.html") for kind in (BOTH, ME))
    assert "FMI 2.0 Model Exchange and Co-Simulation" in both
    assert "Runge-Kutta" in both
    assert "the importer integrates" in me
    assert "Runge-Kutta" not in me
