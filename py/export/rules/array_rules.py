"""Arrays, clocks and what belongs to a clock: only FMI 3 has them."""

from __future__ import annotations

import math

from .declared import Declared, Variable, number

PERIODIC = ("constant", "fixed", "tunable")
TIMES = ("intervalDecimal", "shiftDecimal", "intervalCounter", "shiftCounter", "resolution")


def array_faults(declared: Declared, v: Variable) -> list[str]:
    """What is wrong with the sizes of an array and the number of its start values."""
    dimensions = v.element.findall("Dimension")
    faults, sizes = [], []
    if declared.fmi3 and v.start is not None and not v.starts:
        faults.append("a start without a value")
    if not dimensions:
        return [*faults, f"{v.starts} start values for one value"] if declared.fmi3 and v.starts > 1 else faults
    if v.causality == "structuralParameter":
        faults.append("a structural parameter must not be an array")
    for dimension in dimensions:
        size, fault = _size(declared, dimension.get("start"), dimension.get("valueReference"))
        sizes.append(size)
        faults += [f"Dimension {fault}"] if fault else []
    wanted = math.prod(sizes) if None not in sizes else None
    if wanted is not None and v.starts not in (0, 1, wanted):
        faults.append(f"{v.starts} start values for {wanted}")
    return faults


def _size(declared: Declared, start: str | None, reference: str | None) -> tuple[int | None, str]:
    """Size of one dimension at the start, None where it is unknown, and what is wrong with it."""
    if (start is None) == (reference is None):
        return None, "needs either start or valueReference, and not both"
    if reference is not None:
        target = declared.at(reference.strip())
        if target is None:
            return None, f"valueReference='{reference}' leads to no variable"
        may = target.causality == "structuralParameter" or target.variability == "constant"
        if target.kind != "UInt64" or not may:
            return None, f"valueReference='{reference}' leads to {target.name}, no constant or structural UInt64"
        start = target.start
    size = number(start)
    if size is None:
        return None, ""
    return int(size), "" if size > 0 else f"of size {start}, where it must be above zero"


def clock_faults(declared: Declared, v: Variable) -> list[str]:
    """What is wrong with a clock."""
    if v.kind != "Clock":
        return []
    kind, has = v.get("intervalVariability"), {a: number(v.get(a)) for a in TIMES}
    given = {a for a in TIMES if has[a] is not None}
    rules = {
        "a clock must be an input, an output or local": v.causality in ("input", "output", "local"),
        "a clock must be discrete": v.variability == "discrete",
        "a clock that is no input must be triggered": v.causality == "input" or kind == "triggered",
        "a clock of constant interval needs intervalDecimal": kind != "constant" or "intervalDecimal" in given,
        "only periodic clocks have an interval": kind in PERIODIC or not given & {"intervalDecimal", "intervalCounter"},
        "only periodic clocks have a resolution": kind in PERIODIC or "resolution" not in given,
        "an interval must be above zero": all((has[a] or 1.0) > 0.0 and has[a] != 0.0 for a in TIMES[::2]),
        "a shift must not be negative": all((has[a] or 0.0) >= 0.0 for a in ("shiftDecimal", "shiftCounter")),
        "shiftDecimal needs intervalDecimal": not has["shiftDecimal"] or "intervalDecimal" in given,
        "shiftCounter needs intervalCounter": not has["shiftCounter"] or "intervalCounter" in given,
        "intervalCounter needs resolution and supportsFraction": "intervalCounter" not in given
        or ("resolution" in given and v.get("supportsFraction") in ("true", "1")),
        "an input clock of Scheduled Execution needs a priority": v.causality != "input"
        or not declared.offers("ScheduledExecution")
        or v.get("priority") is not None,
        "an output clock has no priority": v.causality != "output" or v.get("priority") is None,
    }
    return [rule for rule, kept in rules.items() if not kept]


def clocked_faults(declared: Declared, v: Variable) -> list[str]:
    """What is wrong with the clocks of a variable, with its previous value and its intermediate update."""
    faults, clocks = [], v.element.get("clocks")
    if clocks is not None:
        named = {word: declared.at(word) for word in clocks.split()}
        faults += [f"clocks='{w}' leads to no clock" for w, c in named.items() if c is None or c.kind != "Clock"]
        faults += [] if named else ["clocks is an empty list"]
        if v.variability not in ("discrete", "tunable"):
            faults.append("what belongs to a clock must be discrete or tunable")
        if v.causality != "local" and any(c is not None and c.causality == "local" for c in named.values()):
            faults.append("only local variables belong to a local clock")
    if v.element.get("intermediateUpdate") in ("true", "1") and v.variability != "continuous":
        faults.append("intermediateUpdate is for continuous variables alone")
    return faults + (_previous_faults(declared, v) if v.element.get("previous") is not None else [])


def _previous_faults(declared: Declared, v: Variable) -> list[str]:
    word = v.element.get("previous", "").strip()
    target = declared.at(word)
    if target is None:
        return [f"previous='{word}' leads to no variable"]
    rules = {
        "previous is for discrete variables that belong to a clock": v.variability == "discrete"
        and v.element.get("clocks") is not None
        and v.kind != "Clock",
        f"previous='{word}' leads to itself": target is not v,
        f"previous='{word}' leads to {target.name}, which is no discrete {v.kind} or is an input": target.kind == v.kind
        and target.variability == "discrete"
        and target.causality != "input",
    }
    return [rule for rule, kept in rules.items() if not kept]
