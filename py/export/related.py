"""Files that belong to an FMU and lie inside it, with their roles: the manifest of the layered standard FMI-LS-REF.

Source: FMI Layered Standard References 1.0.0-beta.1, Modelica Association, 2026. In that release, too,
``fmi-ls-version`` of a manifest is 1.0.0-alpha.1 (docs/index.adoc, table of the manifest's attributes).
An importer must be ready for files that the manifest names and that are gone.
"""

from __future__ import annotations

import posixpath
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

from hydrotwin.models.language.errors import DataError

from .archive import file_names, read_file

NAME, VERSION = "org.fmi-standard.fmi-ls-ref", "1.0.0-alpha.1"
FOLDER = f"extra/{NAME}"
MANIFEST = f"{FOLDER}/fmi-ls-manifest.xml"
DESCRIPTION = "Layered Standard providing information on related files included in an FMU."
SPACE = "http://fmi-standard.org/fmi-ls-manifest"
ANY = "application/octet-stream"
EXPERIMENT, RESULT, REPORT = "experiment", "result", "report"  # roles; a role may have a part after "/"
SMOKE, VALIDATION = "experiment/smoke-test", "experiment/validation"


@dataclass(frozen=True)
class Related:
    """One file: its path in the FMU ("" where it lies elsewhere), role, MIME type, and what it is."""

    path: str
    role: str
    type: str = ANY
    description: str = ""
    source: str = ""

    @property
    def main_role(self) -> str:
        """The role without its part after "/"."""
        return self.role.partition("/")[0]


def manifest_text(related: Iterable[Related]) -> str:
    """The manifest that names these files."""
    said = {"fmi-ls-name": NAME, "fmi-ls-version": VERSION, "fmi-ls-description": DESCRIPTION}
    root = ET.Element("fmiReferences", {"xmlns:fmi-ls": SPACE} | {f"fmi-ls:{k}": v for k, v in said.items()})
    for one in related:
        source = posixpath.relpath(one.path, FOLDER)
        ET.SubElement(root, "Related", type=one.type, source=source, role=one.role, description=one.description)
    return xml_text(root)


def xml_text(root: ET.Element) -> str:
    """A document, indented."""
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def related_of(path: Path) -> tuple[Related, ...] | None:
    """What the manifest inside an FMU names; None without one. Raises DataError where it cannot be read."""
    if MANIFEST not in file_names(path):
        return None
    root = xml_of(read_file(path, MANIFEST), MANIFEST)
    if local(root.tag) != "fmiReferences":
        raise DataError(
            f"{MANIFEST}: no manifest of FMI-LS-REF (its root is '{local(root.tag)}', not 'fmiReferences')."
        )
    return tuple(_related(e) for e in root if local(e.tag) == "Related")


def _related(element: ET.Element) -> Related:
    source, role = element.get("source", ""), element.get("role", "")
    if not source or not role:
        raise DataError(f"{MANIFEST}: a file has no {'source' if role else 'role'}. Ask who made the FMU.")
    return Related(
        path_of(source, FOLDER), role, element.get("type", ANY), element.get("description", ""), source
    )  # fmt: skip


def path_of(source: str, folder: str) -> str:
    """The path in the FMU of a URI that is relative to ``folder``; "" for one that leads out of the FMU."""
    parts = urlsplit(source)
    if parts.scheme or parts.netloc or parts.path.startswith("/"):
        return ""
    path = posixpath.normpath(posixpath.join(folder, unquote(parts.path)))
    return "" if path.startswith("..") else path


def missing(path: Path, related: Sequence[Related]) -> list[Related]:
    """Those that should lie inside the FMU and do not."""
    names = set(file_names(path))
    return [one for one in related if one.path and one.path not in names]


def content_of(path: Path, name: str) -> bytes:
    """One file of an FMU. Raises DataError where it is not there."""
    if not name or name not in file_names(path):
        raise DataError(
            f"'{name or 'a file outside of the FMU'}' is not in the FMU. Take it from where the FMU was made."
        )
    return read_file(path, name)


def xml_of(content: bytes, where: str) -> ET.Element:
    """The root of an XML document. Raises DataError where it is none."""
    try:
        return ET.fromstring(content)
    except ET.ParseError as error:
        raise DataError(f"{where}: this is no XML ({error}). Ask who made the FMU.") from None


def local(tag: str) -> str:
    """A tag without its namespace."""
    return tag.rpartition("}")[2]
