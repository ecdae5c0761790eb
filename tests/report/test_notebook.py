"""What a notebook shows: small HTML that holds the object's numbers, and the figures of the page."""

from __future__ import annotations

import dataclasses
from html.parser import HTMLParser

import numpy as np
import plotly.graph_objects as go
import pytest

import hydrotwin as ht
from hydrotwin.comparison.notices import notices
from hydrotwin.discovery.answer.going_on import experiment_sentence
from hydrotwin.identification.fit import Finding, Fit, FittedParameter, OutputResidual
from hydrotwin.models.language import Model
from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.summary_html import NOTES, ROWS, SmallTable, summary_html
from hydrotwin.records import Record
from hydrotwin.simulation.control import Accuracy
from tests.report import gap_discoveries
from tests.report.gap_discoveries import Motor

LIMIT = 20_000  # characters


class Parsed(HTMLParser):
    """Rows of cell texts, all text, and the names of the tags; tags must close in order."""

    def __init__(self, text):
        super().__init__()
        self.rows, self.text, self.tags, self.open = [], "", set(), []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data
        if self.open and self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data

    def row(self, *start):
        """The rest of the only row that starts so."""
        (found,) = [r for r in self.rows if tuple(r[: len(start)]) == start]
        return found[len(start) :]


def shown(found) -> Parsed:
    text = found._repr_html_()
    assert len(text) < LIMIT
    parsed = Parsed(text)
    assert parsed.tags <= {"div", "strong", "p", "table", "caption", "thead", "tbody", "tr", "th", "td"}
    return parsed


def close(text, value):
    """Shown with four digits."""
    return float(text) == pytest.approx(value, rel=1e-3)


def fit(explained=True, **more):
    rows = [
        FittedParameter("motor.gain", 119.74, 100.0, 0.05, "rad/(s.V)", (0, 1e3), False),
        FittedParameter("volume", 1e-4, 8e-5, np.nan, "m3", (0, 1e-4), True),
    ]
    left = [
        OutputResidual(name, "speed", role, rmse, 2.0, "rad/s", count, (rmse / 2.0) ** 2, 0.0, 0.5, True)
        for name, role, rmse, count in (
            ("run_1", "train", 1.9 if explained else 8.0, 300),
            ("run_2", "validate", 3.0, 100),
            ("run_3", "validate", 5.0, 300),
        )
    ]
    none, model = np.full((2, 2), np.nan), Model(Motor())
    values = (tuple(rows), none, none, none, {"speed": 2.0}, 1.0, 270.75, 298, (), tuple(left))
    findings = (Finding("far", (), "identify: <b>gain</b> moved far."),)
    return Fit("toy", model.flat, *values, findings, (), True, "converged", 1.0)


def test_a_comparison_shows_its_means_and_which_model_is_best(comparison):
    html = shown(comparison)
    for score in comparison.ranking("arm_angle"):
        rmse, largest, unit, fit_percent, count = html.row("arm_angle", score.model)
        assert close(rmse, score.rmse) and close(largest, score.maximum) and close(fit_percent, score.fit_percent)
        assert (unit, count) == ("rad", str(score.recordings))
    assert f"{comparison.ranking('arm_angle')[0].model} on arm_angle" in html.text
    assert "Toys </script> & more" in html.text  # as text


def test_a_record_shows_the_range_of_each_signal_and_what_is_unknown():
    wave = np.sin(np.linspace(0, 20, 101))
    signals = {"a": np.where(np.arange(101) < 3, np.nan, wave), "lost": np.full(101, np.nan)}
    html = shown(Record(np.linspace(0, 5, 101), signals, {"a": "rad", "lost": "1"}, "<img src=x>", tags={"load": "2"}))
    unit, *told, unknown = html.row("a")
    assert (unit, unknown) == ("rad", "3")
    assert [float(v) for v in told] == pytest.approx([wave[3:].min(), wave[3:].mean(), wave[3:].max()], rel=1e-3)
    assert html.row("lost") == ["1", "–", "–", "–", "101"]
    assert "a has no value in 3 of 101 samples." in html.text
    assert "<img src=x>" in html.text and "load: 2" in html.text and "period [s]: 0.05" in html.text


def test_a_record_lists_gaps_and_columns_that_were_left_out_as_the_screen_does(tmp_path):
    lines = [f"{t},{t:g},{t:g},{'broken' if t == 3 else t},press" for t in (*range(20), *range(100, 120))]
    (tmp_path / "run.csv").write_text("\n".join(["time [s],a [V],b,c [V],machine", *lines]), encoding="utf-8")
    record = ht.read_record(tmp_path / "run.csv")
    html = shown(record)
    assert set(record.refused) == {"b", "c", "machine"}
    assert html.row("b") == [""] and html.row("machine") == ["press"]
    assert "no samples from 19 s to 100 s." in html.text and record.understood in html.text
    assert "b" in html.text and all(why.split(": ", 1)[1][:80] in html.text for why in record.refused.values())
    assert str(tmp_path) not in html.text.split(record.understood)[-1]


def test_a_fit_shows_values_sigmas_errors_and_whether_more_than_noise_is_left():
    html = shown(fit())
    assert html.row("motor.gain") == ["100", "119.7", "0.05", "rad/(s.V)", ""]
    assert html.row("volume")[2:] == ["–", "m3", "at bound"]
    assert close(html.row("validate", "speed")[0], np.sqrt((100 * 3.0**2 + 300 * 5.0**2) / 400))  # pooled
    assert "Nothing but noise is left in training." in html.text and "<b>gain</b> moved" in html.text
    assert "More than noise is left on speed." in shown(fit(explained=False)).text
    vague = dataclasses.replace(fit(), accuracy=Accuracy(0.02, "speed", 1.0, {"speed": 1.0}, "explicit", 1e-3))
    assert "The runs are not accurate: half the step changes speed by 0.02" in shown(vague).text


def test_a_comparison_shows_what_the_report_says_first(comparison):
    html = shown(comparison)
    told = notices(comparison)
    assert told and all(text[:200] in html.text for text in told)


def test_a_model_shows_its_signals_and_parameters():
    html = shown(Model(Motor()))
    assert html.row("command") == ["input", "V", "command of the drive"]
    assert html.row("motor_speed") == ["output", "rad/s", "speed of the motor"]
    assert html.row("gain")[:2] == ["120", "rad/(s.V)"]


@pytest.mark.parametrize("make", ["named", "one_of_a_class", "none", "unknown", "two_effects"])
def test_a_discovery_shows_its_answer_effects_and_errors(make):
    found = getattr(gap_discoveries, make)()
    html = shown(found)
    assert found.answer[:300] in html.text
    assert all(str(f).removeprefix("gap: ")[:80] in html.text for f in found.findings)
    assert (experiment_sentence(found)[:100] in html.text) or not any(s.is_class for s in found.steps)
    for step in found.steps:
        others = [m for m in step.members if m != (step.effect, step.site)]
        assert all(html.row(f"or {effect}", site) == ["–", "–"] for effect, site in others)
        assert close(html.row(step.title, step.site)[0], 100 * step.probability)
        assert all(close(html.row(p.name)[0], p.value) for p in step.parameters)
    for role, gaps in found.outputs.items():
        for gap in gaps:
            before, after, *_ = html.row(role, gap.output)
            assert close(before, gap.rmse_before) and close(after, gap.rmse_after)


def test_what_is_long_is_cut_and_said_to_be():
    wide = SmallTable("", ["&" * 500] * 6, [["&" * 500] * 6] * 300)
    text = summary_html("&" * 500, "&" * 5000, {}, [wide], ["&" * 5000] * 50)
    html = Parsed(text)
    assert (
        len(html.rows) == 1 + ROWS and f"and {300 - ROWS} more" in html.text and f"and {50 - NOTES} more" in html.text
    )
    assert len(html.text) < 10_000


def test_figures_are_those_of_the_page_with_the_numbers_of_the_comparison(comparison):
    found = ht.figures(comparison)
    assert all(isinstance(f, go.Figure) for f in found.values())
    overlay = found["arm_angle-free-run-validation_1"]
    record = next(r for r in comparison.records if r.name == "validation_1")
    measured = next(line for line in overlay.data if line.name == "measured")
    np.testing.assert_allclose(measured.x, record.time, rtol=1e-6)
    np.testing.assert_allclose(measured.y, np.degrees(record["arm_angle"]), rtol=1e-6)
    assert overlay.layout.yaxis.title.text == "arm_angle [°]"
    assert {line.name for line in overlay.data} >= set(comparison.models)
    assert len([name for name in found if name.startswith("bars-")]) == 6  # two modes, three outputs


def test_a_discovery_and_a_fit_have_figures_and_a_model_has_none():
    assert {"waterfall", "shifts"} <= set(ht.figures(gap_discoveries.named()))
    assert list(ht.figures(fit())) == ["fit-intervals"]
    with pytest.raises(DeclarationError, match="a Model has none"):
        ht.figures(Model(Motor()))
