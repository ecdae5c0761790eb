"""What an FMU carries along of where its numbers can be trusted: experiments that can be run again, and its record.

By FMI-LS-REF (see `related`): a smoke test and validation experiments with their inputs, start values and expected
outputs, and ``credibility.toml``: what the model file says of where the model was fitted and judged, with the hash of
the FMU's parameter values, of every file beside it, and of all that the FMU computes with and says of itself.
"""

from __future__ import annotations

import json
import posixpath
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tomlkit

from hydrotwin.models.language.credibility import Credibility
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.records import Record

from .archive import read_file
from .experiments import TYPE, Experiment, experiments_text, series_text
from .foreign import Description
from .inside import RECORD_FILE, RECORD_FORMAT, made_of, sha256_of
from .parameter_sets import own_unit
from .reader import FmuBlock, read_fmu
from .related import FOLDER, MANIFEST, REPORT, SMOKE, VALIDATION, Related, manifest_text
from .ssp_text import Parameter, parameter_set

TOLD = "documentation/fmi-ls-ref.txt"
SMALL = 500_000  # bytes of text up to which the smoke test, which nobody asked for, goes along
LARGEST = 20_000_000  # bytes of text of all experiments: an FMU is sent by mail


@dataclass(frozen=True, eq=False)
class Carried:
    """What an FMU is to carry along.

    smoke : a short run of our own. experiments : recordings with the outputs of the model. credibility : of its model
    file. agreement : how far a replay may be off, relative to the range of each output.
    """

    smoke: Record | None = None
    experiments: Sequence[Record] = ()
    credibility: Credibility | None = None
    agreement: float = 1e-6

    def __bool__(self) -> bool:
        return self.smoke is not None or bool(self.experiments) or self.credibility is not None


def reference_files(path: Path, carried: Carried, tool: str) -> dict[str, str | bytes]:
    """Files for the finished FMU at ``path``. Raises DeclarationError for too much, DataError for what does not fit."""
    fmu = read_fmu(path, interpolation="hold")
    files: dict[str, str | bytes] = {}
    related = []
    if carried.smoke is not None:
        found = _set_of("smoke-test", [carried.smoke], fmu, carried.agreement, tool)
        if _size(found) <= SMALL:
            files |= found
            told = "A short run of hydrotwin, to see that the FMU gives the same numbers elsewhere"
            related.append(Related(f"{FOLDER}/smoke-test.exp", SMOKE, TYPE, told))
    if carried.experiments:
        found = _set_of("validation", carried.experiments, fmu, carried.agreement, tool)
        _check_size(_size(found), path, carried.experiments)
        files |= found
        told = "Inputs of recordings, and what the model gives for them"
        related.append(Related(f"{FOLDER}/validation.exp", VALIDATION, TYPE, told))
    if carried.credibility is not None:
        files[RECORD_FILE] = _record_text(
            fmu, carried.credibility, (files, {n: read_file(path, n) for n in made_of(path)}), tool
        )
        told = "Where the model was fitted and judged: recordings by hash, criteria, results, versions"
        related.append(Related(RECORD_FILE, REPORT, "application/toml", told))
    return files | ({MANIFEST: manifest_text(related), TOLD: _told(related, carried)} if related else {})


def _told(related: Sequence[Related], carried: Carried) -> str:
    """What a reader of the FMU should know of these files, as the layered standard recommends."""
    listed = "".join(f"  {posixpath.relpath(one.path, FOLDER)} ({one.role}): {one.description}\n" for one in related)
    return (
        f"Files of this FMU by FMI-LS-REF, in {FOLDER}:\n\n{listed}\n"
        "Experiments: inputs (..-in.csv) are held between their samples, start values (..-start.ssv) are parameters\n"
        "of the FMU, expected outputs (..-ref.csv) are what hydrotwin's simulation gives, in the units of the FMU.\n"
        f"An importer that steps from sample to sample differs by less than {carried.agreement:g} of the range of\n"
        "each output. Run them again: hydrotwin check X.fmu --replay\n"
    )


def _size(files: Mapping[str, str | bytes]) -> int:
    return sum(len(text) for text in files.values())


def _check_size(size: int, path: Path, records: Sequence[Record]) -> None:
    if size > LARGEST:
        raise DeclarationError(
            f"{path.name}: {len(records)} experiments are {size / 1e6:.0f} MB of text, and an FMU takes "
            f"{LARGEST / 1e6:.0f}. Take fewer or shorter recordings, or resample them."
        )


def _set_of(kind: str, records: Sequence[Record], fmu: FmuBlock, agreement: float, tool: str) -> dict[str, str]:
    """The files of one set of experiments."""
    files, rows = {}, []
    for number, record in enumerate(records, 1):
        name = kind if len(records) == 1 else f"{kind}-{number}"
        files |= _tables(f"{FOLDER}/{name}", record, fmu, tool)
        paths = {
            part: path for part in ("in.csv", "ref.csv", "start.ssv") if (path := f"{FOLDER}/{name}-{part}") in files
        }
        time = record.time - record.time[0]
        rows.append(
            Experiment(
                record.name, paths.get("in.csv", ""), paths["ref.csv"], paths.get("start.ssv", ""),
                f"{len(record)} samples, inputs held between them", 0.0, float(time[-1]),
                float(np.median(np.diff(time))), agreement=agreement, held=True,
            )
        )  # fmt: skip
    return files | {f"{FOLDER}/{kind}.exp": experiments_text(kind, rows, FOLDER)}


def _tables(stem: str, record: Record, fmu: FmuBlock, tool: str) -> dict[str, str]:
    """Stimuli, expected outputs and start values of one experiment, in the FMU's own units."""
    time, of = record.time - record.time[0], fmu.description.fmu_names
    lost = [s.name for s in fmu.inputs if s.name not in record]
    outputs = [s.name for s in fmu.outputs if s.name in record]
    if lost or not outputs or len(record) < 2:
        what = f"lacks {', '.join(lost)}" if lost else "has no output of it, or no two samples"
        raise DataError(f"{record.source or record.name}: as an experiment of {fmu.name} it {what}. Take another one.")
    inputs = {of[s.name]: fmu.in_own_units(of[s.name], record, s.name) for s in fmu.inputs}
    answers = {of[name]: fmu.in_own_units(of[name], record, name) for name in outputs}
    starts = {p: float(fmu.in_own_units(p, record, o, slice(1))[0]) for p, o in fmu.starts.items() if o in outputs}
    values = [Parameter(name, value, own_unit(name, fmu.description)) for name, value in starts.items()]
    files = {f"{stem}-in.csv": series_text(time, inputs)} if inputs else {}
    files[f"{stem}-ref.csv"] = series_text(time, answers)
    return files | ({f"{stem}-start.ssv": parameter_set(f"start of {record.name}", tool, values)} if values else {})


def _record_text(
    fmu: FmuBlock, credibility: Credibility, files: tuple[Mapping[str, str | bytes], Mapping[str, bytes]], tool: str
) -> str:
    """files : those beside the record, and those that the FMU is made of."""
    beside, computes = ({name: sha256_of(text) for name, text in sorted(some.items())} for some in files)
    content = {
        "format": RECORD_FORMAT,
        "made_by": tool,
        "model": fmu.name,
        "parameters_sha256": parameters_digest(fmu.description),
        "files": beside,
        "made_of": computes,
    }
    return f"{tomlkit.dumps(content)}\n{credibility.as_toml()}"


def parameters_digest(description: Description) -> str:
    """SHA-256 of the parameters of an FMU and their start values, as its modelDescription.xml says them."""
    rows = [(v.name, str(v.start)) for v in description.source.modelVariables if v.causality == "parameter"]
    return sha256_of(json.dumps(sorted(rows), ensure_ascii=False))
