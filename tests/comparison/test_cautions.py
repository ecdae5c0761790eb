"""What a criterion says itself of how it was judged: on a server, in a row and in a model file it stands alone."""

from __future__ import annotations

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
