"""Every figure on a page is in the JSON beside it, or follows from what is: read back and computed again."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin.comparison import PhysicalContender, compare
from hydrotwin.identification import identify
from hydrotwin.identification.constant_speed import fit_stribeck
from hydrotwin.models.language.linearisation import linearise, modes
from hydrotwin.report import write_report
from hydrotwin.report.friction import write_friction_test
from hydrotwin.report.linearisation import write_linearisation
from tests.discovery.slides import NOISE, found, record, records, slide
from tests.report import gap_discoveries
from tests.report.page_figures import (
    FACTOR,
    PERCENT,
    compare_figures,
    gap_figures,
    leaves,
    number,
    numbers_in,
    sentences,
    shows,
)

EFFECTS = ("coulomb_friction", "null_bias")
KEYS = ("model", "record", "mode", "output", "role", "parameter", "name", "label", "candidate")


def read(paths) -> tuple[dict, str]:
    return json.loads(paths["json"].read_text(encoding="utf-8")), paths["markdown"].read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def searched(tmp_path_factory):
    """A real answer: three recordings and one to validate."""
    answer = found(records(3, dry=30.0), EFFECTS, validate=[record(9, dry=30.0)], noise={"speed": NOISE})
    return answer, read(gap_discoveries.written(answer, tmp_path_factory.mktemp("gap")))


@pytest.fixture(scope="module")
def lone(tmp_path_factory):
    """A real answer from one recording, which is cut into pieces."""
    answer = found([record(3, dry=30.0, seconds=20.0)], EFFECTS, noise={"speed": NOISE})
    return answer, read(gap_discoveries.written(answer, tmp_path_factory.mktemp("lone")))


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    """A page as `identify --report` writes it without recordings to validate."""
    runs = records(2)
    fit = identify(slide(), runs, noise={"speed": NOISE}, step=5e-3)
    sides = [PhysicalContender(slide(), "as given"), PhysicalContender(fit.flat, "identified")]
    comparison = compare(sides, runs, train_records=runs)
    return fit, read(write_report(comparison, tmp_path_factory.mktemp("fit"), fits=[fit]))


def same_row(shown: dict, row: dict) -> bool:
    return all(str(row[k]) == shown[k]["shown"] for k in KEYS if k in shown and isinstance(row.get(k), str))


def unit_of(column: dict, row: dict) -> str:
    """The unit that a cell is printed in: that of its column, or of its row."""
    pretty = column["shown_unit"].replace("deg", "°")
    return pretty or (row["unit"]["shown"] if "unit" in row and column["key"] not in PERCENT else "")


def without_unit(text: str) -> tuple[str, str]:
    """The number and the unit of a cell that says both."""
    return re.match(r"([−\d.\u202fe]+)\s?(.*)", text).groups()


def check_tables(data: dict, figures: dict[str, list[dict]]) -> int:
    """Hold every number of every table against its figure; how many there were."""
    seen = 0
    for name, table in data["tables"].items():
        for k, row in enumerate(table["rows"]):
            numeric = [c for c in table["columns"] if isinstance(row[c["key"]]["value"], float | int)]
            if not numeric:
                continue
            assert name in figures, f"nobody computes the figures of {name}"
            rows = [r for r in figures[name] if same_row(row, r)]
            own = rows[0] if len(rows) == 1 else figures[name][k]
            for column in numeric:
                key, text = column["key"], row[column["key"]]["shown"].partition(" × noise")[0]
                if text == "only noise":
                    continue
                assert key in own, f"nobody computes {key} of {name}"
                text = text.removesuffix(" (nothing claimed)")
                text, unit = without_unit(text) if key in ("steady", "u_val") else (text, unit_of(column, row))
                dimensionless = key in ("sigmas", "shift", "ratio", "lag_one", "samples", "times_noise")
                factor = 1.0 if dimensionless else FACTOR.get(unit, 1.0)
                assert shows(text, own[key], factor), f"{name}, row {k}, {key}: {text} for {own[key]} [{unit}]"
                seen += 1
    return seen


def check_sentences(data: dict, told: str, known=(95.0,)) -> int:
    """Every number of the sentences is one of the JSON, in some unit; equations are passed over."""
    for step in data.get("steps", ()):
        told = told.replace(step["equation"], "")
    for row in data.get("candidates", ()):
        told = told.replace(row["equation"], "") if row["equation"] else told
    pool = {*leaves({k: v for k, v in data.items() if k not in ("facts", "notices")}), *known}
    pool |= {r["times_noise"] for rows in gap_figures(data).values() for r in rows if "times_noise" in r}
    found = numbers_in(re.sub(r"(over 99\.9|under 1)\s%", "", told))
    for text in found:
        scales = {1.0} if "%" in text else set(FACTOR.values())
        assert any(shows(text.strip(), v, f) for v in pool for f in scales), f"{text} in {told}"
    return len(found)


def markdown_cells(text: str) -> list[str]:
    rows = [line for line in text.splitlines() if line.startswith("|") and "---" not in line]
    return [c.strip().strip("*") for row in rows for c in re.split(r"(?<!\\)\|", row)[1:-1]]


@pytest.mark.parametrize("case", gap_discoveries.ALL)
def test_every_figure_of_a_gap_page_follows_from_its_json(case, tmp_path):
    data, text = read(gap_discoveries.written(gap_discoveries.ALL[case](), tmp_path))
    assert check_tables(data, gap_figures(data)) > 20
    check_sentences(data, sentences(data))
    printed = set(markdown_cells(text))
    cells = [c["shown"] for t in data["tables"].values() for r in t["rows"] for c in r.values()]
    assert {c.replace("|", "\\|") for c in cells} <= printed


@pytest.mark.parametrize("which", ["searched", "lone"])
def test_every_figure_of_a_real_gap_page_follows_from_its_json(which, request):
    answer, (data, _) = request.getfixturevalue(which)
    assert answer.verdict == "named"
    assert check_tables(data, gap_figures(data)) > 20
    assert check_sentences(data, sentences(data)) > 5


@pytest.mark.parametrize(("which", "given"), [("searched", 4), ("lone", 1)])
def test_a_gap_page_counts_the_recordings_that_were_given_and_the_candidates_that_were_fitted(which, given, request):
    _, (data, text) = request.getfixturevalue(which)
    assert sum(data["given"].values()) == given
    (eyebrow,) = [line for line in text.splitlines() if line.startswith("Gap of ")]
    assert f" · {given} recording{'s' * (given > 1)} · {data['screened']} candidates · " in eyebrow
    assert shows(eyebrow.split(" · ")[3].removesuffix(" s"), data["seconds"])
    fitted = {c["effect"] for c in data["candidates"] if c["left"] is not None}
    assert len(fitted) <= data["fitted"] <= data["screened"]


def test_figures_of_one_thing_in_several_places_of_gap_json_agree(searched):
    """The pooled error is that of the recordings, the named effect that of the fit, the step that of its candidate."""
    _, (data, _) = searched
    samples = {r["record"]: r["samples"] for r in data["fit_records"]}
    for output, pooled in data["train"].items():
        of = [(samples[r["record"]], r["outputs"][output]) for r in data["recordings"] if r["role"] != "report"]
        for key in ("rmse_before", "rmse_after"):
            mean = np.sqrt(sum(n * o[key] ** 2 for n, o in of) / sum(n for n, _ in of))
            assert pooled[key] == pytest.approx(mean, rel=1e-12)
    parameters = {p["name"]: p for p in data["parameters"]}
    for k, step in enumerate(data["steps"], 1):
        (row,) = [c for c in data["candidates"] if c["step"] == k and c["fate"] == "named"]
        assert (row["gap_closed"], row["probability"]) == (step["gap_closed"], step["probability"])
        for name, p in step["parameters"].items():
            assert (p["value"], p["sigma"]) == (parameters[name]["value"], parameters[name]["sigma"])
    for s in data["shifts"]:
        assert s["after"] == parameters[s["name"]]["value"]


def test_the_words_say_on_which_recordings_a_figure_was_taken(searched, lone):
    _, (data, text) = searched
    assert {r["role"] for r in data["recordings"]} == {"fit", "report"}
    assert "of all outputs on the recordings of the fit, as the search left it" in text
    assert "unseen recordings" not in text
    assert "Those of the effects above also allow for the form of the law." in text


def test_every_figure_of_a_comparison_follows_from_its_json(report):
    data, _ = read(report)
    figures = compare_figures(data)
    figures["explained"] = explained(data)
    assert check_tables(data, figures) > 200


def explained(data: dict) -> list[dict]:
    """The worst recording of each model and output."""
    rows = []
    for model in dict.fromkeys(r["model"] for r in data["residuals"]):
        of = [r for r in data["residuals"] if r["model"] == model]
        outputs = dict.fromkeys(r["output"] for r in of)
        worst = {o: max((r["times_noise"] or 0.0) for r in of if r["output"] == o) for o in outputs}
        rows.append({"model": model, **worst})
    return rows


def test_every_figure_of_an_identification_follows_and_nothing_that_was_trained_on_is_called_validation(identified):
    fit, (data, text) = identified
    figures = compare_figures(data)
    figures["explained"] = explained(data)
    assert check_tables(data, figures) > 40
    assert [r["role"] for r in data["recordings"]] == ["train", "train"]
    assert "validation" not in "\n".join(markdown_cells(text)).replace("identification", "")
    (lead,) = [line for line in text.splitlines() if line.startswith(f"{len(fit.parameters)} parameters from")]
    (told,) = data["fits"]
    assert lead.startswith(f"{len(told['parameters'])} parameters from {len(told['recordings'])} recordings in ")
    assert shows(re.search(r"in (\S+) s\.", lead)[1], told["seconds"])
    assert shows(re.search(r"freedom is ([\d.]+);", lead)[1], told["chi2_per_dof"])


def test_a_parameter_that_started_at_zero_has_moved_by_no_share_of_that(tmp_path):
    from types import SimpleNamespace

    from hydrotwin.report.fit import fit_warning, parameter_rows, parameter_table

    rows = [
        SimpleNamespace(name=n, start=s, value=3.0, sigma=0.1, unit="N", shift=h, at_bound=False)
        for n, s, h in (("bias.force", 0.0, 3.0), ("mass", 2.0, 0.5))
    ]
    left = SimpleNamespace(role="train", chi2_per_sample=256.0, output="speed")
    fit = SimpleNamespace(name="slide", parameters=rows, residuals=[left])
    shift = next(c for c in parameter_table(parameter_rows(fit)).columns if c.key == "shift")
    assert [c.text for c in shift.cells] == ["–", "50.0"]
    assert "mass moved by 50 %" in fit_warning(fit)


def test_every_figure_of_a_friction_page_follows_from_its_json(tmp_path):
    v = np.concatenate([np.linspace(-0.2, -0.005, 20), np.linspace(0.005, 0.2, 20)])
    true = (300 + 200 * np.exp(-((v / 0.03) ** 2))) * np.sign(v) + 900 * v
    force = true + 3.0 * np.random.default_rng(1).standard_normal(len(v))
    data, text = read(write_friction_test(fit_stribeck(v, force), tmp_path, recordings=["bench"]))
    figures = [
        {"value": value, "lower": data["intervals"][name][0], "upper": data["intervals"][name][1]}
        for name, value in data["values"].items()
    ]
    for row, own in zip(data["tables"]["coefficients"]["rows"], figures, strict=True):
        assert all(shows(row[key]["shown"], own[key]) for key in own)
    values = data["values"]
    v, F = np.array(data["velocity"]), np.array(data["force"])
    more = (values["static"] - values["kinetic"]) * np.exp(-((v / values["stribeck_velocity"]) ** 2))
    left = F - (values["kinetic"] + more) * np.sign(v) - values["viscous"] * v
    (told,) = re.findall(r"to ([\d.]+) N", data["answer"])
    assert shows(told, float(np.sqrt(np.mean(left**2))))
    assert f"{len(v)} " in text.splitlines()[2] and all(f in text for f in data["findings"])


def test_every_figure_of_a_linear_model_follows_from_its_json(tmp_path):
    model = ht.load("cehA")
    system, found_modes = linearise(model), modes(model)
    units = {s.name: s.unit for s in (*model.flat.inputs, *model.flat.outputs, *model.flat.states)}
    data, text = read(write_linearisation(system, found_modes, tmp_path, units=units, point={"command": 1.0}))
    poles = np.linalg.eigvals(np.array(data["A"]))
    poles = sorted(poles[poles.imag >= -1e-9], key=abs)
    rows = data["tables"]["modes"]["rows"]
    assert len(rows) == len(poles) == len(data["modes"])
    for row, pole, mode in zip(rows, poles, data["modes"], strict=True):
        assert mode["frequency"] == pytest.approx(abs(pole) / (2 * np.pi), rel=1e-6, abs=1e-9)
        assert shows(row["frequency"]["shown"], mode["frequency"]) and shows(row["damping"]["shown"], mode["damping"])
        assert shows(row["real"]["shown"], mode["pole"]["real"])
        assert shows(row["imaginary"]["shown"], mode["pole"]["imaginary"])
        for name, share in re.findall(r"(\S+) (\d+)%", row["states"]["shown"]):
            assert 100 * mode["participation"][name] == pytest.approx(float(share), abs=0.5)
    oil = [m for m in data["modes"] if m["pole"]["imaginary"] > 0]
    frequency = number(re.search(r"rings at (\S+) Hz", data["answer"])[1])
    assert any(frequency == pytest.approx(m["frequency"], rel=5e-3) for m in oil)
    assert f"{len(data['A'])} states" in text
