"""What is shipped: one folder with an fmu.toml each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import hydrotwin as ht
from hydrotwin.commands.exporting import equations_told, given_starts
from hydrotwin.export import export_fmu, reference_run
from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.parameter_file import read_toml
from hydrotwin.records import Record

HERE = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Shipped:
    """The content of an fmu.toml.

    model : MODEL of the command line; a ``.toml`` lies in the same folder.
    name : of the model inside, its own by default.
    fmi, kind, platforms, step [s], communication_step [s], licence : see `export_fmu`.
    start : "positions" or "measured", see ``hydrotwin export``.
    parameters : globs of those that the README shows.
    """

    folder: Path
    model: str
    title: str
    fmi: Sequence[int] = (2, 3)
    kind: str = "both"
    name: str = ""
    start: str = "positions"
    step: float | None = None
    communication_step: float | None = None
    platforms: Sequence[str] | None = None
    parameters: Sequence[str] = ("*",)
    licence: str = ""

    @property
    def reference(self) -> Path:
        """Input and output that any tool can replay."""
        return self.folder / "reference.csv"

    def load(self):
        """The Model or Block."""
        own = self.folder / self.model
        thing = ht.load(str(own) if own.is_file() else self.model)
        return thing.but(name=self.name) if self.name else thing

    def file(self, fmi: int) -> Path:
        """Where the FMU of a version of FMI is built."""
        return self.folder / f"{self.folder.name}_fmi{fmi}.fmu"

    def build(self, fmi: int, reference: Record, path: Path | None = None) -> Path:
        """Write the FMU with its reference inside. Raises DeclarationError or SolveError as `export_fmu`."""
        thing = self.load()
        return export_fmu(
            thing, path or self.file(fmi), fmi=fmi, kind=self.kind, given=given_starts(thing, self.start),
            step=self.step, step_size=self.communication_step, platforms=self.platforms, reference=reference,
            licence=self.licence, equations=equations_told(thing),
        )  # fmt: skip

    def reference_run(self) -> Record:
        """The reference, simulated anew; a model with a quarter of the steps inside the FMU, as near to exact."""
        thing = self.load()
        return reference_run(thing, step=(self.step or thing.flat.step) / 4 if hasattr(thing, "flat") else None)


def read_shipped(folder: Path) -> Shipped:
    """Read a folder's fmu.toml. Raises DataError for a file that is missing or says what has no place in it."""
    path = folder / "fmu.toml"
    content = read_toml(path)
    known = [f.name for f in fields(Shipped) if f.name != "folder"]
    for key in content:
        if key not in known:
            raise DataError(f"{path}: unknown key '{key}'. {nearest(key, known)}")
    for key in ("model", "title"):
        if not isinstance(content.get(key), str):
            raise DataError(f"{path}: no text '{key}' (got {content.get(key)!r}). Write {key} = \"...\".")
    return Shipped(folder, **content)


def all_shipped(root: Path = HERE, names: Sequence[str] = ()) -> list[Shipped]:
    """Every shipped FMU under ``root``, or those that are named. Raises DeclarationError for a name that is none."""
    known = sorted(path.parent.name for path in root.glob("*/fmu.toml"))
    for name in names:
        if name not in known:
            raise DeclarationError(f"{root}: no shipped FMU '{name}'. {nearest(name, known)}")
    return [read_shipped(root / name) for name in (names or known)]
