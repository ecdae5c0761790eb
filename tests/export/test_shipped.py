"""fmus/: each folder says what is in its FMU, and `make fmus` fails when one does not keep its reference."""

from __future__ import annotations

import dataclasses
import hashlib
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from types import SimpleNamespace

import numpy as np
import pytest

from fmus.make import main
from fmus.readme import readme_of
from fmus.shipped import HERE, all_shipped, read_shipped
from hydrotwin.commands.exporting import equations_told
from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.export.undelayed import without_idle_delays
from hydrotwin.learned.block_file import learned_kinds
from hydrotwin.models.language.errors import DataError
from hydrotwin.records import read_record
from tests.export.systems import delayed_mass, mass_record
from tests.export.test_description import read

SHIPPED = all_shipped()
EXAMPLES = HERE.parent / "examples"
SMALL = "spool_valve_network"


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A copy of the smallest folder with its FMU of FMI 2, built and checked."""
    root = tmp_path_factory.mktemp("fmus")
    copy_of_small(root)
    assert main([SMALL], root) == 0
    return root


def copy_of_small(root):
    folder = root / SMALL
    shutil.copytree(HERE / SMALL, folder, ignore=shutil.ignore_patterns("*.fmu"))
    text = (folder / "fmu.toml").read_text(encoding="utf-8")
    (folder / "fmu.toml").write_text(text.replace("fmi = [2, 3]", "fmi = [2]"), encoding="utf-8")
    return folder


def test_there_are_both_machines_the_named_effect_and_a_learned_block():
    assert [s.folder.name for s in SHIPPED] == ["cehA", "cehA_internal_leakage", "spool_valve", SMALL]


@pytest.mark.parametrize("shipped", SHIPPED, ids=lambda s: s.folder.name)
def test_the_readme_is_what_the_model_says_today(shipped):
    assert (shipped.folder / "README.md").read_text(encoding="utf-8") == readme_of(shipped)


@pytest.mark.parametrize("shipped", SHIPPED, ids=lambda s: s.folder.name)
def test_the_reference_is_what_the_model_gives_today(shipped):
    kept, anew = read_record(shipped.reference), shipped.reference_run()
    assert kept.names == anew.names
    for name in kept.names:
        assert np.abs(kept[name] - anew[name]).max() <= 1e-9 * np.ptp(anew[name]), name


@pytest.mark.parametrize("shipped", SHIPPED, ids=lambda s: s.folder.name)
def test_what_was_learned_from_recordings_names_those_that_are_shipped(shipped):
    provenance = shipped.load().provenance
    machine = shipped.folder.name.partition("_internal")[0].removesuffix("_network")
    for row in provenance.get("recordings") or provenance.get("trained_on") or ():
        recording = EXAMPLES / machine / "recordings" / f"{row['name']}.csv"
        assert hashlib.sha256(recording.read_bytes()).hexdigest() == row["sha256"]
        assert row["sha256"] in (shipped.folder / "README.md").read_text(encoding="utf-8")
    assert bool(provenance) == (shipped.folder.name not in ("cehA", "spool_valve"))


@pytest.mark.parametrize("shipped", SHIPPED, ids=lambda s: s.folder.name)
def test_a_folder_is_small(shipped):
    assert sum(p.stat().st_size for p in shipped.folder.iterdir() if p.suffix != ".fmu") < 200_000


def test_the_snippet_of_the_readme_runs(built):
    text = (built / SMALL / "README.md").read_text(encoding="utf-8")
    [snippet] = [part.partition("```")[0] for part in text.split("```python\n")[1:]]
    done = subprocess.run(
        [sys.executable, "-c", snippet + "\nprint(len(result['time']))"], cwd=built / SMALL, capture_output=True,
        text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[-1]) > 50  # before it, the block may warn that it was driven out of its training


def test_a_learned_block_starts_inside_its_training_data(built):
    fmu = read_fmu(built / SMALL / f"{SMALL}_fmi2.fmu")
    [start] = [p.value for p in fmu.parameters if p.name == "position.start"]
    assert 0.27 < start < 0.59


def test_a_learned_block_carries_its_equations(built):
    page = read(built / SMALL / f"{SMALL}_fmi2.fmu", "documentation/index.html")
    assert "y[k+1] = clip(y[k] + d[k])" in page
    assert "y[k+1] = clip(y[k] + d[k])" in (HERE / SMALL / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", learned_kinds(), ids=lambda kind: kind.name)
def test_every_kind_of_learned_block_has_words_for_its_equations(kind):
    assert " = " in equations_told(SimpleNamespace(kind=kind.name))


def test_a_reference_that_is_not_met_fails(built, tmp_path, capsys):
    folder = copy_of_small(tmp_path)
    record = read_record(folder / "reference.csv")
    wrong = np.where(record.time > 1.0, 1.001 * record["position"], record["position"])
    lines = (folder / "reference.csv").read_text(encoding="utf-8").splitlines()
    column = [h.split("[")[0].strip() for h in lines[0].split(",")].index("position")
    rows = [line.split(",") for line in lines[-len(wrong) :]]
    changed = [",".join([*r[:column], repr(float(w)), *r[column + 1 :]]) for r, w in zip(rows, wrong, strict=True)]
    text = "\n".join([*lines[: -len(wrong)], *changed]) + "\n"
    (folder / "reference.csv").write_text(text, encoding="utf-8")
    assert main([SMALL], tmp_path) == 1
    told = capsys.readouterr().out
    assert "reference: 1 outputs" in told
    assert "FAIL" in told


def test_what_cannot_be_built_fails_and_says_why(tmp_path, capsys):
    folder = copy_of_small(tmp_path)
    text = (folder / "fmu.toml").read_text(encoding="utf-8").replace('kind = "cs"', 'kind = "both"')
    (folder / "fmu.toml").write_text(text, encoding="utf-8")
    assert main([], tmp_path) == 1
    assert "a sampled block cannot be Model Exchange" in capsys.readouterr().out


def test_a_name_that_is_none_is_refused(capsys):
    assert main(["cehB"]) == 2
    assert "Did you mean 'cehA'" in capsys.readouterr().err


@pytest.mark.parametrize(("line", "words"), [("stepp = 0.1", "Did you mean 'step'"), ("", "no text 'title'")])
def test_a_wrong_fmu_toml_says_what_and_where(tmp_path, line, words):
    (tmp_path / "fmu.toml").write_text(f'model = "cehA"\n{line}\n', encoding="utf-8")
    with pytest.raises(DataError, match=words):
        read_shipped(tmp_path)


def test_a_dead_time_of_zero_is_left_out_of_model_exchange(tmp_path):
    late = delayed_mass()
    prompt = late.with_parameters({"force_delay": 0.0})
    assert without_idle_delays(late) == (late, ())
    flat, left_out = without_idle_delays(prompt)
    assert left_out == ("force_delay",)
    x, u = [0.3, -0.2], [2.0, 1.0]
    for one, other in zip(
        flat.ode(0.7, x, u, flat.parameter_vector()), prompt.ode(0.7, x, u, prompt.parameter_vector()), strict=True
    ):
        np.testing.assert_array_equal(one.full(), other.full())
    fmu = export_fmu(prompt, tmp_path / "prompt.fmu", kind="both")
    names = {v.get("name") for v in ET.fromstring(read(fmu)).iter("ScalarVariable")}
    assert "mass.m" in names
    assert "force_delay" not in names
    assert "force_delay = 0 s" in read(fmu, "documentation/index.html")
    record = mass_record(0.5)
    moved = dataclasses.replace(record, signals={**record.signals, "force": 2.0 * record["force"]})
    block = read_fmu(fmu)
    assert not np.allclose(block.free_run(record)["place"], block.free_run(moved)["place"])
