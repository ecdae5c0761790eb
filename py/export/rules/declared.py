"""What a modelDescription.xml declares, as it stands there: a reference that leads nowhere is None, and no error."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import InitVar, dataclass, field
from functools import cached_property
from pathlib import Path

from lxml import etree

from ..archive import read_file

DESCRIPTION = "modelDescription.xml"
HUGE = etree.XMLParser(huge_tree=True, resolve_entities=False, no_network=True)
KINDS2 = ("Real", "Integer", "Boolean", "String", "Enumeration")
FLOATS = ("Real", "Float64", "Float32")
LISTS2 = {"Outputs": "Output", "Derivatives": "ContinuousStateDerivative", "InitialUnknowns": "InitialUnknown"}
DATA = ("parameter", "calculatedParameter", "structuralParameter")

_SET, _FOUND, _FREE = ("exact",), ("calculated", "approx"), ("calculated", "exact", "approx")
COMBINATIONS = {
    ("structuralParameter", "fixed"): _SET, ("structuralParameter", "tunable"): _SET,
    ("parameter", "fixed"): _SET, ("parameter", "tunable"): _SET,
    ("calculatedParameter", "fixed"): _FOUND, ("calculatedParameter", "tunable"): _FOUND,
    ("input", "discrete"): _SET, ("input", "continuous"): _SET,
    ("output", "constant"): _SET, ("output", "discrete"): _FREE, ("output", "continuous"): _FREE,
    ("local", "constant"): _SET, ("local", "fixed"): _FOUND, ("local", "tunable"): _FOUND,
    ("local", "discrete"): _FREE, ("local", "continuous"): _FREE,
    ("independent", "continuous"): (None,),
}  # fmt: skip
"""(causality, variability) -> what initial may be, the default first."""


@dataclass(eq=False, slots=True)
class Variable:
    """One variable: ``element`` has its name, ``typed`` what belongs to its type; in FMI 3 they are one.

    causality, variability and initial are as declared, or the defaults; declared is the element of the declared type.
    """

    element: etree._Element
    typed: etree._Element
    kind: str
    declared: etree._Element | None
    default: InitVar[str]  # of variability
    name: str = ""
    causality: str = "local"
    variability: str = ""
    initial: str | None = None
    start: str | None = None

    def __post_init__(self, default: str):
        element = self.element
        self.name = element.get("name", "")
        self.causality, self.variability = element.get("causality", "local"), element.get("variability", default)
        usual = COMBINATIONS.get((self.causality, self.variability), (None,))[0]
        self.initial = element.get("initial") or usual
        self.start = self.typed.get("start")
        if self._is_text:
            self.start = " ".join(texts) if (texts := self._texts()) else None

    @property
    def _is_text(self) -> bool:
        """Whether start values are elements: of texts and binaries in FMI 3."""
        return self.kind in ("String", "Binary") and self.typed is self.element

    def _texts(self) -> list[str]:
        return [e.get("value", "") for e in self.element.iterfind("Start")]

    @property
    def reference(self) -> str:
        """Its value reference, as written."""
        return self.element.get("valueReference", "").strip()

    @property
    def starts(self) -> int:
        """How many start values there are."""
        return len(self._texts()) if self._is_text else len((self.start or "").split())

    def get(self, attribute: str) -> str | None:
        """An attribute of its own, else of its declared type."""
        own = self.typed.get(attribute)
        return own if own is not None or self.declared is None else self.declared.get(attribute)

    def number(self, attribute: str) -> float | None:
        """The same as a number, None where it is none."""
        return number(self.get(attribute))

    @property
    def floating(self) -> bool:
        """Whether it holds floating point numbers."""
        return self.kind in FLOATS

    def __str__(self) -> str:
        return f"{self.name} (line {self.element.sourceline})"


@dataclass(frozen=True, eq=False)
class Listed:
    """One element of the model structure. ``dependencies`` is None where they are not given."""

    element: etree._Element
    list: str
    variable: Variable | None
    dependencies: list[Variable | None] | None
    kinds: list[str] | None

    @property
    def place(self) -> str:
        """Where it stands."""
        return f"{self.list} (line {self.element.sourceline})"

    def __str__(self) -> str:
        return f"{self.variable.name if self.variable else 'nothing'} in {self.place}"


@dataclass
class Declared:
    """A model description of FMI 2 or 3."""

    root: etree._Element
    raw: bytes = b""
    interfaces: list[etree._Element] = field(init=False)

    def __post_init__(self):
        kinds = ("ModelExchange", "CoSimulation", "ScheduledExecution")
        self.interfaces = [e for kind in kinds for e in self.root.iterfind(kind)]

    @cached_property
    def version(self) -> str:
        """Of the standard."""
        return self.root.get("fmiVersion", "")

    @property
    def fmi3(self) -> bool:
        """Whether it is of FMI 3."""
        return self.version.startswith("3")

    def offers(self, kind: str) -> bool:
        """Whether it has that interface."""
        return any(e.tag == kind for e in self.interfaces)

    @cached_property
    def types(self) -> dict[str, tuple[str, etree._Element]]:
        """Name of a type -> what it is a type of, and the element that has its attributes."""
        found = {}
        for element in _elements(self.root.find("TypeDefinitions")):
            inner = element if self.fmi3 else next(_elements(element), element)
            found.setdefault(element.get("name", ""), (str(inner.tag).removesuffix("Type"), inner))
        return found

    @cached_property
    def units(self) -> dict[str, etree._Element]:
        """Name -> unit."""
        return {e.get("name", ""): e for e in reversed(self.root.findall("UnitDefinitions/Unit"))}

    @cached_property
    def variables(self) -> list[Variable]:
        """All, in their order; in FMI 3 without aliases."""
        found = [self._variable(e) for e in _elements(self.root.find("ModelVariables"))]
        return [v for v in found if v is not None]

    def _variable(self, element: etree._Element) -> Variable | None:
        typed = element if self.fmi3 else next((e for e in _elements(element) if e.tag in KINDS2), None)
        if typed is None:
            return None
        declared = self.types.get(typed.get("declaredType", ""), (None, None))[1]
        floating, data = typed.tag in FLOATS, element.get("causality") in DATA
        default = "continuous" if not self.fmi3 else "fixed" if data else "continuous" if floating else "discrete"
        return Variable(element, typed, str(typed.tag), declared, default)

    @cached_property
    def _places(self) -> dict[str, Variable]:
        """What a reference means: FMI 2 counts the variables from 1, FMI 3 names value references."""
        if self.fmi3:
            return {_plain(v.reference): v for v in reversed(self.variables)}
        return {str(k): v for k, v in enumerate(self.variables, 1)}

    def at(self, word: str) -> Variable | None:
        """The variable that a reference leads to."""
        return self._places.get(_plain(word))

    @cached_property
    def structure(self) -> list[Listed]:
        """The elements of the model structure, each in the list that it belongs to."""
        root, found = self.root.find("ModelStructure"), []
        for element in _elements(root):
            if self.fmi3:
                found.append(self._listed(element, str(element.tag), "valueReference"))
            elif element.tag in LISTS2:
                found += [self._listed(e, LISTS2[element.tag], "index") for e in element.iterfind("Unknown")]
        return found

    def _listed(self, element: etree._Element, name: str, key: str) -> Listed:
        on, kinds = (element.get(a) for a in ("dependencies", "dependenciesKind"))
        return Listed(
            element,
            name,
            self.at(element.get(key, "").strip()),
            None if on is None else [self.at(word) for word in on.split()],
            None if kinds is None else kinds.split(),
        )

    def listed(self, name: str) -> list[Variable]:
        """The variables of one list, without what leads nowhere."""
        return [row.variable for row in self.structure if row.list == name and row.variable is not None]

    @cached_property
    def states(self) -> set[Variable]:
        """Continuous-time states: those whose derivatives are listed."""
        targets = [self.at(rate.typed.get("derivative", "")) for rate in self.listed("ContinuousStateDerivative")]
        return {v for v in targets if v is not None}

    @property
    def names(self) -> list[str]:
        """Of variables and of their aliases."""
        return [n for v in self.variables for n in (v.name, *(a.get("name", "") for a in v.element.iterfind("Alias")))]


def _elements(parent: etree._Element | None) -> Iterator[etree._Element]:
    """Child elements without comments."""
    return iter(()) if parent is None else (e for e in parent if isinstance(e.tag, str))


def _plain(word: str) -> str:
    """A whole number without leading zeros."""
    return str(int(word)) if word.isdecimal() else word


def number(text: str | None) -> float | None:
    """A number as XML writes it, None where it is none."""
    try:
        return None if text is None else float(text)
    except ValueError:
        return None


def read_declared(path: Path) -> Declared:
    """The description of an FMU. OSError, KeyError, BadZipFile or XMLSyntaxError where there is none to read."""
    raw = read_file(path, DESCRIPTION)
    return Declared(etree.fromstring(raw, HUGE), raw)


NO_ARCHIVE = (OSError, KeyError, zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError)
"""What reading a file of an archive raises where that is none, or lacks it."""
