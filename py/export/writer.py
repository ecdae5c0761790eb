"""export_fmu: a model or a block as an FMU that runs anywhere without Python."""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import re
import tempfile
import uuid
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

from hydrotwin.models.language.credibility import Credibility, with_made_from
from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.records import Record, write_record
from hydrotwin.simulation.block import Block
from hydrotwin.simulation.control import TOLERANCE

from .archive import write_archive
from .build import FMI3_FOLDERS, compile_for, platforms_named
from .description import Header, description_of_fmi2
from .description3 import build_description, description_of_fmi3
from .documentation import documentation
from .equations import equations_of
from .icon import icon
from .licences import licence_text, licences_of
from .lower import Lowered, lower_block, lower_model
from .method import choose_method, duration_of
from .reference_files import Carried, reference_files
from .sources import INTERFACES, source_files
from .terminals import terminals_and_icons
from .undelayed import without_idle_delays
from .variables import Variable, variables_of

REFERENCE_FILE = "documentation/reference.csv"
AGREEMENT = 1e-6
"""Largest difference to a reference, relative to the range of the signal, that passes."""
OTHER_SOLVER = 1e-2
"""The same where an importer's solver computes: the reference is of the solver inside."""
_PENDING_GUID = "{00000000-0000-0000-0000-000000000000}"
_INTERFACE_NAMES = {"cs": "Co-Simulation", "me": "Model Exchange"}
_EXCHANGE = "Model Exchange: the importer integrates; derivatives and outputs are computed when asked for."
_SOLVERS = {
    "explicit": "Runge-Kutta of order 4, internal steps of at most {step:g} s with the mean of the inputs over "
    "each, which ends where a late input jumps.",
    "refined": "Runge-Kutta of order 4, internal steps of at most {step:g} s with the mean of the inputs over each, "
    "cut where a late input jumps, and around contacts and other kinks until a part and its halves agree to "
    f"{TOLERANCE:g} in nominal units.",
    "implicit": "Rosenbrock method of order 5, internal steps of at most {step:g} s, each of the same cost.",
    "adaptive": "Rosenbrock method of order 5(4), adaptive, tolerance {tolerance:g} in nominal units.",
    "sampled": "A sampled block: it moves every {step:g} s and is held in between, whatever the master's step.",
}


def export_fmu(
    model,
    path: str | os.PathLike,
    *,
    fmi: int = 2,
    kind: str = "cs",
    given: Sequence[str] | None = None,
    method: str = "auto",
    step: float | None = None,
    tolerance: float = 1e-10,
    stop_time: float | None = None,
    step_size: float | None = None,
    platforms: Sequence[str] | None = None,
    history: int = 1024,
    reference: Record | None = None,
    provenance: Mapping | None = None,
    equations: str = "",
    author: str = "",
    licence: str = "",
    experiments: Sequence[Record] = (),
    credibility: Credibility | None = None,
) -> Path:
    """Write a Model, FlatModel or sampled Block as an FMU of FMI 2.0 or 3.0.

    kind : "cs" (Co-Simulation, the solver inside), "me" (Model Exchange, the importer integrates) or "both" in one
        FMU. Model Exchange is for continuous models without dead time.

    Every parameter is tunable and takes effect at the next step. Initial states are computed inside the FMU at the end
    of initialization, from the inputs, the parameters and the start parameters ``<state>.start`` (fixed), one for every
    state. Those of the states named in ``given`` are always used; by default these have an output measuring a position
    or an angle: where a recording begins differs from run to run. The others, pressures and the like, follow from them
    by the model's equations of the start, unless they are set. Of a Block, the start parameters are
    ``<output>.start``, the first measured outputs that its ``start`` function reads.

    method : "auto", "explicit", "implicit" or "adaptive" (see `method.choose_method`); auto is explicit with the step
        of `simulate`, cut around contacts and other kinks, and adaptive for stiff models. Explicit and implicit take
        every step whole, for hard real time: a communication step never costs more than the last one. Implicit is
        L-stable, for stiff models.
    step : longest internal step [s], the model's own by default.
    tolerance : of the adaptive method, in nominal units.
    stop_time, step_size : of the default experiment [s]; ten seconds by default, and more of what moves slowly.
    platforms : "linux64", "win64", "darwin64", "aarch64-linux", "aarch64-darwin", their names in FMI 3, or "all"; this
        machine's by default.
    history : pieces remembered of each input with a dead time.
    reference : a record whose inputs, replayed, gave its outputs; `check_fmu` replays it.
    provenance : shown in the documentation, on top of what the model brings along.
    equations : what a block computes, in words; of a Model the documentation has its Modelica text.
    experiments : recordings with what the model gives for them, as `reference_experiment` makes them; they and a
        ``reference`` that is small go along as FMI-LS-REF says, for whoever wants to run them again. Their inputs and
        starts are copied into the FMU.
    credibility : what holds of its model file (``file.credibility.of(file.contents)``); goes along as the FMU's record.
        It names recordings and holds no measurements. What the model says itself of which recordings its values follow
        goes along, too; of equations that are others than the fit's that alone.

    The same arguments give the same bytes. Returns the path. Raises DeclarationError for what cannot be exported,
    SolveError when no compiler works.
    """
    _refuse_unknown(fmi, kind)
    lowered, solver = _lowered(model, given, method, step, tolerance, delays=kind == "cs")
    if kind != "cs":
        _refuse_exchange(lowered, kind)
        solver = _EXCHANGE if kind == "me" else f"{_EXCHANGE} Co-Simulation: {solver}"
    variables = variables_of(lowered, always_time=fmi == 3)
    size = step_size or (lowered.step if lowered.sampled else 10 * lowered.step)
    stop_time = 5 * duration_of(lowered.step) if stop_time is None else stop_time
    sources = source_files(lowered, variables, _PENDING_GUID, history, fmi, kind)
    header = Header(
        lowered.name, _identifier(lowered.name), _PENDING_GUID, _first_sentence(lowered.description), tool_name(),
        lowered.sampled, float(stop_time), float(size), float(tolerance),
        tuple(sorted(n for n in sources if n.endswith(".c"))), lowered.restarts, float(lowered.step), author, licence,
        interfaces=INTERFACES[kind], fmi=fmi,
    )  # fmt: skip
    xml = (description_of_fmi3 if fmi == 3 else description_of_fmi2)(header, variables)
    guid = _guid_of(xml, sources)
    xml = xml.replace(_PENDING_GUID, guid)
    sources["model.c"] = sources["model.c"].replace(_PENDING_GUID, guid)
    page = documentation(
        lowered, variables, solver, _facts(header, guid), equations_of(model, equations),
        {**lowered.provenance, **getattr(model, "provenance", {}), **(provenance or {})}, licences_of(licence),
    )  # fmt: skip
    files: dict[str, str | bytes] = {
        "modelDescription.xml": xml, "documentation/index.html": page,
        "documentation/licenses/license.txt": licence_text(licence),
    }  # fmt: skip
    files |= {f"sources/{name}": text for name, text in sources.items()}
    files["sources/buildDescription.xml"] = build_description(header)
    if fmi == 3:
        files["terminalsAndIcons/terminalsAndIcons.xml"] = terminals_and_icons(variables)
    files["terminalsAndIcons/icon.png" if fmi == 3 else "model.png"] = icon(lowered.sampled)
    for name in platforms_named(platforms):
        library, content = compile_for(name, header.identifier, sources)
        files[f"binaries/{FMI3_FOLDERS[name] if fmi == 3 else name}/{library}"] = content
    if reference is not None:
        files[REFERENCE_FILE] = _reference_text(reference, variables, lowered)
    agreement = OTHER_SOLVER if kind == "me" else AGREEMENT
    credibility = with_made_from(credibility, lowered.provenance)
    _tell_left_out(lowered)
    return _with_references(path, files, Carried(reference, experiments, credibility, agreement))


class LeftOutWarning(UserWarning):
    """What an FMU cannot hold of its model; the text says what, and what to do."""


def _with_references(path: str | os.PathLike, files: Mapping[str, str | bytes], carried: Carried) -> Path:
    """Write the archive, whole or not at all; what is carried along is made for the FMU as its readers see it."""
    if not carried:
        return write_archive(path, files)
    with tempfile.TemporaryDirectory(prefix="hydrotwin-fmu-") as folder:
        bare = write_archive(Path(folder) / "bare.fmu", files)
        more = reference_files(bare, carried, tool_name())
    return write_archive(path, {**files, **more})


def _tell_left_out(lowered: Lowered) -> None:
    """Warn of what an FMU cannot say of its inputs: whoever feeds it decides."""
    late = [f"{s.name} {s.shift:+.3g} s" for s in lowered.inputs if s.shift]
    smooth = [s.name for s in lowered.inputs if s.interpolation == "smooth"]
    told = [f"takes columns later than they are stamped ({', '.join(late)})"] if late else []
    told += [f"takes inputs on smooth curves through their samples ({', '.join(smooth)})"] if smooth else []
    if told:
        warnings.warn(
            f"{lowered.name}: the model {' and '.join(told)}, which an FMU cannot say. Feed it inputs that are so.",
            LeftOutWarning,
            stacklevel=3,
        )


def _refuse_unknown(fmi: int, kind: str):
    if fmi not in (2, 3):
        raise DeclarationError(
            f"export: FMI {fmi} is not supported (got fmi={fmi!r}). FMI 2.0 and 3.0 are. Use fmi=2 or fmi=3."
        )
    if kind not in INTERFACES:
        raise DeclarationError(
            f"export: no kind of FMU '{kind}'. {nearest(str(kind), INTERFACES)} "
            "Use kind='cs' (Co-Simulation), kind='me' (Model Exchange) or kind='both'."
        )


def _refuse_exchange(lowered: Lowered, kind: str):
    """Model Exchange has continuous states only, and no memory of past inputs."""
    if lowered.sampled:
        raise DeclarationError(
            f"{lowered.name}: a sampled block cannot be Model Exchange (got kind={kind!r}). It moves every "
            f"{lowered.step:g} s and has no derivatives to integrate. Use kind='cs'."
        )
    late = [s.name for s in lowered.inputs if s.dead_time]
    if late:
        raise DeclarationError(
            f"{lowered.name}: Model Exchange cannot remember what an input was a dead time ago "
            f"(got kind={kind!r}, delayed: {', '.join(late)}). Use kind='cs', or remove the dead time from the model."
        )


def _lowered(model, given, method: str, step: float | None, tolerance: float, delays: bool) -> tuple[Lowered, str]:
    """The system to write and how it computes; without ``delays``, dead times of zero are left out."""
    if isinstance(model, Block):
        if method != "auto" or step is not None:
            raise DeclarationError(
                f"{model.name}: a sampled block has no solver inside (got method={method!r}, step={step}). It moves "
                f"every {model.period:g} s. Leave method and step away."
            )
        lowered = lower_block(model, model.name)
        return lowered, _SOLVERS["sampled"].format(step=lowered.step)
    flat = getattr(model, "flat", model)
    if not hasattr(flat, "ode"):
        raise DeclarationError(
            f"export: a {type(model).__name__} cannot become an FMU. It must be a Model, a FlatModel or a Block. "
            "A Fit has its model as fit.flat."
        )
    flat, idle = (flat, ()) if delays else without_idle_delays(flat)
    method, step, reason = choose_method(flat, method, float(flat.step if step is None else step))
    lowered = lower_model(flat, given, method, step, tolerance, flat.name)
    left_out = f" Left out, because Model Exchange knows no dead time: {', '.join(idle)} = 0 s." if idle else ""
    return lowered, f"{_SOLVERS[method].format(step=step, tolerance=tolerance)} Chosen because: {reason}.{left_out}"


def _identifier(name: str) -> str:
    """A C identifier from the model's name."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return plain if re.match(r"[A-Za-z_]", plain) else f"m_{plain}"


def _first_sentence(text: str) -> str:
    return " ".join(text.split("\n\n")[0].split())


def tool_name() -> str:
    """What files say they were made by."""
    try:
        return f"hydrotwin {importlib.metadata.version('hydrotwin')}"
    except importlib.metadata.PackageNotFoundError:
        return "hydrotwin"


def _guid_of(xml: str, sources: Mapping[str, str]) -> str:
    """A GUID that is the hash of everything the FMU computes with."""
    digest = hashlib.sha256(xml.encode())
    for name in sorted(sources):
        digest.update(f"\0{name}\0{sources[name]}".encode())
    return f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"


def _facts(header: Header, guid: str) -> dict[str, str]:
    interfaces = " and ".join(_INTERFACE_NAMES[i] for i in header.interfaces)
    return {
        "interface": f"FMI {header.fmi}.0 {interfaces}", "made by": header.tool, "GUID": guid,
        "default experiment": f"0 to {header.stop_time:g} s, communication step {header.step_size:g} s",
        "author": header.author or "not given", "licence": header.licence or "not given",
    }  # fmt: skip


def _reference_text(reference: Record, variables: Sequence[Variable], lowered: Lowered) -> str:
    """The record's inputs and outputs of the model as CSV in SI."""
    names = [v.name for v in variables if v.kind in ("input", "output") and v.name in reference.signals]
    missing = [s.name for s in lowered.inputs if s.name not in names]
    if missing or len(names) == len(lowered.inputs):
        raise DeclarationError(
            f"{lowered.name}: the reference record lacks {', '.join(missing) or 'outputs'}. "
            "It needs every input and at least one output."
        )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "reference.csv"
        chosen = Record(reference.time, {n: reference[n] for n in names}, {n: reference.units[n] for n in names})
        write_record(chosen, path)
        return path.read_text(encoding="utf-8")
