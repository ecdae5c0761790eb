"""Probes one after the other, a line when one begins and a line when it ends; and whose fault a failure is."""

from __future__ import annotations

import ctypes
import json
import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from fmpy import platform as system
from fmpy import platform_tuple, sharedLibraryExtension
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Model, FMU2Slave
from fmpy.fmi3 import FMU3Model, FMU3ScheduledExecution, FMU3Slave
from fmpy.model_description import ModelDescription

from .exchange_probes import EXCHANGE_PROBES
from .exchanger import ExchangeTrial
from .gates import GATES
from .probes import PROBES
from .trial import Trial
from .verdicts import FAIL, GOOD, NOT_TRIED, PASS, NotTried

LOADS, RUNS, GATES_GROUP = "loads", "runs", "gates"
READING, START_VALUES, STATES = "reading", "start values", "number of states"
LACKS = re.compile(
    r"(?P<library>[^\s:/]+): cannot open shared object file|version `|executable stack|cannot allocate|"
    r"Library not loaded|image not found|WinError 126"
)
"""What a loader says where the machine lacks something, and the library itself may be good."""
SHOWN = 300  # characters of what the FMU said last


@dataclass
class Probing:
    """One FMU, unpacked, in whichever interface a probe asks for."""

    description: ModelDescription
    unzipped: str
    path: str

    @property
    def needs_tool(self) -> str:
        """What must be installed for it to run, "" where it says that it needs nothing."""
        offered = [kind for kind in (self.description.coSimulation, self.description.modelExchange) if kind is not None]
        needs = any(kind.needsExecutionTool in (True, "true", "1") for kind in offered)
        return f"{self.description.generationTool or 'the tool that made it'} (needsExecutionTool)" if needs else ""

    @cached_property
    def slave(self) -> Trial:
        """What the probes of Co-Simulation share."""
        return Trial(self.description, self.unzipped)

    @cached_property
    def exchanger(self) -> ExchangeTrial:
        """What the probes of Model Exchange share."""
        return ExchangeTrial(self.description, self.unzipped)

    def probe(self, group: str, name: str) -> Callable[[], tuple[str, str]]:
        """The probe of that name among those of "CoSimulation", "ModelExchange" or "gates"."""
        if name == LOADS:
            return lambda: _loads(self.description, self.unzipped, group)
        if group == GATES_GROUP:
            return lambda: GATES[name](self.description, self.unzipped, self.path)
        if group == "CoSimulation":
            return lambda: PROBES[name](self.slave)
        return lambda: EXCHANGE_PROBES[name](self.exchanger)


def run_probes(plan: Sequence[Mapping[str, str]], spoilt: set[str], probing: Probing, rows: Path):
    """Append a line when a row of the plan begins and one when it ends, so that a crash shows where it happened.

    Each row of the plan has its ``row``, the ``group`` and the name of its ``probe``, and in ``needs`` the row without
    which it is not tried. ``spoilt`` are rows that were not good in a process before.
    """
    with rows.open("a", encoding="utf-8") as stream:
        for entry in plan:
            _write(stream, {"begin": entry["row"]})
            if entry["needs"] in spoilt:
                verdict, detail = NOT_TRIED, f"it does not run here, see '{entry['needs']}'"
            else:
                verdict, detail = _judged(probing.probe(entry["group"], entry["probe"]))
            if verdict == FAIL and entry["probe"] in (LOADS, RUNS) and probing.needs_tool:
                verdict, detail = NOT_TRIED, f"it does not run without {probing.needs_tool}: {detail}"
            if verdict not in GOOD:
                spoilt.add(entry["row"])
            _write(stream, {"name": entry["row"], "verdict": verdict, "detail": detail})


def _write(stream, line: dict):
    stream.write(json.dumps(line) + "\n")
    stream.flush()


def _judged(probe: Callable[[], tuple[str, str]]) -> tuple[str, str]:
    """The answer of a probe; what the FMU refuses is the FMU's, any other failure is ours."""
    before = _said_bytes()
    try:
        return probe()
    except NotTried as reason:
        return NOT_TRIED, str(reason)
    except (FMICallException, RuntimeError) as failure:
        return FAIL, f"{failure}{_said_since(before)}"
    except Exception as failure:
        told = f"{type(failure).__name__}: {failure}"
        return NOT_TRIED, f"the probe itself failed, which says nothing of the FMU ({told})"


def _said_bytes() -> int:
    return os.fstat(1).st_size


def _said_since(before: int) -> str:
    """What the FMU printed or logged meanwhile: standard output is a file in the folder of the job."""
    sys.stdout.flush()
    ctypes.CDLL(None).fflush(None) if os.name == "posix" else None
    file = Path("said.txt")
    said = file.read_bytes()[before:].decode(errors="replace").strip() if file.exists() else ""
    return f"; it said: {' '.join(said.split())[-SHOWN:]}" if said else ""


def _loads(description: ModelDescription, unzipped: str, interface: str) -> tuple[str, str]:
    """The library for this machine can be loaded and has every function of the interface."""
    part = description.coSimulation if interface == "CoSimulation" else description.modelExchange
    folders = [Path(unzipped) / "binaries" / name for name in (system, platform_tuple)]
    library = next((f for d in folders if (f := d / f"{part.modelIdentifier}{sharedLibraryExtension}").is_file()), None)
    if library is None:
        return FAIL, f"there is a folder for this machine without {part.modelIdentifier}{sharedLibraryExtension} in it"
    os.chdir(library.parent)  # as importers do: some libraries look for others beside themselves
    try:
        functions = ctypes.CDLL(str(library))
    except OSError as failure:
        return _not_loaded(library.name, str(failure).replace(str(library), library.name))
    finally:
        os.chdir(Path(unzipped).parent)
    wanted = _functions(description.fmiVersion, interface)
    missing = [name for name in wanted if not hasattr(functions, name)]
    if missing:
        return FAIL, f"{len(missing)} of {len(wanted)} functions are missing: {', '.join(missing[:3])}"
    return PASS, f"{library.name} has all {len(wanted)} functions"


def _not_loaded(library: str, said: str) -> tuple[str, str]:
    """What a loader that refuses a library says of it, unless it is the machine that lacks something."""
    reason = said.removeprefix(f"{library}: ")
    lacks = LACKS.search(said)
    if lacks and lacks["library"] != library:
        raise NotTried(f"its library cannot be loaded on this machine ({reason}). Install what it needs")
    if lacks:  # what a loader says of a library for another kind of processor
        reason = "it is damaged or made for another machine"
    return FAIL, f"{library} is no library that this machine can load: {reason}. Ask its maker for a good one"


def _functions(version: str, interface: str) -> list[str]:
    """The functions that must be there: of FMI 2 those of the interface, of FMI 3 all."""
    if version.startswith("3"):
        kinds = (FMU3Model, FMU3Slave, FMU3ScheduledExecution)
        return sorted({name for kind in kinds for name in dir(kind) if name.startswith("fmi3")})
    return [n for n in dir(FMU2Slave if interface == "CoSimulation" else FMU2Model) if n.startswith("fmi2")]
