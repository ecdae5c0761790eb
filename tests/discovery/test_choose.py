"""Of what passes, the best is named, its equals form a class, and probabilities add up to one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.discovery.choose import (
    CREDIBLE,
    EQUAL,
    TEMPERATURE,
    UNLIKELY,
    _late_somewhere,
    choose,
    label,
    worth_refining,
)
from hydrotwin.discovery.decide import TOGETHER, Evidence, compared
from hydrotwin.discovery.refit import Question, Refitted, likelihood
from hydrotwin.discovery.structure import IMPLAUSIBLE, Structure, Tried
from hydrotwin.identification.problem import Recording
from hydrotwin.models.effects import candidates
from tests.discovery.slides import better, slide

N, S = 2000, np.array([1.0])
KNOWN = {c.id: c for c in candidates(slide())}
ASKED = Question((Recording("run", None, np.arange(N) * 0.01, np.zeros((N, 1)), np.zeros((N, 1))),), (), S)
NOISE = np.random.default_rng(0).standard_normal((N, 1))
OTHER = np.random.default_rng(1).standard_normal((N, 1))


def left(times: float, colour: float = 0.0) -> np.ndarray:
    """Noise and something uncorrelated with it beside, so that the size is ``times`` the noise."""
    return NOISE + np.sqrt(max(times**2 - 1, 0)) * OTHER + colour


def structure(names, fit: float, select: float, parameters: int = 3, **values) -> Structure:
    members = tuple(KNOWN[n] for n in names)
    rmse = np.sqrt(np.mean(left(fit) ** 2, axis=0))
    fitted = Refitted(
        {c.free[0]: values.get(c.id, 1e-3) for c in members}, (), np.fmax(rmse, S), (left(fit),), (left(select),),
        likelihood(rmse, ASKED), parameters, (), True, 1,
    )  # fmt: skip
    return Structure(members, fitted)


BASE = structure((), 3.0, 3.0, 2)


def tried(*names, fit: float = 1.0, select: float | None = None, parameters: int = 3, **values) -> Tried:
    """A candidate that leaves ``fit`` and ``select`` times the noise."""
    own = structure(names, fit, select or fit, parameters, **values)
    return Tried(own.members, None, own, compared(own.fitted, BASE.fitted, ASKED))


def test_nothing_is_named_where_nothing_passes():
    assert choose([tried("drift", fit=2.995), tried("null_bias", fit=3.0)], 30, ASKED) is None
    assert choose([], 30, ASKED) is None
    assert choose([Tried((KNOWN["drift"],), None, reason="it diverges")], 30, ASKED) is None


def test_the_one_that_leaves_least_is_named_alone_when_the_others_leave_more():
    choice = choose([tried("drift", fit=2.0), tried("coulomb_friction"), tried("null_bias", fit=1.5)], 30, ASKED)
    assert label(choice.best) == "coulomb_friction at mass.flange"
    assert choice.members == (choice.best,)
    assert choice.probability[label(choice.best)] > 0.99


def test_what_explains_as_well_is_in_the_class_with_the_same_probability():
    choice = choose([tried("drift", fit=2.0), tried("null_bias"), tried("constant_load")], 30, ASKED)
    assert {t.members[0].id for t in choice.members} == {"null_bias", "constant_load"}
    assert choice.members[0] is choice.best
    assert choice.probability["null_bias at force"] == pytest.approx(0.5, abs=0.01)


def test_a_class_holds_nearly_all_of_the_probability():
    sizes = {"drift": 1.0, "null_bias": 1.0032, "constant_load": 1.0062, "coulomb_friction": 1.5}
    choice = choose([tried(n, fit=f) for n, f in sizes.items()], 30, ASKED)
    held = [choice.probability[label(t)] for t in choice.members]
    assert sum(held) >= CREDIBLE and 1 < len(held) < 4
    assert held == sorted(held, reverse=True)


def test_a_refinement_that_explains_little_more_has_no_share_in_the_probability():
    simple, refined = tried("coulomb_friction", fit=1.01), tried("stribeck_friction", fit=1.005, parameters=5)
    choice = choose([simple, refined, tried("drift", fit=1.5)], 30, ASKED)
    assert choice.members == (simple,) and label(refined) not in choice.probability
    assert choice.probability[label(simple)] > 0.99


@pytest.mark.parametrize("seed", range(5))
def test_probabilities_add_up_to_one_and_follow_the_evidence(seed):
    sizes = 1 + 0.05 * np.random.default_rng(seed).uniform(size=5)
    names = ("drift", "null_bias", "constant_load", "coulomb_friction", "dead_time")
    choice = choose([tried(n, fit=f) for n, f in zip(names, sizes, strict=True)], 30, ASKED)
    assert sum(choice.probability.values()) == pytest.approx(1.0)
    order = sorted(names, key=lambda n: -choice.probability[KNOWN[n].label])
    assert order == [n for _, n in sorted(zip(sizes, names, strict=True))]


def test_bic_differences_are_softened_before_they_become_probabilities():
    a, b = tried("drift"), tried("null_bias", fit=1.002)
    over = compared(a.structure.fitted, b.structure.fitted, ASKED)
    choice = choose([a, b], 30, ASKED)
    assert 0 < over.bic_gain < 20
    behind = over.bic_gain + max(over.paired_t, 0) ** 2
    odds = choice.probability[label(b)] / choice.probability[label(a)]
    assert odds == pytest.approx(np.exp(-behind / (2 * TEMPERATURE)), rel=1e-6)


def test_what_fits_only_the_recordings_it_was_fitted_to_is_not_named():
    assert choose([tried("drift", fit=1.0, select=3.0)], 30, ASKED) is None


def test_an_implausible_value_is_never_named_however_well_it_fits():
    beyond = 2 * IMPLAUSIBLE * KNOWN["coulomb_friction"].typical["coulomb_friction.force"][1]
    wild = tried("coulomb_friction", coulomb_friction=beyond)
    assert wild.evidence.passes(30) and choose([wild], 30, ASKED) is None
    choice = choose([wild, tried("drift", fit=1.2)], 30, ASKED)
    assert label(choice.best) == "drift at force" and list(choice.probability) == ["drift at force"]
    assert len(choice.members) == 1


def test_the_simple_effect_is_named_when_its_refinement_explains_little_more():
    simple, refined = tried("coulomb_friction", fit=1.05), tried("stribeck_friction", fit=1.04, parameters=5)
    choice = choose([simple, refined], 30, ASKED)
    assert choice.best is simple and choice.members == (simple,)


def test_a_refinement_of_another_than_the_best_takes_part_when_it_is_more_likely_than_what_it_refines():
    best, simple = tried("null_bias", fit=1.1), tried("coulomb_friction", fit=1.14)
    likelier, idle = (tried("stribeck_friction", fit=f, parameters=5) for f in (1.115, 1.14))
    over = compared(likelier.structure.fitted, simple.structure.fitted, ASKED)
    assert over.bic_gain > TOGETHER and not worth_refining(over)
    assert label(likelier) in choose([best, simple, likelier], 30, ASKED).probability
    assert label(idle) not in choose([best, simple, idle], 30, ASKED).probability


def test_the_refinement_is_named_when_it_explains_clearly_more():
    simple, refined = tried("coulomb_friction", fit=1.8), tried("stribeck_friction", fit=1.0, parameters=5)
    choice = choose([simple, refined], 30, ASKED)
    assert choice.best is refined and choice.members == (refined,)


@pytest.mark.parametrize("short", [Evidence(9.0, 5.0, 0.9), Evidence(50.0, 1.5, 0.9), Evidence(50.0, 5.0, 0.2)])
def test_a_refinement_needs_evidence_held_out_blocks_and_a_share(short):
    assert worth_refining(better()) and not worth_refining(short)


def test_a_pair_is_labelled_by_both():
    assert label(tried("drift", "null_bias")) == "drift at force + null_bias at force"


def test_where_the_best_leaves_only_noise_the_likelihood_tells_it_from_another_that_closes_nearly_as_much():
    best, other = tried("drift", fit=1.0), tried("null_bias", fit=1.02)
    over = compared(best.structure.fitted, other.structure.fitted, ASKED)
    assert over.bic_gain > TOGETHER and best.evidence.closed - other.evidence.closed < EQUAL
    assert choose([best, other], 30, ASKED).members == (best,)


def test_where_the_noise_holds_what_a_rough_law_leaves_the_likelihood_decides_nothing():
    """A smoothed sign leaves a trace, and whatever is added next fits some of it by chance."""
    rough = dataclasses.replace(ASKED, inexact=True)
    best, other = tried("dead_time", select=1.0), tried("drift", fit=1.02, select=1.0)
    assert compared(best.structure.fitted, other.structure.fitted, ASKED).bic_gain > UNLIKELY
    assert choose([best, other], 30, ASKED).members == (best,)
    choice = choose([best, other], 30, rough)
    assert choice.members == (best, other) and choice.probability[label(other)] == pytest.approx(0.5, abs=0.01)


def test_the_finer_form_of_what_is_named_stands_before_a_further_effect_where_both_leave_but_what_a_rough_law_does():
    rough = dataclasses.replace(ASKED, inexact=True)
    further, finer = tried("coulomb_friction", "null_bias", fit=1.0), tried("asymmetric_friction", fit=1.03)
    assert compared(further.structure.fitted, finer.structure.fitted, ASKED).bic_gain > TOGETHER
    choice = choose([further, finer], 30, rough)
    assert choice.best is finer and further in choice.members  # it may as well be that
    assert choose([further, finer], 30, ASKED).best is further
    short = tried("asymmetric_friction", fit=1.3)  # it leaves more than the law does
    assert choose([further, short], 30, rough).best is further


@pytest.mark.parametrize(("outputs", "members"), [(1, 2), (2, 1)])
def test_a_delay_of_the_only_input_or_of_the_only_output_is_a_class(outputs, members):
    u = np.linspace(0, 1, N)[:, None]
    y = np.zeros((N, 2))
    y[:, outputs:] = np.nan
    asked = Question((Recording("run", None, np.arange(N) * 0.01, u, y),), (), np.array([1.0, 1.0]))
    late = [tried("dead_time"), tried("sensor_delay", fit=1.3)]
    assert [_late_somewhere(t, asked) for t in late] == [members == 2] * 2
