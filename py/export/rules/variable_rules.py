"""What the standard requires of the variables of a description beyond what its schema says."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable

from .array_rules import array_faults, clock_faults, clocked_faults
from .declared import COMBINATIONS, Declared, Variable, number
from .definition_rules import attribute_faults, is_shown
from .findings import Findings

WHOLE_KINDS = ("Integer", "Enumeration", "Int", "UInt")
NO_START = ("Clock", "String", "Binary", "Boolean")  # kinds whose start value has no bounds
BASE = {"Enumeration": "Integer"}  # kinds that are read and set by one function in FMI 2


def variables_row(declared: Declared) -> Findings:
    """Each variable by itself, then those that belong together."""
    found, variables = Findings(), declared.variables
    for what, faulty in RULES.items():
        found.breaks(what, [str(v) for v in variables if faulty(declared, v)])
    for faults in (_dangling, _attributes, array_faults, clock_faults, clocked_faults):
        each = [f"{fault}: {v}" for v in variables for fault in faults(declared, v)]
        found.breaks("", each)
    found.breaks("", _independents(declared))
    if declared.fmi3:
        found.breaks("one value reference for several variables", _shared(variables))
        found.breaks("display units of aliases that are not defined", _strange_aliases(declared))
    else:
        _alias_sets(declared, found)
    _notes(declared, found)
    return found


def _illegal(declared: Declared, v: Variable) -> bool:
    return v.initial not in COMBINATIONS.get((v.causality, v.variability), ())


def _unwanted_initial(declared: Declared, v: Variable) -> bool:
    forbidden = ("independent",) if declared.fmi3 else ("independent", "input")
    return v.element.get("initial") is not None and v.causality in forbidden


def _needs_start(declared: Declared, v: Variable) -> bool:
    wanted = v.initial in ("exact", "approx") or v.causality == "input"
    return wanted and v.kind != "Clock" and v.start is None


def _unwanted_start(declared: Declared, v: Variable) -> bool:
    forbidden = v.element.get("initial") == "calculated" or v.initial == "calculated" or v.causality == "independent"
    return forbidden and v.start is not None


def _outside(declared: Declared, v: Variable) -> bool:
    """FMI 2 requires "max >= start >= min" (schema); in FMI 3 whole numbers must stay in their range (2.2.7.3)."""
    return (not declared.fmi3 or v.kind.startswith(WHOLE_KINDS)) and _beyond(v)


def _beyond(v: Variable) -> bool:
    if v.kind in NO_START or not v.start:
        return False
    low, high = v.number("min"), v.number("max")
    if low is None and high is None:
        return False
    starts = [s for word in v.start.split() if (s := number(word)) is not None]
    return any((low is not None and s < low) or (high is not None and s > high) for s in starts)


def _no_item(declared: Declared, v: Variable) -> bool:
    if v.kind != "Enumeration" or v.declared is None or not v.start:
        return False
    items = {number(i.get("value")) for i in v.declared.iterfind("Item")}
    return any(number(word) not in items for word in v.start.split())


def _odd_type(declared: Declared, v: Variable) -> bool:
    kind = declared.types.get(v.typed.get("declaredType", ""), (v.kind, None))[0]
    return kind != v.kind


def _odd_state(declared: Declared, v: Variable) -> bool:
    return v in declared.states and v.causality not in ("local", "output")


def _odd_reinit(declared: Declared, v: Variable) -> bool:
    alone = not declared.fmi3 and not declared.offers("ModelExchange")
    return v.typed.get("reinit") is not None and (alone or v not in declared.states)


def _odd_setting(declared: Declared, v: Variable) -> bool:
    alone = not declared.fmi3 and not declared.offers("ModelExchange")
    return v.element.get("canHandleMultipleSetPerTimeInstant") is not None and (alone or v.causality != "input")


def _odd_nominal(declared: Declared, v: Variable) -> bool:
    """In FMI 3 the nominal value of a state must be above zero (2.3.1); in FMI 2 any."""
    nominal = v.number("nominal")
    return declared.fmi3 and v in declared.states and nominal is not None and not nominal > 0.0


RULES: dict[str, Callable[[Declared, Variable], bool]] = {
    "only real variables may be continuous": lambda d, v: v.variability == "continuous" and not v.floating,
    "causality, variability and initial that do not go together": _illegal,
    "initial is not allowed for what is an input or independent": _unwanted_initial,
    "a start value is required": _needs_start,
    "a start value is forbidden for what is calculated or independent": _unwanted_start,
    "a start value outside of min and max": _outside,
    "a start value that is no item of its enumeration": _no_item,
    "a declared type of another kind": _odd_type,
    "a continuous-time state must be local or an output": _odd_state,
    "reinit is for continuous-time states of Model Exchange alone": _odd_reinit,
    "canHandleMultipleSetPerTimeInstant is for inputs of Model Exchange alone": _odd_setting,
    "the nominal value of a state must be above zero": _odd_nominal,
}
"""Sentence -> whether a variable breaks that rule."""


def _dangling(declared: Declared, v: Variable) -> list[str]:
    """References of a variable that lead nowhere, or to what cannot be meant."""
    faults = []
    if (name := v.typed.get("declaredType")) is not None and name not in declared.types:
        faults.append(f"declared type '{name}' is not defined")
    word = v.typed.get("derivative")
    if word is not None and (target := declared.at(word.strip())) is None:
        faults.append(f"derivative='{word}' leads to no variable")
    elif word is not None and (not target.floating or target is v):
        faults.append(f"derivative='{word}' leads to {'itself' if target is v else f'{target.name}, a {target.kind}'}")
    return faults


def _attributes(declared: Declared, v: Variable) -> list[str]:
    return attribute_faults(declared, v.typed, v.kind, v.get)


def _independents(declared: Declared) -> list[str]:
    found = [v for v in declared.variables if v.causality == "independent"]
    if declared.fmi3 and not found:
        return ["there must be exactly one independent variable, and there is none"]
    several = ", ".join(str(v) for v in found)
    faults = [f"there must be no more than one independent variable: {several}"] if len(found) > 1 else []
    return faults + [f"the independent variable must be real: {v}" for v in found if not v.floating]


def _shared(variables: Iterable[Variable]) -> list[str]:
    sets = defaultdict(list)
    for v in variables:
        sets[v.reference].append(v)
    return [f"{reference} of {' and '.join(v.name for v in s)}" for reference, s in sets.items() if len(s) > 1]


def _strange_aliases(declared: Declared) -> list[str]:
    pairs = [(v, a) for v in declared.variables for a in v.element.iterfind("Alias[@displayUnit]")]
    units = declared.units
    return [
        f"'{shown}' of {a.get('name')} (line {a.sourceline})" for v, a in pairs
        if (shown := a.get("displayUnit")) is not None
        and ((unit := v.get("unit")) not in units or not is_shown(declared, unit, shown))
    ]  # fmt: skip


def _alias_sets(declared: Declared, found: Findings):
    """Variables of one base type and value reference are one value: what that allows, by the four rules of FMI 2."""
    sets = defaultdict(list)
    for v in declared.variables:
        sets[BASE.get(v.kind, v.kind), v.reference].append(v)
    several = [s for s in sets.values() if len(s) > 1]
    found.breaks("aliases of which more than one can be set or has a start value", _named(several, _settable))
    found.breaks("aliases of which some are constant, or with different values", _named(several, _half_constant))
    found.breaks("aliases with different units", _named(several, lambda s: len(_units(s) - {None}) > 1))
    bare = _named(several, lambda s: None in _units(s) and len(_units(s)) == 2)
    found.notes("aliases of which some have a unit and some have none", bare)


def _settable(aliases: list[Variable]) -> bool:
    moving = [v for v in aliases if v.variability != "constant"]
    started = [v for v in moving if v.start is not None or v.causality in ("parameter", "input", "independent")]
    return len(started) > 1


def _half_constant(aliases: list[Variable]) -> bool:
    constant = [v for v in aliases if v.variability == "constant"]
    return bool(constant) and (len(constant) < len(aliases) or len({_value(v) for v in constant}) > 1)


def _value(v: Variable) -> object:
    return v.start if (found := number(v.start)) is None else found


def _units(aliases: list[Variable]) -> set[str | None]:
    return {v.get("unit") for v in aliases}


def _named(sets: list[list[Variable]], faulty: Callable[[list[Variable]], bool]) -> list[str]:
    return [" and ".join(str(v) for v in s[:3]) for s in sets if faulty(s)]


def _notes(declared: Declared, found: Findings):
    """What importers may stumble over, and what no rule forbids."""
    if declared.fmi3:
        far = [str(v) for v in declared.variables if v.floating and _beyond(v)]
        found.notes("a start value outside of min and max, the region the FMU is made for", far)
        others = [v for v in declared.variables if v not in declared.states]
        low = [str(v) for v in others if (n := v.number("nominal")) is not None and not n > 0.0]
        found.notes("a nominal value that is not above zero", low)
        return
    shown = {(v.get("unit"), v.typed.get("displayUnit")): v for v in reversed(declared.variables)}
    strange = [
        f"'{d}' of {v.name}" for (unit, d), v in shown.items()
        if d is not None and unit in declared.units and not is_shown(declared, unit, d)
    ]  # fmt: skip
    found.notes("display units that are not defined", strange)  # FMI 2 has them ignored
