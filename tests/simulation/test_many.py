"""Many parameter sets at once give what each gives alone."""

from __future__ import annotations

import platform

import casadi as ca
import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin.models.language.errors import DeclarationError, SolveError
from hydrotwin.simulation import compiler, engines, lower, prepare, run_many, squares_of_many
from hydrotwin.simulation.engines import lanes_of
from tests.simulation.small_models import explosion, lag, pressed_slide, small_model, stiff_pair

TIME = np.arange(400) * 0.01
FLOW = np.sin(3 * TIME) + (TIME % 1.0 < 0.3)
SAME = 1e-9  # of an output's range


def apart(y, reference) -> float:
    """Largest difference, in ranges of the outputs, samples along the last axis but one."""
    return float((np.abs(y - reference).max(axis=-2) / np.ptp(reference, axis=-2)).max())


def spread(flat, sets, relative=0.2, seed=1):
    """Parameter vectors (sets, np) around the model's."""
    p = flat.parameter_vector()
    return p * np.exp(relative * np.random.default_rng(seed).standard_normal((sets, len(p))))


def started(flat, p):
    return np.array([flat.start_given(())(np.zeros(len(flat.inputs)), one, []).full().ravel() for one in p])


def flow_record(time=TIME, flow=FLOW):
    return ht.Record(time, {"flow": flow}, {"flow": "1"}, "flow")


@pytest.mark.parametrize("name", ["cehA", "spool_valve"])
def test_every_set_of_a_shipped_machine_runs_as_it_does_alone(name):
    """Three more than the lanes of a usual processor; parameters that identification frees, a fifth apart."""
    model = ht.load(name)
    record = ht.read_record(f"examples/{name}/recordings/train_1.csv").window(0, 4)
    free = [q for q in model.flat.parameters if q.free]
    names, values = [q.name for q in free], np.array([q.value for q in free])
    sets = values * np.exp(0.2 * np.random.default_rng(1).standard_normal((11, len(free))))
    many = ht.simulate_many(model, sets, record, names=names)
    assert many.values.shape == (11, len(record.time), len(model.flat.outputs)) and not many.diverged.any()
    for k in (0, 7, 8, 10):
        alone = ht.simulate(model, record, parameters=dict(zip(names, sets[k], strict=True)))
        assert apart(many.values[k], alone.array(many.outputs)) < SAME
        assert many.accuracies[k].error == pytest.approx(alone.accuracy.error, rel=1e-3, abs=1e-12)
        assert many.record(k).units == alone.units and many.record(k).name == alone.name
        assert (many[many.outputs[1]][k] == many.record(k)[many.outputs[1]]).all()


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
@pytest.mark.parametrize("method", ["explicit", "auto"])
@pytest.mark.parametrize("sets", [2, 19])
def test_friction_a_relief_valve_and_dead_times_go_side_by_side(interpolation, method, sets):
    flat = pressed_slide(interpolation)
    propagator, p = prepare(flat, method=method, step=4e-3), spread(flat, sets)
    x0 = started(flat, p)
    y, stops = run_many(propagator, TIME, FLOW, p, x0)
    assert lanes_of(flat) is not None and stops == [None] * sets
    alone = np.array([propagator.run(TIME, FLOW, *one)[0] for one in zip(p, x0, strict=True)])
    assert apart(y, alone) < SAME
    assert apart(y[:1], y[1:2]) > 1e-3  # they are not all the same run


def test_a_lane_refines_its_own_kinks():
    """The valve opens inside steps: without refinement the runs are others."""
    flat = pressed_slide()
    p = spread(flat, 8)
    coarse = prepare(flat, step=1e-2, tolerance=np.inf)
    fine = prepare(flat, step=1e-2)
    plain, refined = (run_many(one, TIME, FLOW, p, started(flat, p))[0] for one in (coarse, fine))
    alone = np.array([fine.run(TIME, FLOW, *one)[0] for one in zip(p, started(flat, p), strict=True)])
    assert fine.method == "explicit"
    assert apart(refined, alone) < SAME < 1e-6 < apart(refined, plain)


def test_squares_are_those_of_the_outputs_where_something_was_measured():
    flat = pressed_slide()
    propagator, p = prepare(flat), spread(flat, 11)
    y, _ = run_many(propagator, TIME, FLOW, p, started(flat, p))
    measured = y[0] + 0.1
    measured[50:80, 1] = np.nan
    squares = squares_of_many(propagator, TIME, FLOW, p, started(flat, p), measured)
    np.testing.assert_allclose(squares, np.nansum((y - measured) ** 2, axis=1), rtol=1e-12)
    assert squares[0, 1] == pytest.approx(0.01 * (len(TIME) - 30))


def test_a_set_that_diverges_is_marked_and_costs_only_itself():
    flat = explosion()
    record = ht.Record(np.linspace(0, 0.8, 81), {}, {}, "nothing")
    rates = np.array([0.5, 0.1, 4.0, 1.0, 0.2, 5.0, 0.3, 0.4, 0.6])  # infinite at 1 / rate
    many = ht.simulate_many(flat, rates[:, None], record, names=["rate"])
    assert many.diverged.tolist() == (rates > 1.25).tolist()
    assert np.isnan(many.values[many.diverged]).all()
    exact = 1 / (1 - rates[~many.diverged, None] * record.time)
    np.testing.assert_allclose(many["bang_seen"][~many.diverged], exact, rtol=1e-6)
    with pytest.raises(ht.HydrotwinError, match=r"bang") as alone:
        ht.simulate(flat, record, parameters={"rate": 4.0})
    assert many.reasons[2] == str(alone.value)
    with pytest.raises(ht.HydrotwinError, match="bang"):
        many.record(2)


def test_squares_of_sets_that_all_diverge_are_nan():
    flat, time = explosion(), np.linspace(0, 0.8, 81)
    p, propagator = np.full((9, 1), 4.0), prepare(flat, method="explicit")
    arguments = propagator, time, np.empty((81, 0)), p, started(flat, p)
    assert np.isnan(squares_of_many(*arguments, np.zeros((81, 3)))).all()
    assert all("bang" in str(stop) for stop in run_many(*arguments)[1])


def test_stiff_sets_are_integrated_one_by_one_beside_the_others():
    """Two of them are too fast for explicit steps of any size that is tried."""
    fast = [1.0, 2.0, 1e5, 3.0, 4.0, 5.0, 2e5, 6.0, 7.0, 8.0]
    record = ht.Record(np.linspace(0, 3, 31), {}, {}, "nothing")
    many = ht.simulate_many(stiff_pair(), [{"fast": value} for value in fast], record)
    np.testing.assert_allclose(many["x_seen"], np.tile(np.cos(record.time), (10, 1)), atol=1e-7)
    assert [a.method for a in many.accuracies] == ["implicit" if value > 1e4 else "explicit" for value in fast]


def test_one_set_is_a_single_run():
    record = flow_record()
    alone = ht.simulate(pressed_slide(), record, parameters={"friction": 0.5})
    many = ht.simulate_many(pressed_slide(), [{"friction": 0.5}], record)
    assert (many.values[0] == alone.array(many.outputs)).all()


@pytest.mark.parametrize("why", ["no compiler", "no vectors", "no vector form"])
def test_without_lanes_the_sets_run_one_by_one(why, monkeypatch, request):
    sets = [{"friction": value} for value in (0.3, 0.6, 0.9)]
    lanes = ht.simulate_many(pressed_slide(), sets, flow_record())
    request.getfixturevalue("new_cache")
    if why == "no vectors":
        monkeypatch.setenv("CC", "cc")
        monkeypatch.setattr(engines, "lanes_source", lambda flat, functions: "#error a compiler without vectors")
    elif why == "no vector form":
        monkeypatch.setattr(engines, "lanes_source", lambda flat, functions: None)
    else:
        monkeypatch.setattr(compiler, "compilers", list)
        with pytest.warns(UserWarning, match="no C compiler"):
            prepare(flat := pressed_slide())
    flat = pressed_slide() if why != "no compiler" else flat
    assert apart(ht.simulate_many(flat, sets, flow_record()).values, lanes.values) < SAME
    assert lanes_of(flat) is None


def test_squares_of_a_stopped_set_are_nan_in_lanes_and_one_by_one():
    """Where nothing was measured they would be zero, and the set the best of all."""
    flat, time = explosion(), np.linspace(0, 0.8, 81)
    measured = np.full((81, len(flat.outputs)), np.nan)
    measured[:, 0] = 1.0
    for sets, method in ((9, "explicit"), (1, "explicit"), (9, "implicit")):
        p, propagator = np.full((sets, 1), 4.0), prepare(flat, method=method)
        squares = squares_of_many(propagator, time, np.empty((81, 0)), p, started(flat, p), measured)
        assert np.isnan(squares).all(), (sets, method)


def test_sets_may_come_one_after_the_other():
    many = ht.simulate_many(pressed_slide(), ({"friction": value} for value in (0.3, 0.6)), flow_record())
    assert len(many) == 2


def test_blocks_run_one_by_one():
    block = lower(lag(), 0.01)
    record = ht.Record(TIME, {"u": FLOW}, {"u": "1"}, "u")
    many = ht.simulate_many(block, [{"k": 1.0}, {"k": 3.0}], record)
    alone = ht.simulate(block, record, parameters={"k": 3.0})
    assert (many["x_seen"][1] == alone["x_seen"]).all()
    np.testing.assert_allclose(many["x_seen"][1], 3 * many["x_seen"][0], rtol=1e-12)


def test_sets_that_miss_the_accuracy_are_told_once():
    """Steps of 0.1 s through friction that turns within 0.02 m/s."""
    sets = [{"friction": value} for value in np.linspace(0.2, 1.0, 9)]
    with pytest.warns(UserWarning, match=r"9 of 9 sets; the worst, set \d, is not accurate") as told:
        many = ht.simulate_many(pressed_slide(), sets, flow_record(TIME[::10], FLOW[::10]), step=0.1, method="explicit")
    assert len(told) == 1 and not any(a.reached for a in many.accuracies)


@pytest.mark.parametrize(
    ("sets", "names", "said"),
    [
        ([], None, "no parameter sets. Give at least one"),
        ({"friction": 1.0}, None, "no list of sets"),
        (np.ones((2, 1)), None, "without names"),
        (np.ones((2, 3)), ["friction"], r"\(sets, 1\) \(got \(2, 3\)\)"),
        (np.ones((0, 1)), ["friction"], "no parameter sets"),
        (np.ones((2, 2)), ["friction", "friction"], "'friction' is named for two columns"),
        ([{"friction": 1.0}], ["friction"], "Leave names out for mappings"),
        ([{"frction": 1.0}], None, "Did you mean 'friction'"),
        ([{"friction": "fast"}], None, "'fast' is no number"),
    ],
)
def test_unusable_sets_are_refused(sets, names, said):
    with pytest.raises(DeclarationError, match=said):
        ht.simulate_many(pressed_slide(), sets, flow_record(), names=names)


def test_an_unknown_output_names_the_right_one():
    with pytest.raises(DeclarationError, match="Did you mean 'place_seen'"):
        ht.simulate_many(pressed_slide(), [{}], flow_record())["place_sen"]


def test_arrays_of_the_wrong_shape_are_refused():
    propagator = prepare(pressed_slide())
    with pytest.raises(SolveError, match=r"shapes \(sets, 5\) and \(sets, 3\)"):
        run_many(propagator, TIME, FLOW, np.ones((2, 4)), np.zeros((2, 3)))
    with pytest.raises(SolveError, match="measured must have shape"):
        squares_of_many(propagator, TIME, FLOW, np.ones((2, 5)), np.zeros((2, 3)), np.zeros((400, 2)))


def test_every_function_of_a_model_has_its_vector_form():
    """Against CasADi's interpreter, on numbers of both signs and on zero."""

    def equations(t, x, u, p):
        a, b = p[0], p[1]
        one = [ca.sqrt(a * a), ca.floor(a), ca.ceil(a), ca.exp(a), ca.log(b), ca.sin(a), ca.cos(a), ca.tan(a)]
        one += [ca.asin(a / 9), ca.acos(a / 9), ca.atan(a), ca.sinh(a), ca.cosh(a), ca.tanh(a), ca.asinh(a)]
        one += [ca.acosh(1 + b), ca.atanh(a / 9), ca.erf(a), ca.log1p(b), ca.expm1(a), ca.fabs(a), ca.sign(a), 1 / b]
        two = [b**a, b**1.75, ca.atan2(a, b), ca.hypot(a, b), ca.fmod(a, b), ca.remainder(a, b), ca.copysign(b, a)]
        two += [ca.fmin(a, b), ca.fmax(a, b), a < b, a <= b, a == 0, a != 0, ca.if_else(a > 1, a, -b)]
        logic = [ca.logic_and(a > 0, b > 1), ca.logic_or(a > 0, b > 1), ca.logic_not(a > 0)]
        return ca.SX(0), ca.vertcat(*one, *two, *logic)

    count = 23 + 7 + 7 + 3
    flat = small_model("functions", ["x"], {"a": 0, "b": 1}, equations, outputs=[f"f{k}" for k in range(count)])
    p = np.array([(a, b) for a in (-7.5, -1.0, -0.3, 0.0, 1e-9, 0.2, 1.0, 2.5, 8.0) for b in (0.4, 1.0, 3.7)])
    y, stops = run_many(prepare(flat, method="explicit"), np.zeros(1), np.empty((1, 0)), p, np.zeros((len(p), 1)))
    assert lanes_of(flat) is not None and stops == [None] * len(p)
    exact = np.array([flat.ode(0, 0, [], one)[1].full().ravel() for one in p])
    np.testing.assert_allclose(y[:, 0], exact, rtol=1e-14, atol=1e-15)


@pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc" or platform.machine() != "x86_64", reason="libmvec is glibc's on x86-64"
)
def test_a_sine_and_a_cosine_of_one_angle_stay_in_lanes(monkeypatch, tmp_path):
    """Merged into a sincos they would be taken one lane after the other."""
    monkeypatch.setenv("HYDROTWIN_CACHE", str(tmp_path))
    model = small_model("turning", ["x"], {"w": 1.0}, lambda t, x, u, p: (ca.cos(x) + p * ca.sin(x), x))
    assert lanes_of(model) is not None
    symbols = next(tmp_path.glob("[!d]*.so")).read_bytes()  # not the driver
    if b"clang" in symbols:
        pytest.skip("it knows no libmvec")
    assert b"v_sin\0" in symbols and b"v_cos\0" in symbols


def test_lanes_are_compiled_for_each_processor(monkeypatch, tmp_path):
    """A cache folder may be shared by machines; a compiler that cannot tell its processor takes none for granted."""
    monkeypatch.setenv("HYDROTWIN_CACHE", str(tmp_path))
    commands = []
    monkeypatch.setattr(engines, "DRIVER", ("-O0",))  # what is compiled matters here, not how well
    compiled = compiler._compiled
    monkeypatch.setattr(compiler, "_compiled", lambda *a: commands.append(a[2]) or compiled(*a))
    for processor in ("#define __AVX2__ 1", "#define __SSE2__ 1", ""):
        monkeypatch.setattr(compiler, "_processor", lambda command, told=processor: told)
        assert lanes_of(lag()) is not None
    assert len(list(tmp_path.iterdir())) == 6  # a driver for each
    assert [compiler.NATIVE in command for command in commands] == [True, True, True, True, False, False]
