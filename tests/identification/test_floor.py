"""No noise is smaller than the accuracy of solvers and files: exact data is explained, a true gap is not."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydrotwin.identification import OutputResidual, identify
from hydrotwin.identification.noise import ACCURACY, output_noise
from hydrotwin.identification.problem import recordings
from hydrotwin.models.language.flat import FlatModel, ParameterValue, Signal, StateVariable, fixed_start
from hydrotwin.models.language.units import parse_unit
from hydrotwin.records import Record
from hydrotwin.simulation import prepare

from .drive import TRUTH, drive, recorded

OFF = {"motor.gain": 12.0, "motor.time_constant": 0.08}
OUTPUTS = ("position", "motor_speed")


def exact(seeds=(1, 2)) -> list[Record]:
    return [recorded(drive(), k) for k in seeds]


def written(record: Record, how, names=OUTPUTS) -> Record:
    """The recording with some of its outputs as a file holds them."""
    return record.with_signals({n: how(record[n]) for n in names})


def digits(number: int, unit: str):
    """As written with so many significant digits in a unit."""
    factor = parse_unit(unit).factor
    return lambda values: np.array([float(f"{v / factor:.{number - 1}e}") for v in values]) * factor


def require_the_truth(fit):
    """Converged, explained by what was there, the values right within what is said of them."""
    assert fit.converged and not fit.findings, fit.summary()
    assert all(r.explained for r in fit.residuals)
    for p in fit.parameters:
        assert abs(p.value - TRUTH[p.name]) < 4 * p.sigma, p
        assert p.sigma < 0.02 * p.value


def test_exact_data_of_the_same_equations_is_explained_with_sigmas_that_the_solver_bears_out():
    fit = identify(drive(), exact(), start=OFF)
    require_the_truth(fit)
    for p in fit.parameters:
        assert p.sigma > 1e-3 * ACCURACY * p.value, "no solver is that accurate"


def test_exact_data_of_a_coarser_step_is_explained():
    def coarse(seed):
        record, model = recorded(drive(), seed), drive()
        u = record["command"][:, None]
        y, _ = prepare(model, step=0.02).run(record.time, u, model.parameter_vector(), np.zeros(2))
        return record.with_signals(dict(zip(OUTPUTS, (y[:, 0], y[:, 1]), strict=True)))

    require_the_truth(identify(drive(), [coarse(1), coarse(2)], start=OFF))


@pytest.mark.parametrize(
    "how",
    [
        pytest.param(digits(3, "m"), id="three digits"),
        pytest.param(digits(4, "in"), id="four digits of inches"),
        pytest.param(digits(6, "deg"), id="six digits of degrees"),
        pytest.param(lambda v: np.round(v, 2), id="two decimals"),
        pytest.param(lambda v: np.float32(v).astype(float), id="single precision"),
        pytest.param(lambda v: 0.05 * np.round(v / 0.05), id="a coarse encoder"),
        pytest.param(lambda v: 0.05 * np.floor(v / 0.05) + 0.025, id="an encoder that rounds down"),
    ],
)
def test_data_that_a_file_or_a_sensor_rounds_is_explained(how):
    require_the_truth(identify(drive(), [written(r, how) for r in exact()], start=OFF))


@pytest.mark.parametrize("number", [2, 3, 4])
def test_a_file_that_rounds_its_inputs_too_is_explained(number):
    rounded = [written(r, digits(number, "m"), (*OUTPUTS, "command")) for r in exact((1, 2, 3))]
    require_the_truth(identify(drive(), rounded, start=OFF, starts=1))


def test_an_exact_output_beside_a_noisy_one_is_explained():
    noisy = [recorded(drive(), k, noise={"motor_speed": 0.1}) for k in (1, 2)]
    fit = identify(drive(), noisy, start=OFF)
    require_the_truth(fit)
    assert fit.noise["motor_speed"] == pytest.approx(0.1, rel=0.2)
    assert fit.noise["position"] < 1e-3


def test_spikes_do_not_widen_the_floor():
    spoiled = written(recorded(drive(), 1), lambda v: np.where(np.arange(len(v)) == 100, 1e4, v), ["position"])
    assert output_noise(drive(), recordings(drive(), [spoiled], None, "run"))[1] < 1e-3


@pytest.mark.parametrize("share", [1e-4, 1e-3])
def test_a_gap_of_a_ten_thousandth_of_the_range_is_still_found(share):
    def drifting(record):
        return written(record, lambda v: v + share * np.ptp(v) * np.sin(record.time / 2.0), ["position"])

    fit = identify(drive(), [drifting(r) for r in exact()], start=OFF)
    assert [f for f in fit.findings if f.kind == "unexplained" and "position" in str(f)]


def lagging(size: float, offset: float) -> FlatModel:
    """tau x' = k u - (x - offset), x of any size."""
    t, x, u, p = ca.SX.sym("t"), ca.SX.sym("x"), ca.SX.sym("u"), ca.SX.sym("p", 2)
    rate = (p[0] * u - (x - offset)) / p[1]
    return FlatModel(
        name="lag",
        inputs=(Signal("command", "V"),),
        outputs=(Signal("level", "Pa", nominal=size),),
        states=(StateVariable("x", "Pa", nominal=size, measured_by="level"),),
        parameters=(
            ParameterValue("gain", 1.3 * size, "Pa/V", (0.1 * size, 10 * size), free=True),
            ParameterValue("time_constant", 0.4, "s", (0.01, 10.0), free=True),
        ),
        ode=ca.Function("ode", [t, x, u, p], [rate, x], ["t", "x", "u", "p"], ["xdot", "y"]),
        initialisation=fixed_start([offset], ["x"], 1, 2),
        step=0.02,
    )


@pytest.mark.parametrize(("size", "offset"), [(1e-9, 0.0), (1e-9, 1e-6), (10.0, 1e7), (1e12, 0.0)])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_neither_a_tiny_scale_nor_a_huge_offset_makes_a_gap(size, offset, noise):
    model, random = lagging(size, offset), np.random.default_rng(3)
    time = np.arange(0.0, 20.0, 0.02)
    u = np.repeat(random.normal(size=len(time) // 50 + 1), 50)[: len(time)]
    y, _ = prepare(model).run(time, u[:, None], np.array([size, 0.3]), np.array([offset]))
    level = y[:, 0] + noise * size * random.normal(size=len(time))
    fit = identify(model, [Record(time, {"command": u, "level": level}, {"command": "V", "level": "Pa"}, "run")])
    assert fit.converged and not fit.findings and fit.residuals[0].explained
    assert abs(fit.values["gain"] - size) < 4 * fit.sigma["gain"]
    assert abs(fit.values["time_constant"] - 0.3) < 4 * fit.sigma["time_constant"]


def test_less_than_the_noise_is_never_unexplained():
    rest = OutputResidual("run", "angle", "train", 0.5, 1.0, "rad", 1000, 0.25, 0.99, 0.0, False)
    assert rest.explained


@pytest.mark.parametrize(("factor", "told"), [(1.0, False), (1.3, True), (5.0, True)])
def test_a_validation_recording_of_another_machine_is_told_beside_convergence(factor, told):
    model, random = lagging(1.0, 0.0), np.random.default_rng(3)
    time = np.arange(0.0, 20.0, 0.02)

    def recorded(name: str, gain: float) -> Record:
        u = np.repeat(random.normal(size=len(time) // 50 + 1), 50)[: len(time)]
        y, _ = prepare(model).run(time, u[:, None], np.array([gain, 0.3]), np.array([0.0]))
        level = y[:, 0] + 1e-2 * random.normal(size=len(time))
        return Record(time, {"command": u, "level": level}, {"command": "V", "level": "Pa"}, name)

    fit = identify(model, [recorded("same", 1.0)], validate=[recorded("other", factor)])
    found = [f for f in fit.findings if f.kind == "not_borne_out"]
    assert fit.converged and bool(found) is told
    assert not told or ("other, which took no part" in found[0].sentence and "level" in found[0].sentence)
