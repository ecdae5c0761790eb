"""Learned blocks as files: a TOML header anyone can read and a ``.npz`` of arrays beside it; data, never code.

Each kind of learned block (`LearnedKind`) says which arrays it needs and how its CasADi step is built from them, so a
file is opened with numpy and CasADi alone. Nothing is unpickled and nothing is executed.
"""

from __future__ import annotations

import hashlib
import io
import tomllib
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import casadi as ca
import numpy as np
import tomlkit

from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import ParameterValue, Signal, StateVariable
from hydrotwin.models.language.writing import toml_values, write_whole
from hydrotwin.simulation.block import Block, TrainingDomain

from .steady_step import steadied, steady_arrays
from .substeps_step import STEPS, slow_structure, with_substeps

Shapes = Mapping[str, tuple[int, ...]]


@dataclass(frozen=True)
class Certificate:
    """How well the deployed step repeats what was trained: the largest difference, relative to the outputs' scale."""

    difference: float
    tolerance: float
    points: int
    reference: str

    @property
    def holds(self) -> bool:
        """Whether the deployed block is the trained one, to the tolerance."""
        return self.difference <= self.tolerance


@dataclass(frozen=True)
class LearnedKind:
    """A kind of learned block.

    shapes : ``(structure, inputs, outputs) -> {array: shape}``, from the counts in the header.
    functions : ``(arrays, structure) -> (step, start)``, the CasADi functions of `Block`.
    """

    name: str
    version: int
    shapes: Callable[[Mapping[str, int], int, int], Shapes]
    functions: Callable[[Mapping[str, np.ndarray], Mapping[str, int]], tuple[ca.Function, ca.Function]]


@dataclass(frozen=True, eq=False)
class LearnedBlock(Block):
    """A Block with the arrays it was built from, so that it can be written and rebuilt.

    structure : the counts that fix the shapes (lags, hidden units, ...).
    certificate : the check of the deployed step against the trained one; None where nothing was trained.
    """

    kind: str = ""
    structure: Mapping[str, int] = field(default_factory=dict)
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict, repr=False)
    certificate: Certificate | None = None


_KINDS: dict[str, LearnedKind] = {}


def register_kind(kind: LearnedKind) -> LearnedKind:
    """Make a kind known to `read_block`; a name can be taken once."""
    if _KINDS.get(kind.name, kind) is not kind:
        raise DeclarationError(f"learned kind '{kind.name}': registered twice. Give the second one another name.")
    _KINDS[kind.name] = kind
    return kind


def learned_kinds() -> tuple[LearnedKind, ...]:
    """Every registered kind, for the contract tests."""
    return tuple(_KINDS.values())


def assemble(
    kind: LearnedKind, arrays: Mapping[str, np.ndarray], structure: Mapping[str, int], *, where: str = "", **frame
) -> LearnedBlock:
    """Build the block of ``kind`` from its arrays; ``frame`` holds the other fields of `LearnedBlock`.

    Raises `DataError` when an array is missing, misshapen or not finite.
    """
    where, slow, steps = where or frame["name"], slow_structure(structure), _substeps(structure, where)
    try:
        expected = kind.shapes(slow, len(frame["inputs"]), len(frame["outputs"]))
    except TypeError:
        raise DataError(f"{where}: not the counts of a {kind.name} (got {dict(structure)}). Train it again.") from None
    checked = {name: _checked_array(arrays, name, shape, where) for name, shape in expected.items()}
    step, start = kind.functions(checked, slow)
    if steps > 1:
        step, start = with_substeps(step, start, frame["states"], frame["inputs"], steps)
    _check_sizes(step, frame, where)
    steady = steady_arrays(arrays, len(frame["inputs"]), frame["states"], where)
    if steady:
        checked |= steady
        step = steadied(step, steady, frame["inputs"], frame["outputs"], frame["states"], frame["period"])
    return LearnedBlock(step=step, start=start, kind=kind.name, structure=dict(structure), arrays=checked, **frame)


def _substeps(structure: Mapping[str, int], where: str) -> int:
    steps = structure.get(STEPS, 1)
    if not (isinstance(steps, int) and steps >= 1):
        raise DataError(f"{where}: {STEPS} must be a whole number from 1 up (got {steps}). Write the block again.")
    return steps


def kind_of(block: LearnedBlock) -> LearnedKind:
    """The registered kind of a block."""
    return _KINDS[block.kind]


def write_block(block: LearnedBlock, path: str | Path) -> tuple[Path, Path]:
    """Write ``block`` as ``path`` (.toml) and the arrays beside it (.npz); answers both paths.

    Raises `DataError` when the block was not built from arrays or the path does not end in .toml.
    """
    path = Path(path)
    if path.suffix != ".toml":
        raise DataError(f"{path}: a learned block is a .toml file (got '{path.suffix}'). Write to {path.stem}.toml.")
    if not isinstance(block, LearnedBlock) or block.kind not in _KINDS:
        raise DataError(
            f"{block.name}: only learned blocks have a block file (got {type(block).__name__}). "
            f"{nearest(getattr(block, 'kind', ''), _KINDS)} Export other blocks as an FMU."
        )
    packed = io.BytesIO()
    np.savez(packed, **block.arrays)
    arrays_path = path.with_suffix(".npz")
    header = tomlkit.dumps(_header(block, arrays_path.name, packed.getvalue()))
    write_whole(arrays_path, packed.getvalue())
    write_whole(path, header)
    return path, arrays_path


def read_block(path: str | Path) -> LearnedBlock:
    """Read a learned block; needs numpy and CasADi only.

    Raises `DataError` naming the file when it is missing, damaged, of another version or of an unknown kind.
    """
    path = Path(path)
    header = _read_header(path)
    kind = _known_kind(header, path)
    try:
        frame = _frame(header)
        structure = dict(header["structure"])
        arrays_name, digest = header["arrays"]["file"], header["arrays"]["sha256"]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(
            f"{path}: the header lacks or garbles {error}. If it was cut off, copy both files again; "
            "else write the block again with write_block."
        ) from None
    arrays = _read_arrays(path.with_name(Path(arrays_name).name), digest, path)
    return assemble(kind, arrays, structure, where=str(path), **frame)


def _header(block: LearnedBlock, arrays_name: str, packed: bytes) -> dict:
    header = {
        "kind": block.kind,
        "version": _KINDS[block.kind].version,
        "name": block.name,
        "description": block.description,
        "period": block.period,
        "structure": dict(block.structure),
        "arrays": {"file": arrays_name, "sha256": hashlib.sha256(packed).hexdigest()},
        "inputs": [_table(s) for s in block.inputs],
        "outputs": [_table(s) for s in block.outputs],
        "states": [_table(s) for s in block.states],
        "parameters": [_table(p) for p in block.parameters],
        "provenance": toml_values(block.provenance),
    }
    if block.domain is not None:
        header["domain"] = _table(block.domain)
    if block.certificate is not None:
        header["certificate"] = _table(block.certificate)
    return header


def _table(item) -> dict:
    return {key: toml_values(value) for key, value in asdict(item).items() if value is not None}


def _frame(header: Mapping) -> dict:
    def bounded(table):
        return {**table, "bounds": tuple(table["bounds"])}

    domain = header.get("domain")
    certificate = header.get("certificate")
    return {
        "name": header["name"],
        "description": header.get("description", ""),
        "period": float(header["period"]),
        "inputs": tuple(Signal(**{"interpolation": None, "chosen_by": None, **t}) for t in header["inputs"]),
        "outputs": tuple(Signal(**t) for t in header["outputs"]),
        "states": tuple(StateVariable(**bounded(t)) for t in header["states"]),
        "parameters": tuple(ParameterValue(**bounded(t)) for t in header.get("parameters", [])),
        "domain": domain and TrainingDomain(**{k: tuple(v) for k, v in domain.items()}),
        "certificate": certificate and Certificate(**certificate),
        "provenance": dict(header.get("provenance", {})),
    }


def _read_header(path: Path) -> dict:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DataError(f"{path}: no such file. A learned block is a .toml with its .npz beside it.") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise DataError(
            f"{path}: not a readable TOML header ({error}). Write the block again with write_block."
        ) from None


def _known_kind(header: Mapping, path: Path) -> LearnedKind:
    name, version = str(header.get("kind")), header.get("version")
    if name not in _KINDS:
        raise DataError(f"{path}: unknown kind of learned block (got {name!r}). {nearest(name, _KINDS)}")
    if version != _KINDS[name].version:
        raise DataError(
            f"{path}: written in version {version} of '{name}', this hydrotwin reads version {_KINDS[name].version}. "
            "Train the block again, or open it with the hydrotwin that wrote it."
        )
    return _KINDS[name]


def _read_arrays(path: Path, digest: str, header_path: Path) -> dict[str, np.ndarray]:
    try:
        packed = path.read_bytes()
    except OSError:
        raise DataError(
            f"{header_path}: its arrays are missing (looked for {path}). Keep the .npz beside the .toml."
        ) from None
    if hashlib.sha256(packed).hexdigest() != digest:
        raise DataError(
            f"{path}: not the arrays this header was written with (sha256 differs, {len(packed)} bytes). "
            "The file is cut off or belongs to another block. Copy both files again."
        )
    try:
        with np.load(io.BytesIO(packed), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile) as error:
        raise DataError(
            f"{path}: not a readable array file ({error}). Write the block again with write_block."
        ) from None


def _checked_array(arrays: Mapping, name: str, shape: tuple[int, ...], where: str) -> np.ndarray:
    if name not in arrays:
        raise DataError(f"{where}: array '{name}' is missing. It should have shape {shape}. Write the block again.")
    array = np.array(arrays[name], dtype=float)
    if array.shape != shape:
        raise DataError(
            f"{where}: array '{name}' has the wrong shape (got {array.shape}). "
            f"The header's structure needs {shape}. Write the block again."
        )
    if not np.all(np.isfinite(array)):
        raise DataError(f"{where}: array '{name}' holds values that are not finite. Train the block again.")
    array.setflags(write=False)
    return array


def _check_sizes(step: ca.Function, frame: Mapping, where: str) -> None:
    for position, part in enumerate(("states", "inputs", "parameters")):
        if step.size1_in(position) != len(frame[part]):
            raise DataError(
                f"{where}: {len(frame[part])} {part} in the header, {step.size1_in(position)} in the arrays. "
                "Write the block again with write_block."
            )
