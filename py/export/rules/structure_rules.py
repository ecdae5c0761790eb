"""What the standard requires of the model structure: what must be listed where, and what depends on what."""

from __future__ import annotations

import itertools

from .declared import FLOATS, Declared, Listed, Variable
from .findings import Findings, twice

OUTPUT, RATE, UNKNOWN, CLOCKED = "Output", "ContinuousStateDerivative", "InitialUnknown", "ClockedState"
INDICATOR = "EventIndicator"
LATE_KINDS = {"fixed", "tunable", "discrete"}  # of dependence, not for the start


def structure_row(declared: Declared) -> Findings:
    """The lists, then the dependencies in them."""
    found = Findings()
    nowhere = [f"{_written(row)} of {row.place}" for row in declared.structure if row.variable is None]
    found.breaks("entries that lead to no variable", nowhere)
    for name in (OUTPUT, RATE, UNKNOWN, CLOCKED, INDICATOR):
        again = twice(v.name for v in declared.listed(name))
        found.breaks(f"listed twice as {name}", again)
    _outputs(declared, found)
    _derivatives(declared, found)
    _initial_unknowns(declared, found)
    if declared.fmi3:
        _others(declared, found)
    _dependencies(declared, found)
    return found


def _written(row: Listed) -> str:
    key = "valueReference" if row.element.get("valueReference") is not None else "index"
    return f"{key}='{row.element.get(key)}'"


def _names(variables: list[Variable]) -> list[str]:
    return [v.name for v in variables]


def _outputs(declared: Declared, found: Findings):
    outputs, listed = [v for v in declared.variables if v.causality == "output"], set(declared.listed(OUTPUT))
    found.breaks("outputs that are not listed", _names([v for v in outputs if v not in listed]))
    found.breaks("listed as outputs and none", _names([v for v in declared.listed(OUTPUT) if v.causality != "output"]))


def _derivatives(declared: Declared, found: Findings):
    """A variable may be the derivative of another and belong to no state, so what says that it does must be there."""
    rates = declared.listed(RATE)
    found.breaks("listed as derivatives and of no state", [str(v) for v in rates if v.typed.get("derivative") is None])
    states = [declared.at(v.typed.get("derivative", "").strip()) for v in rates]
    found.breaks("states with more than one derivative listed", twice(v.name for v in states if v is not None))


def _initial_unknowns(declared: Declared, found: Findings):
    rates, states, listed = set(declared.listed(RATE)), declared.states, declared.listed(UNKNOWN)
    moving = rates | states
    proper = [
        v for v in declared.variables
        if v.causality in ("output", "calculatedParameter") or v in moving or v.element.get("clocks")
    ]  # fmt: skip
    known, members = set(proper), set(listed)
    odd = [v for v in listed if v not in known]
    hidden = [v for v in odd if v.typed.get("derivative") is not None]
    where = "ContinuousStateDerivative" if declared.fmi3 else "Derivatives"
    found.breaks(f"state derivatives that are not listed under {where}", [str(v) for v in hidden])
    lost = found.broken or len(states) < len(rates)  # what follows may be its consequence
    rest = [str(v) for v in odd if v not in hidden] if not lost else []
    found.breaks("among the InitialUnknowns and neither output, calculated parameter nor state", rest)
    found.notes("among the InitialUnknowns and known at the start", _names([v for v in listed if v.initial == "exact"]))
    missing = [v for v in proper if _is_unknown(v) and v not in members]
    what = "calculated at the start and not among the InitialUnknowns"
    data = [v for v in missing if v.causality in ("output", "calculatedParameter")]
    tell = found.breaks if listed else found.notes  # an exporter that writes no such list leaves importers to their own
    tell(what, _names(data))
    found.notes(what, _names([v for v in missing if v not in data]))  # states can be asked for all the same
    if not declared.fmi3:
        places = {v: k for k, v in enumerate(declared.variables)}
        late = [b for a, b in itertools.pairwise(listed) if places[a] > places[b]]
        found.breaks("the InitialUnknowns must come in the order of the variables", _names(late))


def _is_unknown(v: Variable) -> bool:
    return v.initial in ("approx", "calculated") and v.kind != "Clock" and not v.element.get("clocks")


def _others(declared: Declared, found: Findings):
    """Clocked states, event indicators and local clocks of FMI 3."""
    clocked, members = declared.listed(CLOCKED), set(declared.listed(CLOCKED))
    bad = [v for v in clocked if not (v.element.get("previous") and v.element.get("clocks") and v.kind != "Clock")]
    found.breaks("clocked states without previous or clocks", [str(v) for v in bad])
    states = [v for v in declared.variables if v.element.get("previous") is not None]
    lost = [str(v) for v in states if v not in members]
    found.breaks("variables with previous that are not listed as ClockedState", lost)
    again = twice(v.element.get("previous", "").strip() for v in states)
    found.breaks("value references that are previous to several variables", again)
    for v in declared.listed(INDICATOR):
        if not v.floating or v.variability != "continuous" or v.causality not in ("local", "output"):
            found.breaks("event indicators that are no continuous local variables or outputs", [str(v)])
    rows = [r for r in declared.structure if r.variable is not None]
    local = [str(r.variable) for r in rows if r.variable.kind == "Clock" and r.variable.causality == "local"]
    found.breaks("local clocks must not be listed", local)


def _dependencies(declared: Declared, found: Findings):
    rows = [r for r in declared.structure if r.variable is not None]
    typed = [r for r in rows if r.kinds is not None]
    found.breaks("dependencies that lead to no variable", [str(r) for r in rows if None in (r.dependencies or ())])
    unpaired = [str(r) for r in typed if r.dependencies is None or len(r.kinds) != len(r.dependencies)]
    found.breaks("dependenciesKind and dependencies differ in number", unpaired)
    late = [str(r) for r in typed if r.list == UNKNOWN and LATE_KINDS & {*r.kinds}]
    found.breaks("dependenciesKind of InitialUnknowns that is neither dependent nor constant", late)
    whole = [str(r) for r in typed if r.variable.kind not in FLOATS and {*r.kinds} - {"dependent"}]
    found.notes("dependenciesKind of what is no real variable is dependent", whole)
    if not declared.fmi3:
        mixed = [str(r) for r in rows if not _rises(r.element.get("dependencies", ""))]
        found.breaks("dependencies must rise", mixed)
    if not found.broken:
        pairs = [(r, v) for r in rows for v in r.dependencies or () if not _is_known(declared, r, v)]
        found.notes("dependencies on what is no known", [f"{r.variable.name} on {v.name}" for r, v in pairs])


def _rises(dependencies: str) -> bool:
    places = [int(w) for w in dependencies.split() if w.isdecimal()]
    return places == sorted(places)


def _is_known(declared: Declared, row: Listed, v: Variable) -> bool:
    """Inputs and time; at the start what has a value of its own, later the states, in FMI 3 parameters as well."""
    if v.causality in ("input", "independent"):
        return True
    if row.list == UNKNOWN:
        return v.initial == "exact"
    moving = v in declared.states or v.element.get("previous") is not None or v.element.get("clocks") is not None
    return moving or (declared.fmi3 and v.causality in ("parameter", "structuralParameter"))
