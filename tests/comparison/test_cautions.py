"""What a criterion says itself of how it was judged: on a server, in a row and in a model file it stands alone."""

from __future__ import annotations

import dataclasses

from hydrotwin.comparison import Wanted, acceptance, compare
from tests.comparison.toys import Toy, recording


def test_a_criterion_that_was_judged_one_step_ahead_says_so_itself():
    """A server and a model file had read the same PASS as that of a free run."""
    asked, said = Wanted(("arm_angle.rmse < 10 deg",)), "judged one step ahead, and not in a free run"
    (free,), (ahead,) = (
        acceptance(compare([Toy("good")], [recording(1)], repeats=0, modes=modes), asked).judged
        for modes in (("free run", "one step"), ("one step", "free run"))
    )
    assert (free.caution, ahead.caution) == ("", said)


def test_a_criterion_that_was_judged_on_what_was_named_as_training_says_so_itself():
    """Of an FMU nothing else tells it."""
    one, other = recording(1), recording(2)
    comparison = compare([Toy("good")], [one, other], repeats=0, modes=("free run",), train_records=[one])
    (judged,) = acceptance(comparison, Wanted(("arm_angle.rmse < 10 deg",))).judged
    assert judged.caution == f"judged on {one.name}, named as what the models were made from, too"


def test_recordings_in_which_nothing_rests_are_named_and_not_left_out_without_a_word():
    """Of ten recordings one with a move had met the criterion for all."""
    comparison = compare([Toy("good")], [recording(1), recording(2)], repeats=0, modes=("free run",))
    values = {"validation_1": 0.01, "validation_2": float("nan")}
    scores = tuple(
        dataclasses.replace(s, settling=values[s.record], steady=values[s.record]) for s in comparison.scores
    )
    known = dataclasses.replace(comparison, scores=scores)
    texts = ("arm_angle.settling < 1 s", "arm_angle.steady < 1 rad", "settling < 1 s", "arm_angle.rmse < 1 rad")
    found = acceptance(known, Wanted(texts))
    assert found.passed
    said = [
        f"not judged on validation_2, where {metric} is not defined" for metric in ("settling", "steady", "settling")
    ]
    assert [one.caution for one in found.judged] == [*said, ""]
