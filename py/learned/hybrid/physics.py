"""A physical model as a file of data: its equations as a tape, its signals and values beside them.

For a model that was written in Python, so that a hybrid on it runs by its own name: a data file may start no code, and
what the residual was learned for stays what it is when that code changes.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import casadi as ca
import numpy as np
import tomlkit

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import FlatModel, ParameterValue, Signal, StateVariable
from hydrotwin.models.language.parameter_file import read_toml
from hydrotwin.models.language.writing import toml_values, write_whole

from . import tape

KIND, VERSION = "physics", 1
PARTS = {"inputs": Signal, "outputs": Signal, "states": StateVariable, "parameters": ParameterValue}


@dataclass(frozen=True)
class _Starts:
    """The ``initialisation`` of a read model: a start for every choice of given states that a block asks for."""

    made: Mapping[tuple[str, ...], ca.Function]
    model: str

    def __call__(self, given: tuple[str, ...]) -> ca.Function:
        """The start with ``given`` states."""
        if given not in self.made:
            raise DataError(
                f"{self.model}: its file has no start with {', '.join(given)} given. Load the model itself for that."
            )
        return self.made[given]


def write_physics(model, path: Path) -> tuple[Path, Path]:
    """Write a model as ``path`` (.toml) and its equations beside it (.npz).

    Raises DeclarationError where its equations are no arithmetic of scalars.
    """
    flat = getattr(model, "flat", model)
    functions = {"ode": flat.ode} | {f"start_{k}": flat.start_given(g) for k, g in enumerate(_choices(flat))}
    packed, arrays = io.BytesIO(), path.with_suffix(".npz")
    np.savez(packed, **{f"{name}.{part}": a for name, f in functions.items() for part, a in tape.written(f).items()})
    header = {
        "kind": KIND,
        "version": VERSION,
        "sha256": hashlib.sha256(packed.getvalue()).hexdigest(),
        "name": flat.name,
        "description": flat.description,
        "step": flat.step,
        **{part: [_table(item) for item in getattr(flat, part)] for part in PARTS},
    }
    write_whole(arrays, packed.getvalue())
    write_whole(path, tomlkit.dumps(header))
    return path, arrays


def read_physics(path: Path) -> FlatModel:
    """The model of a file of `write_physics`.

    Raises `DataError` naming the file where it is missing or damaged.
    """
    header = read_toml(path)
    if header.get("kind") != KIND or header.get("version") != VERSION:
        raise DataError(f"{path}: not the equations of a hybrid's model. Learn the hybrid again with learn_hybrid.")
    try:
        frame = {part: tuple(kind(**_bounded(row)) for row in header[part]) for part, kind in PARTS.items()}
        frame |= {"name": str(header["name"]), "description": str(header.get("description", ""))}
        frame["step"] = float(header["step"])
        packed = path.with_suffix(".npz").read_bytes()
        if hashlib.sha256(packed).hexdigest() != header["sha256"]:
            raise ValueError(f"{path.with_suffix('.npz').name}, which is cut off or of another hybrid")
        with np.load(io.BytesIO(packed), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        return _flat(frame, arrays, path)
    except (KeyError, TypeError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise DataError(f"{path}: lacks or garbles {error}. Copy all files of the hybrid again.") from None


def _flat(frame: dict, arrays: Mapping[str, np.ndarray], path: Path) -> FlatModel:
    nx, nu, ny, np_ = (len(frame[part]) for part in ("states", "inputs", "outputs", "parameters"))

    def made(name: str, sizes, names) -> ca.Function:
        return tape.rebuilt(name, {p: arrays[f"{name}.{p}"] for p in ("rows", "constants")}, sizes, names, str(path))

    ode = made("ode", [[1, nx, nu, np_], [nx, ny]], [["t", "x", "u", "p"], ["xdot", "y"]])
    choices = _choices(FlatModel(**frame, ode=ode, initialisation=None))
    starts = {
        given: made(f"start_{k}", [[nu, np_, len(given)], [nx]], [["u", "p", "z"], ["x"]])
        for k, given in enumerate(choices)
    }
    return FlatModel(**frame, ode=ode, initialisation=_Starts(starts, str(path)))


def _choices(flat: FlatModel) -> list[tuple[str, ...]]:
    """Which states are given in the starts that a block asks for (see `lower`)."""
    outputs = [s.name for s in flat.outputs]
    measured = tuple(s.name for s in flat.states if s.measured_by in outputs)
    others = [tuple(n for n in measured if n != name) for name in measured]
    return list(dict.fromkeys([(), measured, *others]))


def _table(item) -> dict:
    return {key: toml_values(value) for key, value in asdict(item).items() if value is not None}


def _bounded(row: Mapping) -> dict:
    """A row with its bounds as a pair; an interpolation that is left open was left out."""
    row = dict(row)
    if "bounds" in row:
        row["bounds"] = tuple(float(b) for b in row["bounds"])
    return {"interpolation": None, "chosen_by": None, **row} if "default" in row else row
