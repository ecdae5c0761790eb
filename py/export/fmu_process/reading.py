"""Whether every variable that is declared can be read after initialization, and which cannot."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

from fmpy.fmi1 import FMICallException
from fmpy.model_description import ScalarVariable

from .master import ERROR, Instance, accessed_as
from .trial import refused
from .verdicts import FAIL, PASS, REMARK, NotTried

ENOUGH = 20.0  # s for looking which variables are refused
NAMED = 3  # of those, named at most
OTHERS = 20  # variables tried one by one beside a refused one
GIVEN = ("parameter", "structuralParameter", "input", "independent")  # causalities of what is not calculated


@dataclass
class Refusal:
    """Variables of which one at least is refused, one alone where there was time to find it."""

    among: list[ScalarVariable]
    failure: FMICallException

    def __str__(self) -> str:
        first, last = self.among[0], self.among[-1]
        if first is last:
            return f"'{first.name}' (valueReference {first.valueReference})"
        return f"one of {len(self.among)} from '{first.name}' to '{last.name}'"


@dataclass
class Reader:
    """Reads variables of new instances, each as it is after initialization.

    fresh : gives an instance before initialization; computes : has one calculate.
    """

    fresh: Callable[[], Instance]
    computes: Callable[[Instance], object]
    until: float = math.inf

    def ready(self) -> Instance:
        """A new instance after initialization."""
        instance = self.fresh()
        try:
            instance.initialise(0.0, None, {}, {})
        except (FMICallException, RuntimeError) as failure:
            instance.close()
            raise NotTried(f"it does not come to where variables are read ({failure}), see the row 'runs'") from None
        return instance

    def failure(self, variables: Sequence[ScalarVariable], computed: bool = False) -> FMICallException | None:
        """What it answers where it refuses to read them, all of one kind; None too where it cannot calculate before."""
        instance = self.ready()
        try:
            if not (computed and refused(lambda: self.computes(instance))):
                _read(instance, variables)
        except FMICallException as failure:
            instance.close()
            return failure
        with suppress(FMICallException):
            instance.close()
        return None

    @property
    def in_time(self) -> bool:
        """Whether there is time for another look."""
        return time.monotonic() < self.until


def every_variable(variables: Sequence[ScalarVariable], reader: Reader):
    """Verdict on reading them all, kind by kind; those of a clock have values when it ticks, so they are left out."""
    first = reader.ready()
    groups = _by_kind(variables, first.fmi3)
    first.close()
    reader.until = time.monotonic() + ENOUGH
    failures = [(group, reader.failure(group)) for group in groups]
    bad = [r for group, failure in failures if failure for r in _first_refused(group, failure, reader)]
    if not bad:
        return PASS, f"all {sum(map(len, groups))} variables can be read after initialization"
    names = ", ".join(str(r) for r in bad[:NAMED]) + (" and maybe more" if len(bad) >= NAMED else "")
    told = f"declared, and not to be read after initialization: {names}; {bad[0].failure}"
    if all(r.failure.status < ERROR for r in bad):
        return REMARK, told
    if not _is_its_own(bad[0], groups, reader):
        raise NotTried(f"{told} Nothing that it calculates can be read: it may need values for its inputs")
    return FAIL, told


def _by_kind(variables: Sequence[ScalarVariable], fmi3: bool) -> list[list[ScalarVariable]]:
    """Variables that one function reads, each reference once."""
    groups: dict[str, dict[int, ScalarVariable]] = {}
    for v in variables:
        if v.type != "Clock" and not v.clocks:
            groups.setdefault(accessed_as(v.type, fmi3), {}).setdefault(v.valueReference, v)
    return [list(group.values()) for group in groups.values()]


def _read(instance: Instance, variables: Sequence[ScalarVariable]):
    read = getattr(instance.fmu, f"get{accessed_as(variables[0].type, instance.fmi3)}")
    references = [v.valueReference for v in variables]
    if instance.fmi3:
        read(references, sum(math.prod(v.shape or (1,)) for v in variables))
    else:
        read(references)


def _first_refused(group: list[ScalarVariable], failure: FMICallException, reader: Reader) -> list[Refusal]:
    """The first few, found by halving: a call is refused where one of its variables is."""
    found: list[Refusal] = []
    low = 0
    while failure is not None and len(found) < NAMED and low < len(group):
        fine, bad = low, len(group)  # what is before `fine` can be read, what is before `bad` cannot
        while bad - fine > 1 and reader.in_time:
            middle = (fine + bad) // 2
            answer = reader.failure(group[low:middle])
            fine, bad, failure = (middle, bad, failure) if answer is None else (fine, middle, answer)
        found.append(Refusal(group[fine:bad], failure))
        low = bad
        failure = reader.failure(group[low:]) if low < len(group) and reader.in_time else None
    return found


def _is_its_own(refusal: Refusal, groups: list[list[ScalarVariable]], reader: Reader) -> bool:
    """Whether it is the variable, and not that nothing can be calculated at the start values of the inputs."""
    everything = [v for group in groups for v in group]
    asked = refusal.among[0]
    if asked.causality in GIVEN or not any(v.causality == "input" for v in everything):
        return True
    others = [v for v in everything if v.causality not in GIVEN and v.variability != "constant" and v is not asked]
    if any(reader.failure([v]) is None for v in others[:OTHERS]):
        return True
    return reader.failure([asked], computed=True) is not None
