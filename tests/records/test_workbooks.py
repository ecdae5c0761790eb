"""Workbooks: which sheet, which rows, what a cell is; damaged and absurd ones are refused before memory fills."""

from __future__ import annotations

import datetime
import io
import sys
import zipfile

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError
from hydrotwin.records import read_record

openpyxl = pytest.importorskip("openpyxl")
pytest.importorskip("python_calamine")
from hydrotwin.records.workbook import read_sheet, read_workbook  # noqa: E402

START = datetime.datetime(2026, 5, 4, 10, 0, 0, 250_000)
STEP = datetime.timedelta(milliseconds=10)


def book(tmp_path, **sheets):
    path, workbook = tmp_path / "a.xlsx", openpyxl.Workbook()
    workbook.remove(workbook.active)
    for name, rows in sheets.items():
        sheet = workbook.create_sheet(name)
        for row in rows:
            sheet.append(row)
    workbook.save(path)
    return path


def test_a_plain_sheet_is_a_recording(tmp_path):
    rows = [["time [s]", "p [bar]", "n [1/min]"], [0, 1.5, 60], [0.01, 2.5, 120], [0.02, 3.5, 180]]
    record = read_record(book(tmp_path, Data=rows))
    np.testing.assert_allclose(record.time, [0, 0.01, 0.02])
    np.testing.assert_allclose(record["p"], [1.5e5, 2.5e5, 3.5e5])


def test_the_sheet_with_most_numbers_is_read_and_the_others_are_named(tmp_path):
    data = [["Zeit [s]", "p [bar]"], *([k / 100, k] for k in range(50))]
    path = book(tmp_path, Info=[["Prüfstand", 3], ["Datum", START]], Messung=data, Diagramm=[[1, 2, 3]])
    sheet = read_sheet(path)
    assert (sheet.name, sheet.others) == ("Messung", ("Info", "Diagramm"))
    assert sheet.title == "sheet 'Messung' (others: Info, Diagramm)"
    assert read_workbook(path).header == "sheet 'Messung' (others: Info, Diagramm), row 1"


def test_rows_keep_their_place_and_cells_their_type(tmp_path):
    rows = [["Messung 7"], [], [None, " Zeit ", "Tag", "Uhr", "Dauer", "an"]]
    rows += [
        [None, 1, START.date(), datetime.time(3, 4, 5, 250_000), datetime.timedelta(hours=30, milliseconds=5), True]
    ]
    rows += [[None, 0.5, START, None, "n/a", False]]
    found = read_sheet(book(tmp_path, A=rows)).rows
    assert [row[0] for row in found] == ["Messung 7", None, None, None, None]
    assert found[2][1:] == ["Zeit", "Tag", "Uhr", "Dauer", "an"]
    assert found[3][1:] == [1.0, "2026-05-04", "03:04:05.250000", "30:00:00.005000", 1.0]
    assert found[4][1:] == [0.5, START, None, "n/a", 0.0]
    assert all(type(row[1]) is float for row in found[3:])


@pytest.mark.parametrize("units", [["s", "bar", "-"], ["[s]", "[bar]", None], ["(s)", "(bar)", "(1)"]])
def test_titles_above_and_units_below_the_names(units, tmp_path):
    rows = [["Versuch 12"], ["Prüfer", "Meier"], [], ["Zeit", "Druck", "ok"], units, [0, 1.5, True], [0.01, None, True]]
    table = read_workbook(book(tmp_path, A=rows))
    assert [(c.name, c.unit) for c in table.columns[:2]] == [("Zeit", "s"), ("Druck", "bar")]
    np.testing.assert_array_equal(table.columns[1].values, [1.5, np.nan])
    assert table.header == "sheet 'A', row 4" and [table.row(k) for k in (0, 1, 2)] == [6, 7, 8]


@pytest.mark.parametrize("how", ["date and time", "time of day", "date and time of day", "text"])
def test_date_times_and_times_of_day_are_the_time(how, tmp_path):
    stamps = [START + k * STEP for k in range(4)]
    cells = {
        "date and time": [[s] for s in stamps],
        "time of day": [[s.time()] for s in stamps],
        "date and time of day": [[s.time(), s.date()] for s in stamps],
        "text": [[f"{s:%d.%m.%Y %H:%M:%S.%f}"] for s in stamps],
    }[how]
    names = ["Zeit", "Datum"][: len(cells[0])]
    record = read_record(book(tmp_path, A=[[*names, "p [bar]"], *([*c, k] for k, c in enumerate(cells))]))
    np.testing.assert_allclose(record.time - record.time[0], [0, 0.01, 0.02, 0.03], atol=1e-12)
    np.testing.assert_allclose(record["p"], np.arange(4) * 1e5)


def test_a_text_costs_only_its_column(tmp_path):
    rows = [["time [s]", "p [bar]", "mode", "x [mm]"], [0, 1, "auto", 0], [1, 2, "auto", 1], [2, "n/a", "hand", 2]]
    record = read_record(book(tmp_path, A=[*rows, *([k, k, "hand", k] for k in range(3, 9))]))
    np.testing.assert_allclose(record["x"], np.arange(9) * 1e-3)
    for name in ("p", "mode"):
        with pytest.raises(DataError, match=rf"a.xlsx: .*column '{name}'"):
            record[name]


def test_a_sheet_that_is_named_is_read(tmp_path):
    data = [["time [s]", "p [bar]"], *([k, k] for k in range(50))]
    path = book(tmp_path, Messung=data, Kurz=[["time [s]", "x [mm]"], [0, 1], [1, 2]])
    assert read_record(path).names == ("p",)
    record = read_record(path, sheet="Kurz")
    assert record.names == ("x",) and "sheet 'Kurz' (others: Messung), names in row 1" in record.understood
    with pytest.raises(DataError, match=r"no sheet 'Krz'. Did you mean 'Kurz'"):
        read_record(path, sheet="Krz")


def test_a_sheet_without_numbers_is_refused(tmp_path):
    for rows in ([], [["Prüfer", "Meier"]]):
        with pytest.raises(DataError, match=r"a.xlsx: "):
            read_record(book(tmp_path, A=rows))


def test_the_other_formats_of_a_workbook_are_read(tmp_path):
    path = book(tmp_path, A=[["time [s]", "p [bar]"], [0, 1], [1, 2]]).rename(tmp_path / "a.xlsm")
    np.testing.assert_allclose(read_record(path)["p"], [1e5, 2e5])


@pytest.mark.parametrize("part", [0.0, 0.3, 0.9])
def test_a_truncated_workbook_is_refused(part, tmp_path):
    path = book(tmp_path, A=[["time [s]", "p [bar]"], *([k, k] for k in range(500))])
    path.write_bytes(path.read_bytes()[: int(part * path.stat().st_size)])
    with pytest.raises(DataError, match=r"a.xlsx: .*[Cc]opy") as error:
        read_sheet(path)
    assert len(str(error.value)) < 500


def test_a_cell_far_outside_is_refused_before_it_fills_the_memory(tmp_path):
    path, workbook = tmp_path / "a.xlsx", openpyxl.Workbook()
    workbook.active["A1"], workbook.active["XFD1048576"] = "time [s]", 1
    workbook.save(path)
    with pytest.raises(DataError, match=r"reaches to row 1048576 in 16384 columns.*Delete what lies outside"):
        read_sheet(path)


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr("hydrotwin.records.workbook._UNPACKED", 1 << 20)
    path = book(tmp_path, A=[["time [s]"], [0], [1]])
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/media/image1.png", bytes(2 << 20))
    with pytest.raises(DataError, match=r"GB when unpacked.*Export it as CSV"):
        read_sheet(path)


def test_a_missing_package_is_told(tmp_path, monkeypatch):
    path = book(tmp_path, A=[["time [s]"], [0]])
    monkeypatch.setitem(sys.modules, "python_calamine", None)
    with pytest.raises(DataError, match=r"python-calamine.*hydrotwin\[xlsx\]"):
        read_sheet(path)


def test_a_zip_that_is_no_workbook_is_refused(tmp_path):
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("a.txt", "no workbook")
    (tmp_path / "a.xlsx").write_bytes(content.getvalue())
    with pytest.raises(DataError, match="not a whole Excel file"):
        read_sheet(tmp_path / "a.xlsx")


def open_document(path, rows):
    spaces = " ".join(f'xmlns:{n}="urn:oasis:names:tc:opendocument:xmlns:{n}:1.0"' for n in ("office", "table", "text"))
    sheet = f'<office:spreadsheet><table:table table:name="A">{rows}</table:table></office:spreadsheet>'
    content = f'<office:document-content {spaces} office:version="1.2"><office:body>{sheet}</office:body>'
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("mimetype", "application/vnd.oasis.opendocument.spreadsheet")
        archive.writestr("META-INF/manifest.xml", "<manifest/>")
        archive.writestr("content.xml", f"{content}</office:document-content>")
    return path


NUMBER = '<table:table-cell office:value-type="float" office:value="{0}" {1}><text:p>{0}</text:p></table:table-cell>'


def test_an_open_document_sheet_with_its_endless_empty_rows_is_read(tmp_path):
    name = '<table:table-cell office:value-type="string"><text:p>{0}</text:p></table:table-cell>'
    rows = [[name.format(n) for n in ("Zeit [s]", "p [bar]")]]
    rows += [[NUMBER.format(k / 10, ""), NUMBER.format(k, "")] for k in range(4)]
    body = "".join(f"<table:table-row>{''.join(row)}</table:table-row>" for row in rows)
    endless = '<table:table-cell table:number-columns-repeated="16384"/>'
    body += f'<table:table-row table:number-rows-repeated="1048571">{endless}</table:table-row>'
    record = read_record(open_document(tmp_path / "a.ods", body))
    np.testing.assert_allclose(record.time, [0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(record["p"], np.arange(4) * 1e5)


def test_a_filled_cell_repeated_without_end_is_refused(tmp_path):
    cell = NUMBER.format(1, 'table:number-columns-repeated="16384"')
    body = f'<table:table-row table:number-rows-repeated="1048576">{cell}</table:table-row>'
    with pytest.raises(DataError, match="too many cells"):
        read_record(open_document(tmp_path / "a.ods", body))


def test_numbers_kept_as_texts_have_a_decimal_sign_to_find_or_to_state(tmp_path):
    rows = [["time [s]", "p [bar]"], [0, "1,5"], [0.25, 2.5], [0.5, "3.250,5"]]
    record = read_record(book(tmp_path, Data=rows))
    np.testing.assert_array_equal(record.time, [0, 0.25, 0.5])
    np.testing.assert_allclose(record["p"], [1.5e5, 2.5e5, 3250.5e5])
    doubtful = book(tmp_path, Data=[["time [s]", "p [bar]"], [1e-5, "1,500"], [0.25, "2,500"], [0.5, -1.25]])
    with pytest.raises(DataError, match="row 2, column 2: '1,500' may be 1500 or"):
        read_record(doubtful)
    np.testing.assert_allclose(read_record(doubtful, decimal=",")["p"], [1.5e5, 2.5e5, -1.25e5])
    record = read_record(doubtful, decimal=".")
    np.testing.assert_allclose(record["p"], [1500e5, 2500e5, -1.25e5])
    np.testing.assert_array_equal(record.time, [1e-5, 0.25, 0.5])


def test_a_time_of_day_goes_on_past_midnight(tmp_path):
    path = book(tmp_path, Data=[["time", "p [bar]"], *([(86398 + k) / 86400, k] for k in range(6))])
    workbook = openpyxl.load_workbook(path)
    for row in range(2, 8):
        workbook["Data"].cell(row, 1).number_format = "hh:mm:ss.000"
    workbook.save(path)
    np.testing.assert_allclose(read_record(path).time, np.arange(6), atol=1e-6)


def test_percent_above_a_hundred_are_asked_for_too(tmp_path):
    path = book(tmp_path, Data=[["time [s]", "u [%]"], [0, 0.5], [1, 2.75]])
    with pytest.raises(DataError, match="its unit is % or 1"):
        read_record(path)["u"]


def test_a_truth_value_among_numbers_is_none_of_them(tmp_path):
    rows = [*([k / 10, k + 0.5, k > 2] for k in range(6)), [0.6, True, True]]
    path = book(tmp_path, Data=[["t [s]", "p [bar]", "on [1]"], *rows])
    record = read_record(path)
    assert "not a number (got 'True')" in record.refused["p"] and record["on"].tolist() == [0, 0, 0, 1, 1, 1, 1]
