"""What is tried of an FMU in child processes, in which order, and what a crash or a hang means."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

from fmpy.model_description import ModelDescription

from .child_process import HANG, start_child
from .fmu_process.exchange_probes import EXCHANGE_PROBES
from .fmu_process.gates import GATES
from .fmu_process.probes import PROBES
from .fmu_process.probing import GATES_GROUP, LOADS, RUNS
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
    wanted = dict(zip(GATES, (slave, exchange, slave and not fmi3, exchange and fmi3), strict=True))
    needs = dict(zip(GATES, (RUNS, RUNS + second, RUNS, RUNS + second), strict=True))
    plan += [{"row": n, "group": GATES_GROUP, "probe": n, "needs": needs[n]} for n in GATES if wanted[n]]
    return plan


def _rows(group: str, probes, suffix: str) -> list[dict[str, str]]:
    needs = {LOADS: "", RUNS: LOADS + suffix}
    return [
        {"row": name + suffix, "group": group, "probe": name, "needs": needs.get(name, RUNS + suffix)}
        for name in (LOADS, *probes)
    ]


def tried_rows(path: Path, plan: list[dict[str, str]], elsewhere: str, limit: float) -> list[Row]:
    """Each row of the plan with its verdict; ``elsewhere`` says why none can be tried here.

    One child process tries what an importer may do, another the rest, whose memory may be spoilt after it; after a
    crash or a hang what is left goes on in a new one.
    """
    if elsewhere:
        return [(entry["row"], (NOT_TRIED, elsewhere)) for entry in plan]
    found: dict[str, tuple[str, str]] = {}
    for allowed in (True, False):
        part = [entry for entry in plan if (entry["probe"] not in NOT_ALLOWED) == allowed]
        while left := [entry for entry in part if entry["row"] not in found]:
            found |= _in_child(path, left, found, limit if allowed else min(limit, BRIEF))
    return [(entry["row"], _fair(entry, *found[entry["row"]])) for entry in plan]


def _in_child(path: Path, left: list[dict[str, str]], found: dict, limit: float) -> dict[str, tuple[str, str]]:
    """Rows of ``left`` as far as one child process comes."""
    spoilt = [row for row, (verdict, _) in found.items() if verdict not in GOOD]
    with tempfile.TemporaryDirectory(prefix="hydrotwin-check-", ignore_cleanup_errors=True) as folder:
        job, lines = {"task": "probe", "path": str(path.absolute()), "plan": left}, Path(folder) / "rows.jsonl"
        failure = start_child(job | {"spoilt": spoilt}, {}, limit, Path(folder), sign_of_life=lines)
        text = lines.read_text(encoding="utf-8") if lines.exists() else ""
    entries = [json.loads(line) for line in text.splitlines()]
    rows = {e["name"]: (e["verdict"], e["detail"]) for e in entries if "name" in e}
    stopped = next((entry for entry in left if entry["row"] not in rows), None)
    if failure and stopped:
        slow = failure.startswith(HANG) and stopped["probe"] not in (LOADS, RUNS)
        rows[stopped["row"]] = (NOT_TRIED if slow else FAIL, failure)
    return rows


def _fair(entry: dict[str, str], verdict: str, detail: str) -> tuple[str, str]:
    """A rule is broken only where an importer may do what was tried, and by the FMU, not by another program."""
    fair = entry["probe"] not in NOT_ALLOWED and entry["group"] != GATES_GROUP
    return (REMARK, detail) if verdict == FAIL and not fair else (verdict, detail)
