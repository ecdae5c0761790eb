"""Of which operating condition a recording is: tags from its name, or as its scenario says."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.records import SUFFIXES, Record

_NAME = re.compile(r"\{(\w+)\}")


@dataclass(frozen=True)
class Tags:
    """What is said of conditions.

    pattern : of whole file names without suffix, such as ``load{load}_stroke{stroke}_*``; a star is anything, a value
    has no ``_``. So no value is cut without a word.
    by_file : tags by file, over those of the pattern.
    """

    pattern: str = ""
    by_file: Mapping[Path, Mapping[str, object]] = field(default_factory=dict)

    def put(self, record: Record, path: Path) -> Record:
        """The recording with its tags. Raises DeclarationError where the pattern does not fit its name."""
        said = {str(tag): str(value) for tag, value in self.by_file.get(path, {}).items()}
        return replace(record, tags={**record.tags, **self._from_name(path), **said})

    def _from_name(self, path: Path) -> dict[str, str]:
        if not self.pattern:
            return {}
        names = _NAME.findall(self.pattern)
        if not names or len(set(names)) < len(names):
            raise DeclarationError(
                f"tags: '{self.pattern}' names no tag, or one twice. Write for example 'load{{load}}_stroke{{stroke}}'."
            )
        parts = _NAME.split(self.pattern)
        fixed = [".*".join(map(re.escape, p.split("*"))) for p in parts[::2]]
        values = [f"(?P<{p}>[^_]+)" for p in parts[1::2]]
        expression = "".join(itertools.chain(*itertools.zip_longest(fixed, values, fillvalue="")))
        found = re.fullmatch(expression, _bare(path))
        if not found:
            raise DeclarationError(
                f"tags: '{self.pattern}' does not fit '{path.name}'. Mend the pattern, or give its tags beside it: "
                f"{{file = '{path.name}', tags = {{{names[0]} = ...}}}}."
            )
        return found.groupdict()


def _bare(path: Path) -> str:
    """The name of a file without the suffixes of its format; a point before them may be a decimal one."""
    name = path.name
    for suffix in (".gz", *SUFFIXES):
        name = name[: -len(suffix)] if name.lower().endswith(suffix) else name
    return name


def groups(records: Sequence[Record]) -> tuple[str, ...]:
    """Groups of recordings that share a tag, as ``tag=value``."""
    return tuple(dict.fromkeys(f"{tag}={value}" for r in records for tag, value in r.tags.items()))


def of_group(records: Sequence[Record], group: str) -> tuple[str, ...]:
    """Names of the recordings of a group, ``tag=value``, or of one name; all for ""."""
    tag, _, value = (part.strip() for part in group.partition("="))
    return tuple(r.name for r in records if group in ("", r.name) or (value and r.tags.get(tag) == value))
