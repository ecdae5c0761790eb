"""Groups of thousands and decimal signs: told by the whole file, or refused."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError
from tests.records.whole import whole

POINT, COMMA = "time [s],x [1]\n", "time [s];x [1]\n"


def read(tmp_path, text, **options):
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")
    record = whole(path, **options)
    return record.time.tolist(), record["x"].tolist()


@pytest.mark.parametrize(
    ("text", "values"),
    [
        (COMMA + "0;35.491\n0,01;35.397\n", [35491, 35397]),
        (COMMA + "0;-1.234\n0,5;-35.397,5\n", [-1234, -35397.5]),
        (COMMA + "0;999\n0,5;1.234.567\n", [999, 1234567]),
        (COMMA + "0;1.234.567\n1;35.397\n", [1234567, 35397]),
        (COMMA + "0;1,234.5\n1;12,345\n", [1234.5, 12345]),
        (POINT + '0.0,"1,234.5"\n0.1,999\n', [1234.5, 999]),
        (POINT + '"0,5","12,345"\n"1,5","1.234,5"\n', [12.345, 1234.5]),
        (COMMA + "0;1'234.5\n1;999\n", [1234.5, 999]),
        (COMMA + "0;1\u2019234,5\n0,1;999\n", [1234.5, 999]),
        (COMMA + "0;1 234,5\n0,1;-12 999,25\n", [1234.5, -12999.25]),
        (COMMA + "0;1\u202f234,5\n0,1;1\u00a0234\u00a0567\n", [1234.5, 1234567]),
        (POINT + '0.5,"12,34,567.5"\n1,"1,00,000"\n', [1234567.5, 100000]),
        (COMMA + "0;1,5e3\n1;2,234E-3\n", [1500, 2.234e-3]),
        (COMMA + "0.000;12.345\n0.010;13.456\n", [12.345, 13.456]),
        (COMMA + "0;1\n0,5;2,5\n", [1, 2.5]),
        (POINT + "0,12.345\n1,13.456\n", [12.345, 13.456]),
    ],
)
def test_thousands_are_told_by_the_decimal_sign_of_the_whole_file(text, values, tmp_path):
    assert read(tmp_path, text)[1] == values


@pytest.mark.parametrize("sign", [".", ","])
def test_a_file_that_does_not_tell_its_decimal_sign_is_refused_until_it_is_stated(sign, tmp_path):
    text = COMMA + f"0;35{sign}491\n1;35{sign}397\n"
    with pytest.raises(DataError, match=rf"a.csv: row 2, column 2: '35\{sign}491' may be 35491 or 35.491.*# decimal="):
        read(tmp_path, text)
    assert read(tmp_path, text, decimal=sign)[1] == [35.491, 35.397]
    assert read(tmp_path, text, decimal="." if sign == "," else ",")[1] == [35491, 35397]
    assert read(tmp_path, f"# rig 7\n# decimal={sign}\n{text}")[1] == [35.491, 35.397]
    with pytest.raises(DataError, match="decimal: not a decimal sign"):
        read(tmp_path, text, decimal=";")


def test_quoted_groups_without_another_number_are_doubtful_too(tmp_path):
    with pytest.raises(DataError, match=r"'12,345' may be 12345 or 12\.345"):
        read(tmp_path, POINT + '0,"12,345"\n1,"13,456"\n')


@pytest.mark.parametrize("cell", ["35.49", "0.491", "12.34,5", "1,234.567", "1234.567", "1.2345", "1 23,5", ".123"])
def test_a_sign_that_groups_no_three_digits_is_refused_in_its_cell(cell, tmp_path):
    with pytest.raises(DataError, match=r"row 3, column 'x': not a number .* decimal comma; '\.' may only part groups"):
        read(tmp_path, COMMA + f"0,5;1,5\n1;{cell}\n")


def test_a_large_file_with_groups_is_read_as_a_small_one(tmp_path):
    rng = np.random.default_rng(1)
    values = np.round(rng.uniform(0, 1e5, 150_000), 1)
    cells = [f"{v:,.1f}".translate(str.maketrans(",.", ".,")) for v in values]
    rows = "".join(f"{k};{cell}\n" for k, cell in enumerate(cells))
    assert len(rows) > 2_000_000
    assert read(tmp_path, COMMA + rows)[1] == values.tolist()


@pytest.mark.parametrize("cell", ["1.03.491", "12.34.567", "1.2.345", "1234.567.891"])
@pytest.mark.parametrize("stated", ["# decimal=,\n", ""])
def test_points_that_part_no_groups_of_three_are_refused(cell, stated, tmp_path):
    with pytest.raises(DataError, match=rf"column 'x': not a number \(got '{cell}'\)"):
        read(tmp_path, f"{stated}{COMMA}0,5;{cell}\n1,5;35.397\n")


@pytest.mark.parametrize("minus", ["\u2212", "\u2013", "\ufe63", "\uff0d"])
@pytest.mark.parametrize(
    ("text", "values"),
    [
        (COMMA + "0;M35,5\n1;M35,4\n", [-35.5, -35.4]),
        (COMMA + "0;M1.234,5\n1;7,5eM3\n", [-1234.5, 7.5e-3]),
        (POINT + "0,M35.5\n1,1\n", [-35.5, 1]),
    ],
)
def test_the_minus_of_a_word_processor_is_a_minus(minus, text, values, tmp_path):
    assert read(tmp_path, text.replace("M", minus))[1] == values


def test_where_the_other_sign_may_be_the_decimal_one_the_error_says_how_to_state_it(tmp_path):
    with pytest.raises(DataError, match=r"got '~35,5'.*Or state the other sign: --decimal ',', or '# decimal=,'"):
        read(tmp_path, COMMA + "0;~35,5\n1;~35,4\n")
