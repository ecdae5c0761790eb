"""SSP 2.0 and FMI-LS-REF as their published schemas want them; intervals, and where values come from."""

from __future__ import annotations

import dataclasses
import hashlib
import re
import zipfile
from pathlib import Path

import fmpy
import pytest
from fmpy.ssp.ssd import read_ssd, read_ssv
from lxml import etree

from hydrotwin.export import SystemPart, export_ssp
from hydrotwin.models.language.credibility import Credibility
from hydrotwin.models.language.errors import DeclarationError
from tests.export.systems import clocked_mass
from tests.export.test_replay import EVIDENCE, INSIDE, carrying

SCHEMAS = Path(__file__).parent / "schemas"
OF_FMI3 = Path(fmpy.__file__).parent / "schema/fmi3"
AT_HOME = "https://raw.githubusercontent.com/modelica/fmi-standard/main/schema/"


@pytest.fixture(scope="module")
def identified():
    """The mass with one value that was fitted."""
    flat = clocked_mass()
    found = [dataclasses.replace(p, value=2.5, sigma=0.1) if p.name == "mass.m" else p for p in flat.parameters]
    fitted = dataclasses.replace(flat, parameters=tuple(found))
    return SystemPart("found", fitted, nominal={"mass.m": 2.0}, credibility=Credibility((EVIDENCE,)))


@pytest.fixture(scope="module")
def packed(identified, tmp_path_factory) -> Path:
    parts = [SystemPart("shipped", clocked_mass()), identified]
    return export_ssp(parts, tmp_path_factory.mktemp("ssp") / "two.ssp", version="2.0").path


def invalid(schema: str, content: bytes, tmp_path: Path) -> list[str]:
    """What a schema has against a document; schemas of FMI 3 are taken from FMPy."""
    text = (SCHEMAS / schema).read_text(encoding="utf-8").replace(AT_HOME, f"{OF_FMI3.as_uri()}/")
    text = re.sub(r'import schemaLocation="([^"]+Annotation.xsd)"', r'include schemaLocation="\1"', text)
    text = text.replace('schemaLocation="SystemStructure', f'schemaLocation="{SCHEMAS.as_uri()}/SystemStructure')
    (tmp_path / schema).write_text(text, encoding="utf-8")
    rules = etree.XMLSchema(etree.parse(str(tmp_path / schema)))
    rules.validate(etree.fromstring(content))
    return [str(entry) for entry in rules.error_log]


def test_an_archive_of_2_0_meets_the_schemas_of_2_0(packed, tmp_path):
    with zipfile.ZipFile(packed) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    assert b'version="2.0"' in files["SystemStructure.ssd"]
    assert invalid("SystemStructureDescription.xsd", files["SystemStructure.ssd"], tmp_path) == []
    sets = [name for name in files if name.endswith(".ssv")]
    assert sets == ["resources/identified.ssv", "resources/nominal.ssv"]
    for name in sets:
        assert b'version="2.0"' in files[name]
        assert invalid("SystemStructureParameterValues.xsd", files[name], tmp_path) == []
    broken = files["SystemStructure.ssd"].replace(b'version="2.0"', b'version="3.0"')
    assert "'3.0'" in " ".join(invalid("SystemStructureDescription.xsd", broken, tmp_path))


def test_what_an_fmu_carries_along_meets_the_schemas_of_fmi_ls_ref(tmp_path):
    with zipfile.ZipFile(carrying(tmp_path / "m.fmu")) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    manifest = files[f"{INSIDE}fmi-ls-manifest.xml"]
    assert invalid("fmi3LayeredStandardReferenceManifest.xsd", manifest, tmp_path) == []
    for name in ("smoke-test.exp", "validation.exp"):
        assert invalid("fmi3LayeredStandardReferenceExperiments.xsd", files[INSIDE + name], tmp_path) == []
    assert invalid("SystemStructureParameterValues.xsd", files[f"{INSIDE}validation-start.ssv"], tmp_path) == []
    broken = manifest.replace(b"experiment/smoke-test", b"experiment/for-fun")
    assert "for-fun" in " ".join(invalid("fmi3LayeredStandardReferenceManifest.xsd", broken, tmp_path))


def test_a_fitted_value_has_its_interval_in_both_versions(packed, identified, tmp_path):
    old = export_ssp([identified], tmp_path / "old.ssp").path
    assert read_ssd(old, validate=True).version == "1.0"
    assert read_ssv(old, resource="resources/identified.ssv", validate=True).parameters
    for path in (packed, old):
        with zipfile.ZipFile(path) as archive:
            root = etree.fromstring(archive.read("resources/identified.ssv"))
        found = {e.getparent().getparent().getparent().get("name"): dict(e.attrib) for e in root.iter("Interval")}
        assert list(found) == ["found.mass.m"]  # what nobody fitted has none
        numbers = {key: float(value) for key, value in found["found.mass.m"].items()}
        assert numbers == pytest.approx({"confidence": 0.95, "sigma": 0.1, "low": 2.304, "high": 2.696})


def test_in_2_0_the_values_say_where_they_come_from(packed, identified, tmp_path):
    with zipfile.ZipFile(packed) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    ssc, srmd = (
        "{http://ssp-standard.org/SSP1/SystemStructureCommon}",
        etree.fromstring(files["resources/identified.srmd"]),
    )
    [told] = etree.fromstring(files["resources/identified.ssv"]).iter(f"{ssc}MetaData")
    assert dict(told.attrib) == {"kind": "quality", "type": "application/x-srmd-meta-data", "source": "identified.srmd"}
    assert srmd.get("data") == "identified.ssv"
    assert srmd.get("checksum") == hashlib.sha3_256(files["resources/identified.ssv"]).hexdigest()
    facts = [(e.get("keyword"), e.text) for e in srmd.iter("{*}ClassificationEntry")]
    assert ("recording to judge", f"bench_7, SHA-256 {'b' * 64}") in facts
    assert ("criterion", "PASS place.rmse < 1 mm, found 0.0005 (SI), margin 50 %") in facts
    [record] = etree.fromstring(files["SystemStructure.ssd"]).iter(f"{ssc}MetaData")
    assert (record.getparent().get("name"), record.get("sourceBase")) == ("found", "resource")
    (tmp_path / "found.fmu").write_bytes(files["resources/found.fmu"])
    with zipfile.ZipFile(tmp_path / "found.fmu") as fmu:
        assert record.get("source") in fmu.namelist()
    with zipfile.ZipFile(export_ssp([identified], tmp_path / "old.ssp").path) as archive:
        assert not [n for n in archive.namelist() if n.endswith(".srmd")]
        assert not any(b"MetaData" in archive.read(n) for n in archive.namelist() if n.endswith((".ssd", ".ssv")))


def test_a_version_that_there_is_none_of_is_refused(identified, tmp_path):
    with pytest.raises(DeclarationError, match=r"no version '2' of SSP"):
        export_ssp([identified], tmp_path / "x.ssp", version="2")
    assert not list(tmp_path.iterdir())
