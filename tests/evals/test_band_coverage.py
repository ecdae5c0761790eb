"""The proof of bands draws its cases from their seed alone, and counts what it says it counts."""

from __future__ import annotations

from benchmarks.comparison.band_coverage import MISSING, RIGHT, missing_cases, right_cases, table


def row(kind: str, trusted: bool, measured: float, auto: float, **more) -> dict:
    outputs = {"position": {"trusted": trusted, "measured": [measured], "auto": [auto]}}
    return {"case": "spool_valve/one", "kind": kind, "outputs": outputs, **more}


def test_cases_are_drawn_from_their_seed_and_are_of_both_machines():
    many, few = right_cases(40, 801), right_cases(4, 801)
    assert many[:4] == few and [one.case.machine for one in few] == ["cehA", "spool_valve"] * 2
    assert len({one.file for one in many}) == 40 and not any(one.case.effects for one in many)
    hidden = missing_cases(40, 801)
    assert all(len(one.case.effects) == 1 for one in hidden) and len({one.case.effects for one in hidden}) > 15
    assert not {one.file for one in hidden} & {one.file for one in many}


def test_the_table_tells_what_is_covered_by_start_and_what_was_flagged():
    draws = {"output": "position", "ratio": 1.01, "seconds": 3.0, "lost": 0, "outside": []}
    rows = [row(RIGHT, True, 0.8, 0.95, draws=draws), row(RIGHT, True, 0.95, 0.94)]
    rows += [row(MISSING, False, 0.5, 0.5), row(MISSING, True, 0.9, 0.95), row(MISSING, True, 0.9, 0.7)]
    found = table([*rows, {"case": "x", "kind": MISSING, "unreachable": "it cannot be"}])
    assert "| measured | both, 2 | 2 | 50.0 % |" in found and "| auto | both, 2 | 2 | 100.0 % |" in found
    assert "0 of 2 cases have a band that is said not to be trusted" in found
    assert "1 of 1 cases, in which no draw leaves the bounds: median 1.010" in found
    assert "1 of 3 cases flagged" in found and "Of the 2 others 1 of 2 outputs" in found
    assert found.rstrip().endswith("spool_valve/one, position: 70.0 %")
