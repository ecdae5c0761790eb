"""A gap report says of parameters that moved from where to where and why, and warns of those on a bound."""

from __future__ import annotations

from dataclasses import replace

from hydrotwin.discovery.answer.discovery import Shift
from hydrotwin.report import Note, gap_page
from hydrotwin.report.gap_moved import moved_notes, moved_sentences
from tests.report.gap_discoveries import DATE, NAN, named, two_effects


def test_what_moved_by_more_than_two_sigma_is_told_with_from_to_and_why_the_furthest_first():
    told = moved_sentences(named())
    assert len(told) == 4
    assert told[0] == (
        "motor.lag moved from 0.05100\u00a0s to 0.03040\u00a0s (10 standard deviations), because before it stood in "
        "for the missing effect."
    )
    assert told[1].startswith("cylinder.friction.viscous moved from ")
    assert told[1].endswith(", for the same reason.")
    assert "the missing effects." in moved_sentences(two_effects())[0]


def test_a_move_within_two_sigma_is_none():
    still = replace(named(), shifts=(Shift("motor.gain", "1", 1.0, 0.1, 1.19, 0.01),))
    assert moved_sentences(still) == (
        "No free parameter moved by more than two standard deviations of the difference.",
    )


def test_a_move_of_a_well_known_value_gets_the_digits_that_show_it():
    fine = replace(named(), shifts=(Shift("mass", "kg", 1.000001, 1e-8, 1.000003, 1e-8),))
    assert moved_sentences(fine)[0].startswith("mass moved from 1.000001\u00a0kg to 1.000003\u00a0kg (")


def test_many_moves_leave_the_section_readable():
    many = tuple(Shift(f"p{k}", "1", 1.0, 0.01, 2.0 + k, 0.01) for k in range(9))
    told = moved_sentences(replace(named(), shifts=many))
    assert told[0].startswith("p8 moved from 1.000 to 10.00 (")
    assert (len(told), told[-1]) == (7, "3 more parameters moved by more than chance: see the table.")


def test_a_parameter_on_its_bound_is_warned_of_and_not_told_as_a_move():
    moves, bound = moved_notes(two_effects())
    assert not any("cap_dead_volume" in text for text in moves.paragraphs)
    assert bound.tone == "warning"
    assert bound.paragraphs == (
        "cylinder.cap_dead_volume rests on its bound at 1.000\u00a0cm³: read no physics into the value, or widen the "
        "bound.",
    )
    assert len(moved_notes(named())) == 1


def test_the_sentences_stand_before_the_table():
    section = next(s for s in gap_page(named(), command="", date=DATE).sections if s.id == "shifts")
    assert isinstance(section.parts[0], Note)


def test_a_move_of_unknown_size_is_no_sentence():
    lost = replace(named(), shifts=(Shift("mass", "kg", 1.0, NAN, 2.0, NAN),))
    assert moved_sentences(lost) == ("No free parameter moved by more than two standard deviations of the difference.",)
