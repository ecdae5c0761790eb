"""The XML files of an FMU against the schemas of the standard, and their encoding."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import fmpy
from lxml import etree

from ..archive import file_names, read_file
from .declared import DESCRIPTION, FLOATS, HUGE, NO_ARCHIVE, Declared, number
from .findings import Findings

SCHEMAS = Path(fmpy.__file__).parent / "schema"
BESIDE = {
    "sources/buildDescription.xml": "fmi3BuildDescription.xsd",
    "terminalsAndIcons/terminalsAndIcons.xml": "fmi3TerminalsAndIcons.xsd",
}
"""Other XML files of an FMU, all of FMI 3, which FMI 2 has taken over."""
PROLOG = re.compile(rb"^(?:\xef\xbb\xbf)?<\?xml\s[^>]*?encoding\s*=\s*[\"']([A-Za-z0-9._-]+)[\"']")
BOUNDS = ("start", "min", "max", "nominal")


def schema_row(path: Path, declared: Declared) -> Findings:
    """Each XML file is valid and in UTF-8."""
    found, edition = Findings(), f"fmi{declared.version[0]}"
    found.breaks("", schema_errors(declared.root, f"{edition}/{edition}ModelDescription.xsd"))
    _encoding(DESCRIPTION, declared.raw, found)
    for name in sorted(BESIDE.keys() & set(file_names(path))):
        try:
            raw = read_file(path, name)
            root = etree.fromstring(raw, HUGE)
        except (*NO_ARCHIVE, etree.XMLSyntaxError) as failure:
            found.breaks("", [f"{name} is no XML that can be read: {failure}"])
            continue
        version = root.get("fmiVersion", "3")
        if version.startswith("3"):
            found.breaks(name, schema_errors(root, f"fmi3/{BESIDE[name]}"))
        if declared.fmi3 and version != declared.version:
            found.breaks("", [f"{name} is of FMI {version}, where the description is of {declared.version}"])
        _encoding(name, raw, found)
    if not declared.fmi3:
        reals = [(str(v), v.typed) for v in declared.variables if v.floating]
        reals += [(f"type '{name}'", e) for name, (kind, e) in declared.types.items() if kind in FLOATS]
        strange = [f"{name} ({', '.join(bad)})" for name, element in reals if (bad := _infinite(element))]
        found.breaks("INF and NAN are no values in these files", strange)
    return found


@cache
def _schema(name: str) -> etree.XMLSchema:
    return etree.XMLSchema(file=str(SCHEMAS / name))


def schema_errors(root: etree._Element, name: str) -> list[str]:
    """What a schema says against a tree, by line."""
    schema = _schema(name)
    return [] if schema.validate(root) else [f"line {e.line}: {e.message}" for e in schema.error_log]


def _encoding(name: str, raw: bytes, found: Findings):
    """What is wrong with the encoding of a file: it is UTF-8, and the first line says so.

    Another name on a file of nothing but ASCII costs no importer anything: it is UTF-8 all the same.
    """
    if raw.startswith((b"\xff\xfe", b"\xfe\xff", b"<\0", b"\0<", b"\0\0")):
        found.breaks("", [f"{name} is in UTF-16 or UTF-32, where UTF-8 is required"])
        return
    match = PROLOG.match(raw)
    tell = found.notes if raw.isascii() else found.breaks
    if not match:
        tell("", [f'the first line of {name} does not name its encoding (encoding="UTF-8")'])
    elif (encoding := match[1].decode()).upper() != "UTF-8":
        tell("", [f"{name} is said to be in {encoding}, where UTF-8 is required"])


def _infinite(element: etree._Element) -> list[str]:
    values = {a: number(element.get(a)) for a in BOUNDS}
    return [f"{a}={value}" for a, value in values.items() if value is not None and value - value != 0.0]
