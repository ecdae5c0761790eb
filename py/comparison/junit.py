"""Criteria as a JUnit XML document, for servers that build and test."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

from hydrotwin.models.language.writing import printable

from .acceptance import Acceptance
from .criteria import Judged


def junit(found: Acceptance, title: str, notices: Sequence[str] = ()) -> str:
    """The criteria, a test case each; values in the unit that each criterion was written in.

    XML has no control signs: they are spaces here, wherever a name or a sentence of a vendor's FMU has them.

    notices : what a reader must not miss, for the whole of it.
    """
    failed = [one for one in found.judged if not one.passed]
    count = {"tests": str(len(found.judged)), "failures": str(len(failed))}
    suite = ElementTree.Element("testsuite", name=printable(title), **count, errors="0", skipped="0")
    model = printable(found.model)
    for one in found.judged:
        case = ElementTree.SubElement(suite, "testcase", classname=model, name=printable(one.criterion.text))
        if not one.passed:
            words = printable(_words(one))
            ElementTree.SubElement(case, "failure", message=words, type="criterion").text = words
        if one.caution:
            ElementTree.SubElement(case, "system-out").text = printable(_told(one))
    if notices:
        ElementTree.SubElement(suite, "system-out").text = "\n".join(map(printable, notices))
    root = ElementTree.Element("testsuites", **count)
    root.append(suite)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _told(one: Judged) -> str:
    """What to know of a criterion, and why its band is doubted: a case stands alone on a server."""
    return f"{one.caution}: {one.doubt.rstrip('.')}" if one.doubt else one.caution


def _words(one: Judged) -> str:
    """What was found of a missed criterion, and what is allowed, in its unit."""
    if one.undefined:
        return one.undefined
    unit = f" {one.criterion.unit}" if one.criterion.unit else ""
    value, low, high = (one.criterion.as_written(v) for v in (one.value, one.low, one.high))
    allowed = f"at least {low:.6g}" if high == float("inf") else f"{low:.6g} to {high:.6g}"
    allowed = f"at most {high:.6g}" if low == -float("inf") else allowed
    which = f" of {one.which}" if one.which else ""
    return f"found {value:.6g}{unit}{which}, allowed {allowed}{unit}"
