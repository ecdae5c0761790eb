"""What a row of a check found: rules that are broken, and what is only worth knowing."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from ..fmu_process.verdicts import FAIL, PASS, REMARK

SHOWN = 3  # findings of one kind in a sentence


@dataclass
class Findings:
    """What one row found, in sentences."""

    broken: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def breaks(self, what: str, items: Iterable[str]):
        """A rule that each of ``items`` breaks."""
        self.broken += told(what, items)

    def notes(self, what: str, items: Iterable[str]):
        """What is no rule, or no rule that costs an importer anything."""
        self.remarks += told(what, items)

    def verdict(self, good: str) -> tuple[str, str]:
        """Verdict and detail; ``good`` where nothing was found."""
        verdict = FAIL if self.broken else REMARK if self.remarks else PASS
        return verdict, "; ".join([*self.broken, *self.remarks]) or good


def told(what: str, items: Iterable[str]) -> list[str]:
    """One sentence, with the first few items; none where there is no item."""
    items = list(items)
    more = f" and {len(items) - SHOWN} more" if len(items) > SHOWN else ""
    head = f"{what}: " if what else ""
    return [f"{head}{', '.join(items[:SHOWN])}{more}"] if items else []


def twice(names: Iterable[str]) -> list[str]:
    """The names that come more than once, in their order."""
    seen: set[str] = set()
    again: dict[str, None] = {}
    for name in names:
        if name in seen:
            again[name] = None
        seen.add(name)
    return list(again)
