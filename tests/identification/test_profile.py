"""Profile likelihoods against closed forms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.identification import identify, profile
from hydrotwin.models.language import DataError, DeclarationError
from hydrotwin.simulation import simulate
from tests.identification.influences import hollows, product, record, saturating, steps, weighted

CROSS = 3.841459
WIDE = (-np.inf, np.inf)


def fitted(model, driven, noise, free="*", **options):
    rng = np.random.default_rng(2)
    ran = simulate(model, driven)
    seen = {name: ran[name] + noise * rng.standard_normal(len(driven.time)) for name in options.pop("seen")}
    driven = driven.with_signals(seen, dict.fromkeys(seen, "1"))
    return identify(model, [driven], free=[free], noise=dict.fromkeys(seen, noise), weights="noise", **options), driven


def test_the_profile_of_a_linear_parameter_is_its_quadratic_interval():
    fit, driven = fitted(weighted(), record(u=steps, v=lambda t: np.cos(5 * t)), 0.1, seen=["y"])
    found = profile(fit, [driven])
    for told in found.profiles:
        assert told.identifiable and told.quadratic_holds
        assert (told.low, told.high) == pytest.approx(told.quadratic, rel=1e-3)
        inside = (told.grid > told.low) & (told.grid < told.high)
        parabola = ((told.grid - told.value) / (told.high - told.value)) ** 2 * CROSS
        assert told.rise[inside] == pytest.approx(parabola[inside], abs=0.01)
        assert "the quadratic interval holds" in told.sentence
    assert found.lower == "" and found["a"].name == "a"


def test_parameters_that_only_act_together_are_told_as_not_identifiable():
    fit, driven = fitted(product(), record(u=steps, x_seen=0.0), 0.01, seen=["x_seen"])
    found = profile(fit, [driven])
    for name, other in (("a", "b"), ("b", "a")):
        told = found[name]
        assert not told.identifiable and told.high == np.inf
        assert f"{name} is not identifiable from these recordings, neither downwards nor upwards" in told.sentence
        assert f"because {other} makes up for it" in told.sentence
        product_of = np.prod(told.others[:, :2], axis=1)
        assert product_of == pytest.approx(np.full(len(product_of), 6.0), rel=0.02)
        assert told.quadratic is None and told.as_data()["quadratic"] is None
        assert f"no quadratic interval: the cost has no minimum in it, for {other} can make up" in told.sentence
    assert found["tau"].identifiable and found["tau"].quadratic and "no quadratic" not in found["tau"].sentence
    assert "nan" not in found._repr_html_() + " ".join(found.sentences())
    assert "nan" not in fit.summary().replace("noise only", "") and "± unknown" in fit.summary()
    assert "not identifiable" in found._repr_html_() and "not identifiable" in found.sentences()[0]


def test_a_lopsided_profile_is_the_exact_one():
    """y = 1 - exp(-k): its likelihood is known on paper, and crosses on the lower side alone when y is nearly 1."""
    fit, driven = fitted(saturating(3.0), record(seconds=0.2), 0.15, seen=["y"])
    y, noise, n = driven["y"], 0.15, len(driven.time)

    def rise(k):
        return n * ((1 - np.exp(-k) - y.mean()) ** 2 - (1 - np.exp(-best) - y.mean()) ** 2) / noise**2

    best = -np.log(1 - y.mean())
    told = profile(fit, [driven]).profiles[0]
    assert told.value == pytest.approx(best, rel=1e-2)
    scale = (fit.parameters[0].sigma / fit.parameters[0].sigma_white) ** 2
    assert rise(told.low) / scale == pytest.approx(CROSS, rel=0.1)
    above = 1 - y.mean() < 1.96 * noise / np.sqrt(n) * np.sqrt(scale)
    assert (told.high == np.inf) == above
    assert not told.quadratic_holds


def test_a_walk_ends_at_a_bound_and_says_so():
    fit, driven = fitted(product(), record(u=steps, x_seen=0.0), 0.01, seen=["x_seen"], bounds={"a": (1.0, 4.0)})
    told = profile(fit, [driven], parameters=["a"]).profiles[0]
    assert (told.below, told.above) == ("bound", "bound")
    assert told.grid[[0, -1]] == pytest.approx([1.0, 4.0])
    assert "nothing contradicts it from 1 to 4" in told.sentence


def test_a_fit_that_rests_on_its_bound_has_no_quadratic_interval_and_the_next_step_is_told():
    fit, driven = fitted(
        weighted(), record(u=steps, v=1.0), 0.1, seen=["y"], start={"a": 2.0}, bounds={"a": (1.5, 3.0)}
    )
    assert fit.parameter("a").at_bound
    told = profile(fit, [driven], parameters=["a"])["a"]
    assert told.quadratic is None and "rests on its bound" in told.sentence and "Widen" in told.sentence


def test_a_budget_ends_a_walk():
    fit, driven = fitted(product(), record(u=steps, x_seen=0.0), 0.01, seen=["x_seen"])
    found = profile(fit, [driven], parameters=["a"], most=4)
    assert found.fits <= 4 and found.profiles[0].above == "budget"
    assert "given up" in found.profiles[0].sentence


def test_a_lower_minimum_is_taken_and_told():
    """y = 0.02 (k^2 - 1)^2 + 0.01 (k + 1) should be 0: hollows at 1 and, lower, at -1, with a low ridge between."""
    noise = 0.1 * np.tile([1.0, -1.0], 10)
    driven = record(seconds=0.2, y=noise)
    fit = identify(hollows(0.9), [driven], free=["k"], noise={"y": 0.1}, weights="noise", bounds={"k": (0.2, 3.0)})
    assert fit.values["k"] == pytest.approx(0.94, abs=0.05)
    fit = dataclasses.replace(fit, parameters=tuple(dataclasses.replace(p, bounds=WIDE) for p in fit.parameters))
    found = profile(fit, [driven])
    told = found["k"]
    assert told.value == pytest.approx(-1.0, abs=0.05)
    assert told.low < -1 and told.high > 1
    assert "lower than that of the fit" in found.sentences()[0]


def test_profiles_of_a_fit_without_its_outliers_leave_them_out_too():
    rng = np.random.default_rng(3)
    driven = record(u=steps, v=lambda t: np.cos(5 * t))
    y = simulate(weighted(), driven)["y"] + 0.1 * rng.standard_normal(len(driven.time))
    y[[40, 90, 150]] += 30.0
    spiked = driven.with_signals({"y": y}, {"y": "1"})
    fit = identify(weighted(), [spiked], free=["*"])
    assert fit.settings["spared"]
    told = profile(fit, [spiked])["a"]
    assert (told.low, told.high) == pytest.approx(told.quadratic, rel=0.02)


def test_what_cannot_be_profiled_is_refused():
    fit, driven = fitted(product(), record(u=steps, x_seen=0.0), 0.01, free="tau", seen=["x_seen"])
    with pytest.raises(DeclarationError, match="a was not free in the fit"):
        profile(fit, [driven], parameters=["a"])
    with pytest.raises(DeclarationError, match="Did you mean 'tau'"):
        profile(fit, [driven], parameters=["tua"])
    with pytest.raises(DataError, match="not the recordings that product was fitted to, run"):
        profile(fit, [record(seconds=1.0, u=1.0, x_seen=0.0)])
    with pytest.raises(DataError, match="got none"):
        profile(fit, [])
