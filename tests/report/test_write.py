"""The three files of a report: the same numbers, readable units, honest about what failed."""

from __future__ import annotations

import dataclasses
import html
import json
import re
import sys
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from plotly.offline import get_plotlyjs

from hydrotwin.comparison import Wanted, acceptance, compare
from hydrotwin.identification.fit import Finding
from hydrotwin.models.language.errors import DataError
from hydrotwin.report import Note, answer, comparison_page, display_units, styles, write_report
from hydrotwin.report.comparison_figures import overlay_groups
from hydrotwin.report.fit import fit_section, fit_warning
from hydrotwin.report.provenance import command_line
from tests.comparison.toys import ANGLE, COMMAND, SPEED, Toy, recording
from tests.report.page_figures import unpacked


@pytest.fixture(scope="module")
def data(report):
    return json.loads(report["json"].read_text(encoding="utf-8"))


def html_tables(text):
    """Rows of cell texts by table id."""
    tables = {}
    for match in re.finditer(r'<table id="table-([^"]+)".*?<tbody>(.*?)</tbody>', text, re.DOTALL):
        rows = re.findall(r"<tr>(.*?)</tr>", match[2], re.DOTALL)
        cells = [re.findall(r'<span class="text">(.*?)</span>', row, re.DOTALL) for row in rows]
        tables[match[1]] = [[html.unescape(c) for c in row] for row in cells]
    return tables


def markdown_tables(text):
    """Rows of cell texts of each table, in order."""
    tables, rows = [], []
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            rows.append([c.strip().replace("\\|", "|").strip("*") for c in re.split(r"(?<!\\)\|", line)[1:-1]])
        elif rows:
            tables.append(rows[2:])
            rows = []
    return tables


def test_html_markdown_and_json_hold_the_same_rows(report, data):
    page = html_tables(report["html"].read_text(encoding="utf-8"))
    expected = {k: [[c["shown"] for c in row.values()] for row in t["rows"]] for k, t in data["tables"].items()}
    assert page == expected
    assert markdown_tables(report["markdown"].read_text(encoding="utf-8")) == list(expected.values())
    assert len(expected) > 12


def test_json_is_si_and_agrees_with_the_comparison(comparison, data):
    for written, score in zip(data["scores"], comparison.scores, strict=True):
        assert written["rmse"] == score.rmse
        assert written["unit"] == score.unit
    (best,) = [b for b in data["best"] if b["output"] == "pressure_cap" and b["mode"] == "free run"]
    ranking = comparison.ranking("pressure_cap")
    assert (best["model"], best["rmse"], best["next"]) == (ranking[0].model, ranking[0].rmse, ranking[1].model)


def test_tables_show_engineering_units_of_the_si_values(data):
    table = data["tables"]["scores_free_run_arm_angle"]
    (column,) = [c for c in table["columns"] if c["key"] == "rmse"]
    assert (column["unit"], column["shown_unit"]) == ("rad", "deg")
    for row in table["rows"]:
        assert float(row["rmse"]["shown"]) == pytest.approx(np.degrees(row["rmse"]["value"]), abs=1e-4)
    pressure = data["tables"]["scores_free_run_pressure_cap"]
    assert {c["shown_unit"] for c in pressure["columns"] if c["key"] == "mae"} == {"bar"}
    assert {c["shown_unit"] for c in data["tables"]["headline"]["columns"] if c["key"] == "motor_speed"} == {"rpm"}


def test_tables_are_sorted_and_mark_the_best(data):
    rows = data["tables"]["scores_free_run_motor_speed"]["rows"]
    rmse = [r["rmse"]["value"] for r in rows]
    assert rmse == sorted(rmse)
    assert rows[0]["rmse"]["best"]
    assert "best" not in rows[-1]["rmse"]


def test_the_answer_names_winner_size_and_margin(data):
    assert data["answer"].startswith("In free run, identified physics is best on all 3 outputs: arm_angle RMSE 0.0")
    assert re.search(r"\d+ times smaller than that of network \(0\.\d+°\)\.$", data["answer"])


def test_a_failure_is_on_the_first_screen_and_in_its_table(report, data):
    assert "formula failed in free run on validation_3 and in one step on validation_3" in data["notices"][0]
    assert len(data["tables"]["failures"]["rows"]) == 2
    (row,) = [r for r in data["tables"]["headline"]["rows"] if r["model"]["value"] == "formula"]
    assert row["recordings"]["shown"] == "2 of 3"


def test_the_fit_shows_start_value_interval_shift_and_bound(data):
    gain, oil, volume = data["tables"]["fit_parameters"]["rows"]
    assert [gain[k]["shown"] for k in ("start", "value", "low", "high")] == ["100.0", "119.7", "119.6", "119.8"]
    assert oil["unit"]["shown"] == "bar"
    assert oil["low"]["value"] == pytest.approx(1.62e9 - 1.96 * 4e7, rel=1e-4)
    assert float(oil["shift"]["shown"].replace("−", "-")) == pytest.approx(-7.27, abs=0.01)
    assert (volume["remark"]["shown"], volume["low"]["value"], volume["low"]["shown"]) == ("at bound", None, "–")


def test_the_fit_says_what_is_explained_and_what_not(report):
    text = report["markdown"].read_text(encoding="utf-8")
    assert "Explained down to the noise: arm_angle. Not explained: pressure_cap." in text
    assert "3.0 times its noise: 88.9 % of the error's power is not sensor noise" in text
    assert "\nmotor.gain and pump.displacement cannot be told apart." in text


def test_a_fit_that_estimates_starts_says_why_its_errors_differ_from_the_scores(fit):
    estimated = SimpleNamespace(role="train", start={"arm.angle": 0.1})
    section = fit_section(SimpleNamespace(**vars(fit), records=(estimated,)))
    (left,) = (p for p in section.parts if getattr(p, "title", "") == "What the fit explains")
    assert "estimates for each recording (arm.angle)" in left.note
    assert not any("estimates" in getattr(p, "note", "") for p in fit_section(fit).parts)


def test_residuals_say_what_each_model_explains(data):
    rows = {r["model"]["value"]: r for r in data["tables"]["explained"]["rows"]}
    assert rows["identified physics"]["motor_speed"]["shown"] == "only noise"
    assert re.fullmatch(r"[\d.]+ × noise, follows motor_speed", rows["catalogue physics"]["motor_speed"]["shown"])
    assert rows["network"]["pressure_cap"]["shown"] == "–"
    assert "hold last sample" not in rows


def test_provenance_names_hashes_versions_command_and_date(data):
    rows = {r["record"]["value"]: r for r in data["tables"]["recordings"]["rows"]}
    assert rows["validation_2"]["sha256"]["value"] == f"{2:064x}"
    made = {r["item"]["value"]: r["value"]["value"] for r in data["tables"]["made"]["rows"]}
    assert made["date"] == "2026-03-04T05:06:07+00:00"
    assert made["command"] == "hydrotwin compare toys.toml"
    assert {"python", "numpy", "casadi", "hydrotwin"} <= set(made)


def test_the_page_loads_nothing_from_elsewhere(report):
    text = report["html"].read_text(encoding="utf-8")
    assert not re.search(r"(src|href)=\"(?!#|data:)", text)
    assert not re.search(r"@import|url\(", text)
    assert text.count("plotly.js v") == 1


def test_plotly_is_packed_whole_and_its_licence_stays_readable(report):
    text = report["html"].read_text(encoding="utf-8")
    assert unpacked(text, "library") == [get_plotlyjs()]
    assert "Licensed under the MIT license" in text


def test_every_table_and_plot_has_a_name_and_headings_skip_no_level(report):
    text = report["html"].read_text(encoding="utf-8")
    levels = [int(level) for level in re.findall(r"<h([1-6])[ >]", text)]
    assert levels[0] == 1 and all(b <= a + 1 for a, b in pairwise(levels))
    plots = re.findall(r'<div class="plot"[^>]*>', text)
    assert plots and all(re.search(r'aria-label="Plot of [^"]+"', plot) for plot in plots)
    assert all(re.search(r'aria-label="[^"]+"', table) for table in re.findall(r"<table[^>]*>", text))
    assert text.count('<th scope="') == text.count("<th ")


def test_a_title_with_markup_cannot_break_the_page(report):
    text = report["html"].read_text(encoding="utf-8")
    assert "<h1>Toys &lt;/script&gt; &amp; more</h1>" in text
    assert "Toys </script>" not in text


def test_names_with_markup_stand_in_the_markdown_letter_by_letter(tmp_path):
    """What a pull request shows leaves out tags that it does not know, and stars in pairs."""
    record = recording(1, name="<script>a*b*</script>")
    found = compare([Toy("<i>x</i>\ny"), Toy("<old>", gain=130.0)], [record], repeats=0, modes=("free run",))
    wanted = Wanted(("<script>a*b*</script>: arm_angle.rmse < 900 deg",))
    found = dataclasses.replace(found, title="<b>Press</b>\nline 2")
    text = write_report(found, tmp_path, accepted=acceptance(found, wanted))["markdown"].read_text(encoding="utf-8")
    assert text.startswith("# \\<b>Press\\</b> line 2\n")
    assert "| \\<script>a\\*b\\*\\</script>: arm_angle.rmse < 900 deg | PASS |" in text
    assert "| \\<i>x\\</i> y |" in text and "better than" not in text
    assert not re.search(r"(?<!\\)<[A-Za-z/!?]", text)


def test_the_same_comparison_gives_the_same_files(comparison, fit, report, tmp_path):
    from tests.report.conftest import DATE

    again = write_report(comparison, tmp_path, fits=[fit], command="hydrotwin compare toys.toml", date=DATE)
    for kind, path in again.items():
        assert path.read_bytes() == report[kind].read_bytes(), kind


def test_long_recordings_keep_the_page_small_and_the_numbers_whole(tmp_path):
    records = [recording(k, duration=80.0, period=1e-3) for k in (1, 2, 3)]
    models = [Toy("a"), Toy("b", gain=121.0), Toy("c", gain=122.0), Toy("d", lag=0.04)]
    comparison = compare(models, records, repeats=1)
    paths = write_report(comparison, tmp_path)
    assert paths["html"].stat().st_size < 5e6
    data = json.loads(paths["json"].read_text(encoding="utf-8"))
    assert {s["samples"] for s in data["scores"]} == {80_000}


def test_a_failed_write_leaves_the_old_file_whole(comparison, tmp_path, monkeypatch):
    paths = write_report(comparison, tmp_path)
    before = paths["json"].read_bytes()

    def no_space(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr("os.replace", no_space)
    with pytest.raises(DataError, match="no space"):
        write_report(comparison, tmp_path)
    assert paths["json"].read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["compare.json", "report.html", "report.md"]


def test_a_comparison_where_everything_failed_is_still_a_report(tmp_path):
    comparison = compare([Toy("fragile", fails_on="validation_1")], [recording(1)])
    paths = write_report(comparison, tmp_path)
    data = json.loads(paths["json"].read_text(encoding="utf-8"))
    assert data["answer"].startswith("No model could be scored")
    assert data["failures"][0]["sentence"].endswith("Try a smaller step.")


def test_a_model_that_is_told_more_than_the_others_is_named(tmp_path):
    informed = Toy("informed", gain=121.0)
    informed.inputs = (COMMAND, SPEED)
    paths = write_report(compare([Toy("command only"), informed], [recording(1)]), tmp_path)
    facts = json.loads(paths["json"].read_text(encoding="utf-8"))["facts"]
    assert "Not all models see the same inputs: informed is given motor_speed as well." in facts


def test_a_model_that_is_too_good_to_be_true_is_a_notice(tmp_path):
    cheat = Toy("cheat")
    cheat.one_step = lambda record: cheat._record(record, record.signals)
    paths = write_report(compare([cheat], [recording(1)]), tmp_path)
    (notice,) = json.loads(paths["json"].read_text(encoding="utf-8"))["notices"]
    where = ", ".join(f"{name} (validation_1)" for name in ("arm_angle", "motor_speed", "pressure_cap"))
    assert notice.startswith(f"cheat is too good to be true one step ahead on {where}: its error")


def test_a_single_model_and_recording_needs_no_rival(tmp_path):
    paths = write_report(compare([Toy("only")], [recording(1)], modes=["free run"]), tmp_path)
    answer = json.loads(paths["json"].read_text(encoding="utf-8"))["answer"]
    assert re.fullmatch(r"In free run, only is best on all 3 outputs: arm_angle RMSE 0\.\d+°\.", answer)


def facts_of(contenders, folder):
    data = json.loads(write_report(compare(contenders, [recording(1)]), folder)["json"].read_text(encoding="utf-8"))
    return data, " ".join([data["answer"], *data["facts"]])


def test_an_exported_copy_is_no_rival_of_its_model(tmp_path):
    data, said = facts_of(
        [Toy("mine", gain=121.0), Toy("catalogue", gain=126.0), Toy("exported", "fmu", gain=121.0)], tmp_path
    )
    assert "mine is best on all 3 outputs" in data["answer"] and "that of catalogue" in data["answer"]
    assert "exported gives exactly the outputs of mine." in said
    assert {w["model"] for w in data["best"]} == {"mine"} and {w["next"] for w in data["best"]} == {"catalogue"}


def test_a_copy_is_drawn_on_a_click_and_does_not_hide_its_model():
    comparison = compare([Toy("mine", gain=121.0), Toy("exported", "fmu", gain=121.0)], [recording(1)])
    (angle, *_) = overlay_groups(comparison, display_units(comparison), styles(comparison.models))
    drawn = {t["name"]: t["visible"] for t in angle.rows["free run"][0].spec["data"]}
    assert drawn == {"measured": True, "mine": True, "exported": "legendonly"}
    assert "click its name" in comparison_page(comparison).sections[0].lead


def test_a_fit_that_makes_up_for_a_missing_effect_is_a_notice(fit):
    residuals = [SimpleNamespace(**{**vars(fit.residuals[1]), "chi2_per_sample": c}) for c in (1.0, 256.0)]
    biased = SimpleNamespace(**{**vars(fit), "residuals": residuals})
    (notice,) = comparison_page(compare([Toy("a")], [recording(1)]), fits=[biased]).notices
    assert "leaves 16 times the noise on pressure_cap" in notice and "cylinder.cap_dead_volume moved by 25 %" in notice
    still = SimpleNamespace(**{**vars(biased), "parameters": fit.parameters[1:2]})  # moved by 7 %
    assert "moved by" not in fit_warning(still)
    sound = SimpleNamespace(**{**vars(fit), "residuals": residuals[:1]})
    assert fit_warning(sound) == ""


def test_scores_on_the_recordings_of_the_fit_are_not_called_validation():
    records = [recording(1), recording(2)]
    mixed = "2 recordings (1 of them trained on)"
    for train, over in ((records, "2 training recordings"), (records[:1], mixed), ([], "2 validation recordings")):
        page = comparison_page(compare([Toy("a")], records, train_records=train))
        assert f"mean over the {over}; " in page.headline.note


def test_what_is_left_is_told_once(fit):
    finding = Finding("unexplained", (), "identify: the fitted model leaves 3.0 times the noise on pressure_cap.")
    section = fit_section(SimpleNamespace(**{**vars(fit), "findings": (finding, *fit.findings)}))
    notes = [sentence for p in section.parts if isinstance(p, Note) for sentence in p.paragraphs]
    assert not any("the fitted model leaves" in n.lower() for n in notes)
    assert any("cannot be told apart" in n for n in notes) and any("look for a missing effect" in n for n in notes)


def test_what_an_fmu_gives_besides_does_not_make_it_another_model(tmp_path):
    exported = Toy("exported", "fmu", outputs=(ANGLE,))
    run, extra = exported.free_run, {"training_distance": "1"}
    exported.free_run = lambda record: run(record).with_signals({n: 0 * record.time for n in extra}, extra)
    _, said = facts_of([Toy("mine", outputs=(ANGLE,)), exported], tmp_path)
    assert "exported gives exactly the outputs of mine." in said


def test_an_fmu_that_runs_otherwise_is_a_rival_like_any(tmp_path):
    _, said = facts_of([Toy("mine", gain=121.0), Toy("exported", "fmu", gain=121.1)], tmp_path)
    assert "gives the outputs of" not in said and "that of exported" in said


def test_the_first_output_comes_first_in_the_answer(tmp_path):
    angle = Toy("angle", outputs=(ANGLE,), gain=120.0)
    data, _ = facts_of([Toy("all", gain=126.0, drift=1e-3), angle], tmp_path)
    assert data["answer"].startswith("In free run, angle is best on arm_angle")
    assert "; all is best on 2 of 3 outputs: motor_speed" in data["answer"]


def test_outputs_not_scored_for_one_cause_share_a_row(tmp_path):
    records = [recording(k) for k in (1, 2)]
    comparison = compare([Toy("all"), Toy("angle", outputs=(ANGLE,))], records)
    data = json.loads(write_report(comparison, tmp_path)["json"].read_text(encoding="utf-8"))
    (row,) = data["tables"]["unscored"]["rows"]
    assert row["record"]["value"] == "validation_1, validation_2"
    assert row["output"]["value"] == "motor_speed, pressure_cap"
    assert len(data["unscored"]) == 4


def test_the_origin_of_a_model_is_told_in_rows_for_people(tmp_path):
    toy = Toy("fitted")
    files = [{"name": "a", "role": "train", "sha256": "12ab", "source": "/home/somebody/a.csv"}]
    toy.provenance = {"recordings": files, "rmse": {"train": {"angle": 1.23456e-3}}, "seed": 3}
    paths = write_report(compare([toy], [recording(1)]), tmp_path)
    rows = json.loads(paths["json"].read_text(encoding="utf-8"))["tables"]["model_provenance"]["rows"]
    told = [(r["key"]["value"], r["value"]["value"]) for r in rows]
    assert told == [("recordings", "a, train, sha256 12ab"), ("rmse.train", "angle 0.001235"), ("seed", "3")]


def test_python_m_hydrotwin_is_told_as_hydrotwin(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["/somewhere/hydrotwin/__main__.py", "demo", "--out", "my demo"])
    assert command_line() == "hydrotwin demo --out 'my demo'"


def test_who_is_level_with_the_best_is_not_called_the_best():
    """The table marks the one with the smallest number; the sentence must not say another one."""
    found = compare([Toy("a", gain=121.0), Toy("b", gain=121.0)], [recording(1)], modes=("free run",), repeats=0)
    means = [dataclasses.replace(s, rmse=s.rmse * (0.999 if (s.model, s.output) == ("b", "motor_speed") else 1.0))
             for s in found.means]  # fmt: skip
    said = answer(dataclasses.replace(found, means=tuple(means)), display_units(found))
    assert said.startswith("In free run, a is best or level with the best on all 3 outputs: arm_angle")
    assert answer(found, display_units(found)).startswith("In free run, a is best on all 3 outputs: arm_angle")
