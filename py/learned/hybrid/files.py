"""A hybrid in files: a header that names the model and the residual beside it. All of it is data, never code.

h.toml            which files belong together, and how the model is sampled
h_model.toml      the values of the model, as `identify` writes them
h_physics.toml    the equations of a model that was written in Python (`physics`), with h_physics.npz
h_residual.toml   the learned residual, with h_residual.npz; none where it did not help
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path

import tomlkit

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.model_file import write_model_file
from hydrotwin.models.language.parameter_file import read_toml
from hydrotwin.models.language.writing import toml_values, write_whole
from hydrotwin.simulation import TrainingDomain

from ..block_file import read_block, write_block
from .block import HybridBlock, alone, join
from .physics import read_physics, write_physics

VERSION = 1


def write_hybrid(block: HybridBlock, path: str | Path, model: str) -> tuple[Path, ...]:
    """Write ``block`` as ``path`` (.toml) with its other files, ``<stem>_model.toml`` and so on, beside it.

    model : what the physical model is called in `hydrotwin.load`, such as ``cehA:third_order``. Of one in Python,
    ``machine.py:axis``, the equations are written too, so that the hybrid runs by its own name.

    Raises `DataError` when the path does not end in .toml.
    """
    path = Path(path)
    if path.suffix != ".toml":
        raise DataError(f"{path}: a hybrid is a .toml file (got '{path.suffix}'). Write to {path.stem}.toml.")
    if not isinstance(block, HybridBlock):
        raise DataError(f"{block.name}: no hybrid (got {type(block).__name__}). Write learned blocks with write_block.")
    places = {part: path.with_name(f"{path.stem}_{part}.toml") for part in ("model", "physics", "residual")}
    written = {"model": (write_model_file(places["model"], model, block.model),)}
    if ".py:" in model:
        written["physics"] = write_physics(block.model, places["physics"])
    if block.residual is not None:
        written["residual"] = write_block(block.residual, places["residual"])
    header = {
        "kind": "hybrid",
        "version": VERSION,
        "name": block.name,
        "method": block.method,
        "substep": block.substep,
        "started_by": list(block.started_by),
        "period": block.period,
        **{part: _named(files) for part, files in written.items()},
        "provenance": toml_values(block.provenance),
    }
    if block.residual is None and block.domain is not None:
        header["domain"] = toml_values(vars(block.domain))
    write_whole(path, tomlkit.dumps(header))
    return (path, *(file for files in written.values() for file in files))


def read_hybrid(path: str | Path, load: Callable[[str], object]) -> HybridBlock:
    """Read a hybrid; ``load`` makes the physical model of a model file's path (`hydrotwin.load`).

    Raises `DataError` naming the file when one of the three is missing, damaged or of another hybrid.
    """
    path = Path(path)
    header = read_toml(path)
    if header.get("kind") != "hybrid":
        raise DataError(f"{path}: not a hybrid (got kind {header.get('kind')!r}). Write it again with write_hybrid.")
    if header.get("version") != VERSION:
        raise DataError(
            f"{path}: written in version {header.get('version')} of 'hybrid', this hydrotwin reads version {VERSION}. "
            "Learn the hybrid again, or open it with the hydrotwin that wrote it."
        )
    try:
        frame = {"name": header["name"], "method": header["method"], "substep": float(header["substep"])}
        frame["started_by"] = [str(name) for name in header["started_by"]]
        frame["provenance"] = dict(header.get("provenance", {}))
        places = {part: _beside(path, header[part]) for part in ("model", "physics", "residual") if part in header}
        model_path = places["model"]
        if "residual" not in places:
            frame |= {"period": float(header["period"]), "domain": _domain(header.get("domain"))}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(f"{path}: the header lacks or garbles {error}. Write it again with write_hybrid.") from None
    try:
        model = read_physics(places["physics"]) if "physics" in places else load(str(model_path))
        return join(model, read_block(places["residual"]), **frame) if "residual" in places else alone(model, **frame)
    except DeclarationError as error:
        raise DataError(f"{path}: {error}") from None


def _domain(table: Mapping | None) -> TrainingDomain | None:
    return table and TrainingDomain(**{key: tuple(values) for key, values in table.items()})


def _named(files: tuple[Path, ...]) -> dict[str, str]:
    """The first of the files, and the digest of them all."""
    return {"file": files[0].name, "sha256": hashlib.sha256(files[0].read_bytes()).hexdigest()}


def _beside(path: Path, entry: Mapping[str, str]) -> Path:
    """The file that the header names, in the same folder and unchanged."""
    found, digest = path.with_name(Path(entry["file"]).name), entry["sha256"]
    try:
        content = found.read_bytes()
    except OSError:
        raise DataError(f"{path}: {found} is missing. Keep the files of a hybrid in one folder.") from None
    if hashlib.sha256(content).hexdigest() != digest:
        raise DataError(
            f"{found}: not the file that {path.name} was written with (sha256 differs). The residual was learned for "
            "that very model: learn it again with learn_hybrid, or copy all files again."
        )
    return found
