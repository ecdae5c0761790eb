"""compare.json is what its published schema says, and the schema names every key that is written."""

from __future__ import annotations

import json
from dataclasses import replace

import jsonschema
import pytest

import hydrotwin as ht
from hydrotwin.comparison import FORMAT, Wanted, acceptance, compare
from hydrotwin.comparison.acceptance import earlier
from hydrotwin.models.language.errors import DataError
from hydrotwin.report import write_report
from tests.comparison.toys import Toy, recording
from tests.report.test_notebook import fit as real_fit

SCHEMA = ht.compare_schema()
CHECK = jsonschema.Draft202012Validator(SCHEMA, format_checker=jsonschema.FormatChecker())


@pytest.fixture(scope="module")
def judged(tmp_path_factory):
    """The file of a comparison with tags, criteria, an earlier comparison, a failure and a real fit."""
    folder = tmp_path_factory.mktemp("judged")
    records = [replace(recording(k, duration=2.0), tags={"load": str(k)}) for k in (1, 2)]
    found = compare([Toy("a"), Toy("b", gain=126.0, fails_on="validation_2")], records, repeats=1)
    before = write_report(found, folder / "before")["json"]
    wanted = Wanted(("arm_angle.rmse < 1 deg", "load=2: motor_speed.max < 1 rad/s"), against=before)
    paths = write_report(found, folder, accepted=acceptance(found, wanted), fits=[real_fit()])
    return json.loads(paths["json"].read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def full(report):
    return json.loads(report["json"].read_text(encoding="utf-8"))


def unnamed(value, schema, at="") -> list[str]:
    """Paths of the keys of ``value`` that ``schema`` has no word for."""
    while "$ref" in schema:
        schema = SCHEMA["$defs"][schema["$ref"].rpartition("/")[2]]
    if isinstance(value, list):
        return [path for one in value for path in unnamed(one, schema["items"], f"{at}[]")]
    if not isinstance(value, dict) or not schema.keys() & {"properties", "additionalProperties"}:
        return []
    known, rest = schema.get("properties", {}), schema.get("additionalProperties")
    missing = [f"{at}.{key}" for key in value if key not in known and rest is None]
    inner = [(key, one, known.get(key, rest)) for key, one in value.items() if key in known or rest]
    return missing + [path for key, one, of in inner for path in unnamed(one, of, f"{at}.{key}")]


def test_the_schema_is_one():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert SCHEMA["properties"]["format"]["const"] == FORMAT
    assert SCHEMA["$id"].rpartition(":")[2] == FORMAT.rpartition("/")[2]


@pytest.mark.parametrize("which", ["full", "judged"])
def test_what_is_written_is_valid_and_every_key_is_named(which, request):
    data = request.getfixturevalue(which)
    assert [e.message for e in CHECK.iter_errors(data)] == []
    assert unnamed(data, SCHEMA) == []
    assert data["format"] == FORMAT and data["scores"] and data["fits"]


def test_conditions_and_criteria_are_in_the_file(judged):
    assert [r["tags"] for r in judged["recordings"]] == [{"load": "1"}, {"load": "2"}]
    assert [c["passed"] for c in judged["acceptance"]["criteria"]] == [True, False]
    assert judged["acceptance"]["changes"]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: data.pop("means"),
        lambda data: data.update(format="hydrotwin-compare/2"),
        lambda data: data["scores"][0].update(rmse="0.1"),
        lambda data: data["recordings"][0].update(role="other"),
        lambda data: data["acceptance"]["criteria"][0].pop("margin"),
    ],
)
def test_what_differs_is_not_valid(judged, spoil):
    spoilt = json.loads(json.dumps(judged))
    spoil(spoilt)
    assert len(list(CHECK.iter_errors(spoilt))) == 1


def test_a_file_of_another_format_is_refused_and_one_without_is_read(judged, tmp_path):
    path = tmp_path / "compare.json"
    path.write_text(json.dumps(judged | {"format": "hydrotwin-compare/2"}))
    with pytest.raises(DataError, match=r"got 'hydrotwin-compare/2'\), this version of hydrotwin reads .*/1'\. Run"):
        earlier(path)
    path.write_text(json.dumps({k: v for k, v in judged.items() if k != "format"}))
    assert earlier(path).means["a", "arm_angle", "free run"]["rmse"] == judged["means"][0]["rmse"]
