"""Rules of the standard that are read in an FMU without running its code."""

from __future__ import annotations

from pathlib import Path

from lxml import etree

from ..archive import file_names
from ..fmu_process.verdicts import FAIL, NOT_TRIED
from ..standard import paragraph
from .archive_rules import archive_rows
from .declared import NO_ARCHIVE, Declared, number, read_declared
from .definition_rules import interfaces_row, lists_row, types_row, units_row
from .file_rules import TERMINALS, sources_row, terminals_row
from .name_rules import convention_of, names_row
from .schema_rules import schema_row
from .structure_rules import structure_row
from .variable_rules import variables_row


def read_or_say(path: Path) -> Declared | tuple[str, str, str]:
    """The description of an FMU of FMI 2 or 3; else verdict, detail and rule of what cannot be read."""
    try:
        declared = read_declared(path)
    except NO_ARCHIVE as failure:
        told = str(failure).strip("\"'") or type(failure).__name__
        must = "It must be a zip archive with a modelDescription.xml. Check the download."
        reason = f"{path}: not an FMU ({told}). {must}"
        return FAIL, reason, "FMI 2.0.5, 2.3 FMU Distribution; FMI 3.0.2, 2.5 FMU Distribution"
    except etree.XMLSyntaxError as failure:
        reason = f"modelDescription.xml is no XML in the encoding it names: {failure}. Ask its maker for one that is."
        return FAIL, reason, "FMI 2.0.5, 2.2 FMI Description Schema; FMI 3.0.2, 2.4 FMI Description Schema"
    if number(declared.version) and declared.version[0] not in "23":
        return NOT_TRIED, f"{path}: FMI {declared.version} is not supported. FMI 2.0 and 3.0 are.", ""
    if declared.version[:1] not in ("2", "3"):
        reason = f"{path}: its fmiVersion is '{declared.version}', where the standard has 2.0 and 3.0. Ask its maker."
        return FAIL, reason, f"{paragraph('readable', '2')}; {paragraph('readable', '3')}"
    return declared


def rule_rows(path: Path, declared: Declared) -> list[tuple[str, tuple[str, str]]]:
    """Row and, of it, verdict and detail."""
    count = len(declared.variables)
    found = {
        "schema": schema_row(path, declared).verdict("the schema of the standard is met, in UTF-8"),
        "interfaces": interfaces_row(declared).verdict(", ".join(str(e.tag) for e in declared.interfaces)),
        "unit definitions": units_row(declared).verdict(f"{len(declared.units)} units"),
        "type definitions": types_row(declared).verdict(f"{len(declared.types)} types"),
        "other definitions": lists_row(declared).verdict("log categories, annotations and experiment make sense"),
        "variables": variables_row(declared).verdict(f"{count} variables, attributes and start values legal"),
        "names": names_row(declared).verdict(f"unique, of the convention '{convention_of(declared)}'"),
        "model structure": structure_row(declared).verdict("complete, with every entry where it belongs"),
        "sources": sources_row(path, declared).verdict("what is listed to build it from is there"),
    }
    if TERMINALS in file_names(path):
        found["terminals"] = terminals_row(path, declared).verdict("all lead to variables")
    return [*found.items(), *archive_rows(path, declared).items()]
