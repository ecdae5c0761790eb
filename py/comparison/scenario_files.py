"""The files that a scenario names: found from its folder, or refused with what makes them."""

from __future__ import annotations

import fnmatch
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from hydrotwin.models.language.errors import DataError, nearest

_VARIABLE = re.compile(r"\$(?:\{(\w+)\}|([A-Za-z_]\w*))")


@dataclass(frozen=True)
class Files:
    """Files as a scenario writes them: relative to it, with ``*`` and ``$VARIABLE``.

    scenario : its own path. made_by : file, or a pattern of files, as they are written in it -> the command that makes
    it; a reader sees it where the file is missing, and nothing runs it.
    """

    scenario: Path
    made_by: Mapping[str, str] = field(default_factory=dict)

    @property
    def folder(self) -> Path:
        return self.scenario.parent

    def model(self, name: str) -> Path:
        """A file of a model. Raises DataError where it is missing."""
        file = self.folder / self._expanded(name)
        if not file.exists():
            raise DataError(f"{self.scenario.name}: no model file '{name}'. {self._way_to(name, file)}")
        return file

    def recordings(self, names: Sequence[str]) -> tuple[Path, ...]:
        """The recordings named, each once; a pattern that is no file stands for all files it matches, sorted.

        Raises DataError where one is missing.
        """
        found: dict[Path, None] = {}
        for written in names:
            name = self._expanded(written)
            is_pattern = any(sign in name for sign in "*?[") and not (self.folder / name).is_file()
            matches = self._matches(name) if is_pattern else [self.folder / name]
            if not matches or not matches[0].exists():
                way = self._way_to(written, self.folder / name)
                raise DataError(f"{self.scenario.name}: no recording '{name}'. {way}")
            found |= dict.fromkeys(matches)
        return tuple(found)

    def _way_to(self, name: str, file: Path) -> str:
        """What to do where a file is missing: the command that makes it, or the file that is meant."""
        made = next((how for pattern, how in self.made_by.items() if fnmatch.fnmatchcase(name, pattern)), "")
        return f"This makes it: {made}" if made else nearest_file(file)

    def _expanded(self, name: str) -> str:
        """A path with what its environment variables say, ``$DATA/a.csv`` or ``${DATA}/a.csv``.

        Raises DataError for a variable that is not set, or empty: the rest of the path would be looked for at the root.
        """

        def value(found: re.Match) -> str:
            variable = found[1] or found[2]
            if not os.environ.get(variable):
                raise DataError(
                    f"{self.scenario.name}: '{name}' needs the environment variable {variable}, which is not set. Set "
                    f"it to the folder that is meant: export {variable}=/path/to/folder."
                )
            return os.environ[variable]

        return name if (self.folder / name).exists() else _VARIABLE.sub(value, name)

    def _matches(self, pattern: str) -> list[Path]:
        """Files that a pattern stands for; one that begins at the root is looked for from there."""
        anchor = Path(pattern).anchor
        return sorted((Path(anchor) if anchor else self.folder).glob(str(Path(pattern).relative_to(anchor))))


def nearest_file(path: Path) -> str:
    """The sentence that ends the error of a missing file: the most alike beside it."""
    folder = path.parent
    return (
        nearest(path.name, sorted(p.name for p in folder.iterdir())) if folder.is_dir() else f"{folder} is no folder."
    )
