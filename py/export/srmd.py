"""Where values come from, as SRMD: meta-data of a resource by the layered standard SSP Traceability.

Source: SSP Traceability 1.0.0-rc.2, Modelica Association, 2026, section 8 (SRMD). What a classification means is left
to who writes it: here a keyword and a text for every fact of the block [credibility].
"""

from __future__ import annotations

import hashlib
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping

from hydrotwin.models.language.credibility import Credibility, Evidence

from .related import xml_text

VERSION = "1.0.0"
SSP = "http://ssp-standard.org/SSPTraceability1"
SPACES = {"srmd": f"{SSP}/SimulationResourceMetaData", "stc": f"{SSP}/SSPTraceabilityCommon"}
KIND = "hydrotwin.credibility"


def srmd_text(name: str, data: str, content: str, tool: str, models: Mapping[str, Credibility]) -> str:
    """The meta-data of the file ``data`` beside it with this ``content``: of every model what vouches for it."""
    root = ET.Element("srmd:SimulationResourceMetaData", {f"xmlns:{k}": v for k, v in SPACES.items()})
    checksum = hashlib.sha3_256(content.encode()).hexdigest()
    root.attrib |= {"version": VERSION, "name": name, "data": data, "checksum": checksum, "checksumType": "SHA3-256"}
    root.set("generationTool", tool)
    for model, credibility in models.items():
        for number, one in enumerate(credibility.evidence, 1):
            element = ET.SubElement(root, "stc:Classification", type=f"{KIND}.{model}.{number}")
            for keyword, text in _facts(model, one):
                ET.SubElement(element, "stc:ClassificationEntry", keyword=keyword).text = text
    return xml_text(root)


def _facts(model: str, one: Evidence) -> Iterable[tuple[str, str]]:
    yield "model", model
    yield "made by", one.by
    yield "date", one.date
    yield "versions", ", ".join(f"{name} {number}" for name, number in one.versions.items())
    yield "contents SHA-256", one.contents
    for row in one.recordings:
        yield f"recording to {row['role']}", f"{row['name']}, SHA-256 {row['sha256'] or 'unknown'}"
    for row in one.metrics:
        numbers = [f"{key} {value:.6g}" for key, value in row.items() if isinstance(value, float)]
        yield "metrics", f"{row['output']} [{row['unit']}], {row['role']}, {row['mode']}: {', '.join(numbers)}"
    for row in one.criteria:
        word = "PASS" if row["passed"] else "FAIL"
        yield "criterion", f"{word} {row['text']}, found {row['value']:.6g} (SI), margin {100 * row['margin']:.3g} %"
