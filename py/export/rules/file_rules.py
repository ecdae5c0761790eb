"""What the XML files of an FMU say of its other files: sources to build it from, variables of its terminals."""

from __future__ import annotations

import posixpath
from collections.abc import Iterable
from pathlib import Path

from lxml import etree

from ..archive import file_names, read_file
from .declared import HUGE, NO_ARCHIVE, Declared
from .findings import Findings, twice

BUILD, TERMINALS = "sources/buildDescription.xml", "terminalsAndIcons/terminalsAndIcons.xml"
SOURCES = (".c", ".cpp", ".cc", ".cxx")
MEMBERS = ("variableName", "inStreamVariableName", "outStreamVariableName")


def sources_row(path: Path, declared: Declared) -> Findings:
    """Files to build the FMU from: those that are listed must be there."""
    found, files = Findings(), set(file_names(path))
    has_sources = any(n.startswith("sources/") and n.endswith(SOURCES) for n in files)
    listed = [e.get("name", "") for i in declared.interfaces for e in i.iterfind("SourceFiles/File")]
    if has_sources:  # without any, FMI 2 has the list mean nothing
        found.breaks("source files that are listed and not there", _missing(listed, files))
    build = _read(path, files, BUILD)
    if build is not None:
        _build(build, declared, files, found)
    elif has_sources and BUILD not in files and not any(n.startswith("binaries/") for n in files) and not listed:
        found.breaks("", [f"nothing but sources, and no list of those to compile: {BUILD}, or SourceFiles in FMI 2"])
    return found


def _build(build: etree._Element, declared: Declared, files: set[str], found: Findings):
    configurations = build.findall("BuildConfiguration")
    known = {e.get("modelIdentifier") for e in declared.interfaces}
    names = [c.get("modelIdentifier", "") for c in configurations]
    strange = [f"'{n}'" for n in dict.fromkeys(names) if n not in known]
    tell = found.notes if any(n.startswith("binaries/") for n in files) else found.breaks  # who builds needs the name
    tell("build configurations of a modelIdentifier that no interface has", strange)
    plain = twice(c.get("modelIdentifier", "") for c in configurations if c.get("platform") is None)
    found.breaks("more than one build configuration without a platform", plain)
    named = (e.get("name", "") for e in build.iter("SourceFile"))
    found.breaks("source files that are listed and not there", _missing(named, files))
    folders = {posixpath.dirname(f) for f in files}
    lost = [
        f"sources/{n}" for e in build.iter("IncludeDirectory")
        if not any(f"{f}/".startswith(f"{_in_sources(n := e.get('name', ''))}/") for f in folders)
    ]  # fmt: skip
    found.breaks("include directories that are listed and not there", lost)
    for configuration in configurations:
        sets = twice(s.get("name") for s in configuration.iterfind("SourceFileSet[@name]"))
        found.breaks("source file sets of one name", sets)


def _in_sources(name: str) -> str:
    return posixpath.normpath(f"sources/{name}")


def _missing(names: Iterable[str], files: set[str]) -> list[str]:
    return [f"sources/{n}" for n in dict.fromkeys(names) if _in_sources(n) not in files]


def terminals_row(path: Path, declared: Declared) -> Findings:
    """Variables of terminals must exist; a terminal's name and those of its members are its own."""
    found, files = Findings(), set(file_names(path))
    root = _read(path, files, TERMINALS)
    if root is None:
        return found
    names = set(declared.names)
    members = [(e, e.get(a)) for e in root.iter() for a in MEMBERS if isinstance(e.tag, str) and e.get(a) is not None]
    found.breaks("no variables", [f"'{name}' (line {e.sourceline})" for e, name in members if name not in names])
    icons = dict.fromkeys(e.get("iconBaseName", "") for e in root.iter("TerminalGraphicalRepresentation"))
    pictures = [posixpath.normpath(f"terminalsAndIcons/{name}.png") for name in icons]
    found.breaks("icons that are named and not there", [p for p in pictures if p not in files])
    for level in root.iter("Terminals", "Terminal"):
        again = twice(t.get("name", "") for t in level.iterfind("Terminal"))
        found.breaks("terminals of one name", again)
        if level.tag == "Terminal" and level.get("matchingRule") in ("plug", "bus"):
            inner = [m.get("memberName") for m in level.iterfind("TerminalMemberVariable")]
            bare = [level.get("name", "")] if None in inner else []
            found.breaks("members without memberName in a terminal that is matched by it", bare)
            found.breaks(f"members of '{level.get('name')}' with one name", twice(m for m in inner if m))
    return found


def _read(path: Path, files: set[str], name: str) -> etree._Element | None:
    """The root of an XML file, None where there is none of FMI 3, which is when the schema row says what is wrong."""
    try:
        root = etree.fromstring(read_file(path, name), HUGE) if name in files else None
    except (*NO_ARCHIVE, etree.XMLSyntaxError):
        return None
    return root if root is not None and root.get("fmiVersion", "3").startswith("3") else None
