"""What is tried of an FMU in child processes, in which order, and what a crash or a hang means."""

from __future__ import annotations

import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from fmpy.model_description import ModelDescription

from .child_process import HANG, Patience, start_child
from .fmu_process.exchange_probes import EXCHANGE_PROBES
from .fmu_process.gates import GATES
from .fmu_process.probes import PROBES
from .fmu_process.probing import GATES_GROUP, LOADS, READING, RUNS, START_VALUES, STATES
from .fmu_process.verdicts import FAIL, GOOD, NOT_TRIED, REMARK
from .standard import NOT_ALLOWED

SECOND = " (Model Exchange)"  # after the name of a row: of the other half of an FMU that offers both
BRIEF = 10.0  # s for a probe that no importer may make

Row = tuple[str, tuple[str, str]]


def offers_both(md: ModelDescription) -> bool:
    """Whether there is Co-Simulation and Model Exchange."""
    return md.coSimulation is not None and md.modelExchange is not None


def plan_of(md: ModelDescription) -> list[dict[str, str]]:
    """The rows to try: of each interface that is offered, then of the programs that take such an FMU."""
    slave, exchange = md.coSimulation is not None, md.modelExchange is not None
    second = SECOND if offers_both(md) else ""
    plan = _rows("CoSimulation", PROBES, "") if slave else []
    plan += _rows("ModelExchange", EXCHANGE_PROBES, second) if exchange else []
    fmi3 = md.fmiVersion.startswith("3")
    wanted = dict(zip(GATES, (slave, exchange, exchange and fmi3, slave and not fmi3), strict=True))
    needs = dict(zip(GATES, (RUNS, RUNS + second, RUNS + second, RUNS), strict=True))
    plan += [{"row": n, "group": GATES_GROUP, "probe": n, "needs": needs[n]} for n in GATES if wanted[n]]
    return plan


def _rows(group: str, probes, suffix: str) -> list[dict[str, str]]:
    needs = {LOADS: "", **dict.fromkeys((RUNS, READING, START_VALUES, STATES), LOADS + suffix)}
    return [
        {"row": name + suffix, "group": group, "probe": name, "needs": needs.get(name, RUNS + suffix)}
        for name in (LOADS, *probes)
    ]


def tried_rows(path: Path, plan: list[dict[str, str]], elsewhere: str, limit: float) -> list[Row]:
    """Each row of the plan with its verdict; ``elsewhere`` says why none can be tried here.

    One child process tries them all, what no importer may do last: it may spoil the memory of what comes after. After a
    crash or a hang what is left goes on in a new one.
    """
    if elsewhere:
        return [(entry["row"], (NOT_TRIED, elsewhere)) for entry in plan]
    ordered = sorted(plan, key=lambda entry: entry["probe"] in NOT_ALLOWED)
    found: dict[str, tuple[str, str]] = {}
    while left := [entry for entry in ordered if entry["row"] not in found]:
        found |= _in_child(path, left, found, limit)
    return [(entry["row"], _fair(entry, *found[entry["row"]])) for entry in plan]


def _in_child(path: Path, left: list[dict[str, str]], found: dict, limit: float) -> dict[str, tuple[str, str]]:
    """Rows of ``left`` as far as one child process comes."""
    spoilt = [row for row, (verdict, _) in found.items() if verdict not in GOOD]
    with tempfile.TemporaryDirectory(prefix="hydrotwin-check-", ignore_cleanup_errors=True) as folder:
        job = {"task": "probe", "path": str(path.absolute()), "plan": left, "spoilt": spoilt}
        lines = Path(folder) / "rows.jsonl"
        failure = start_child(job, {}, _OfEach(limit, lines=lines, usual=limit), Path(folder))
        told = _read(lines)
    if failure and not told:
        return {entry["row"]: (NOT_TRIED, f"no probe could begin: {failure}") for entry in left}
    rows = {e["name"]: (e["verdict"], e["detail"]) for e in told if "name" in e}
    stopped = next((entry for entry in left if entry["row"] not in rows), None)
    if failure and stopped:
        slow = failure.startswith(HANG) and stopped["probe"] not in (LOADS, RUNS)
        whose = stopped["row"] if stopped["group"] == GATES_GROUP else "the FMU"
        rows[stopped["row"]] = (NOT_TRIED if slow else FAIL, failure.replace("the FMU", whose, 1))
    return rows


@dataclass
class _OfEach(Patience):
    """Patience that begins anew with every row, and is short with what no importer may do."""

    lines: Path = Path()
    usual: float = 0.0
    seen: int = 0

    def over(self) -> bool:
        """Whether the present row has taken too long."""
        told = _read(self.lines)
        if len(told) > self.seen:
            brief = told[-1].get("begin", "").removesuffix(SECOND) in NOT_ALLOWED
            self.seen, self.since, self.limit = len(told), time.monotonic(), BRIEF if brief else self.usual
        return super().over()


def _read(lines: Path) -> list[dict[str, str]]:
    """What a child has told so far; a line that it is still writing is left out."""
    text = lines.read_text(encoding="utf-8") if lines.exists() else ""
    return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]


def _fair(entry: dict[str, str], verdict: str, detail: str) -> tuple[str, str]:
    """A rule is broken only where an importer may do what was tried, and by the FMU, not by another program."""
    fair = entry["probe"] not in NOT_ALLOWED and entry["group"] != GATES_GROUP
    return (REMARK, detail) if verdict == FAIL and not fair else (verdict, detail)
