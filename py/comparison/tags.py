"""Of which operating condition a recording is: tags from its name, from a column, or as its scenario says."""

from __future__ import annotations

import contextlib
import datetime
import itertools
import math
import re
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, UnitError
from hydrotwin.models.language.quantities import NUMBER, number_of
from hydrotwin.models.language.units import compatible, convert, dimension, power, to_si
from hydrotwin.models.language.writing import printable
from hydrotwin.records import EXACT, SUFFIXES, Record

_NAME = re.compile(r"\{(\w+)\}")
_STEPS = re.compile(rf"(?P<column>.*\S)\s+by\s+(?P<step>{NUMBER})\s*(?P<unit>\S.*?)?\s*")
_QUANTITY = re.compile(rf"(?P<number>{NUMBER})(?:\s*(?P<unit>[^\W\d_].*|[%°‰].*)|\s+(?P<per>1/.*))?")
_NEXT_TAG = re.compile(r",(?=[^,=]+=)")
_COMMA = re.compile(r"(?<=\d),(?=\d)")  # a decimal one
SAME, ROUNDED = 1e-6, 6  # relative: a column that changes less is one number, rounded to so many digits
DIGITS = 12  # of a quantity that is told: 40 degC is 313.15 K; a number that does not change keeps as many


@dataclass(frozen=True)
class Tags:
    """What is said of conditions.

    pattern : of whole file names without suffix, such as ``load{load}_stroke{stroke}_*``; a star is anything, a value
    has no ``_``. So no value is cut without a word.
    by_file : tags by file, over those of the pattern.
    columns : tag -> the column that tells it, ``load_mass``, the same in every row; or ``oil_temperature by 10 degC``:
    the middle of what was measured, rounded to so much.
    """

    pattern: str = ""
    by_file: Mapping[Path, Mapping[str, object]] = field(default_factory=dict)
    columns: Mapping[str, str] = field(default_factory=dict)

    @property
    def read(self) -> frozenset[str]:
        """Columns that are read for them."""
        return frozenset(f["column"] if (f := _STEPS.fullmatch(what)) else what for what in self.columns.values())

    def put(self, record: Record, path: Path) -> Record:
        """The recording with its tags; what is said of a file counts before a column, and a column before its name.

        Raises DeclarationError where the pattern does not fit its name or a tag is empty, DataError and UnitError where
        a column tells no tag.
        """
        said = {printable(str(tag)).strip(): value for tag, value in self.by_file.get(path, {}).items()}
        told = {tag: _from_column(record, tag, what) for tag, what in self.columns.items() if tag not in said}
        all_told = {**self._from_name(path, {**told, **said}), **told, **said}
        found = {tag: _plain(f"tags: {tag} of {record.name}", value) for tag, value in all_told.items()}
        for tag in (t for t, value in found.items() if not value):
            raise DeclarationError(
                f"tags: {tag} of {record.name} is empty, and no criterion can name it. Say what it is."
            )
        return replace(record, tags={**record.tags, **found})

    def _from_name(self, path: Path, told: Mapping) -> dict[str, str]:
        """What the name says; where it is not of the pattern, nothing, if all that it would say is ``told``."""
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
        lacks = [name for name in names if name not in told]
        if not found and lacks:
            raise DeclarationError(
                f"tags: '{self.pattern}' does not fit '{path.name}'. Mend the pattern, or give its tags beside it: "
                f"{{file = '{path.name}', tags = {{{', '.join(f'{name} = ...' for name in lacks)}}}}}."
            )
        return found.groupdict() if found else {}


def _from_column(record: Record, tag: str, what: str) -> str:
    """What a column says of a tag: its word, or its number in the unit of the file."""
    found = _STEPS.fullmatch(what)
    name = found["column"] if found else what
    if not found and name in record.words:
        return _one_word(record, tag, name)
    values = record[name]
    unit = record.display_units.get(name, record.units[name])
    if found and not number_of(found["step"]) > 0:
        raise DeclarationError(f"tags: {tag} = '{what}': conditions differ by more than nothing. Write a step above 0.")
    alone = found and not found["unit"] and unit != "1"  # 10 of a column in % is no 1000 %
    if found and (alone or not compatible(found["unit"] or "1", record.units[name])):
        raise UnitError(
            f"tags: {tag} = '{what}': {name} is in {unit}. Write for example '{name} by {found['step']} {unit}'."
        )
    unit = (found["unit"] or "1") if found else unit
    shown = np.asarray(convert(values[np.isfinite(values)], record.units[name], unit))
    if not len(shown):
        raise DataError(f"tags: {tag} = '{what}': {record.name} has no value of {name}. Say the tag of that file.")
    digits = DIGITS
    if found:
        number = round(float(np.median(shown)) / number_of(found["step"])) * number_of(found["step"])
    elif abs(number := float(shown[0])) >= EXACT:
        raise DataError(
            f"tags: {tag} = '{what}': {name} of {record.name} has more digits than a number keeps, so two of them may "
            f"look alike. Say {tag} of each file in the scenario, or in its name (--tags)."
        )
    else:
        digits = DIGITS if np.ptp(shown) == 0 else ROUNDED
        if np.ptp(shown) > SAME * abs(number):
            raise DataError(
                f"tags: {tag} = '{what}': {name} of {record.name} changes from {shown.min():.6g} to {shown.max():.6g} "
                f"{unit}. Say by how much conditions differ: '{name} by {np.ptp(shown):.1g} {unit}'."
            )
    return f"{number + 0.0:.{digits}g}" + (f" {unit}" if unit != "1" else "")


def _one_word(record: Record, tag: str, name: str) -> str:
    """What a column of texts says. Raises DataError where it changes."""
    first, *others = record.words[name]
    if others:
        raise DataError(
            f"tags: {tag} = '{name}': {name} of {record.name} changes from '{first}' to '{others[0]}' within the "
            "recording, which is of more than one condition then. Cut the file there, or say the tag of it."
        )
    return first


def _plain(where: str, value: object) -> str:
    """A value of a tag as criteria name it, without blanks around it and line ends.

    2.0 of a scenario is 2, true is true, a date and a time are as TOML writes them. Raises DeclarationError for what
    says no one condition.
    """
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    if isinstance(value, Real) and math.isfinite(value):
        return f"{value:.15g}"
    if isinstance(value, datetime.date | datetime.time):  # a datetime is a date, too
        return value.isoformat()
    if not isinstance(value, str):
        raise DeclarationError(
            f"{where} is no one condition (got {value!r}). It is a text, a number, true or false, or a date: load = 2. "
            "What holds at once stands in tags of its own: {load = 2, oil = 'cold'}."
        )
    return printable(value).strip()


def _meaning(value: str) -> object:
    """What a value of a tag says, however it is written: a number, a quantity in SI, a date, a time, or its words.

    >>> _meaning("40") == _meaning("40.0") == _meaning("4e1"), _meaning("40degC") == _meaning("40 degC")
    (True, True)
    >>> _meaning("2 t") == _meaning("2000 kg"), _meaning("40 degC") == _meaning("313.15 K"), _meaning("2 t") == "2 t"
    (True, True, False)
    >>> _meaning("50 %") == _meaning("0,5"), _meaning("60 1/min") == _meaning("60 rpm")
    (True, True)
    """
    value = unicodedata.normalize("NFC", value)
    if value.isdecimal() and len(value) > DIGITS:
        return value  # a serial number: every digit tells
    if found := _QUANTITY.fullmatch(_COMMA.sub(".", value, count=1)):
        return _quantity(number_of(found["number"]), found["unit"] or found["per"] or "1")
    for kind in (datetime.date, datetime.time, datetime.datetime):
        try:
            return kind.fromisoformat(value)
        except ValueError:
            continue
    return value


def _quantity(number: float, unit: str) -> tuple[object, ...]:
    """A number and its unit: in SI, where it is one, with its dimension, for N/m2 is Pa; in as many digits as two ways
    of writing it share."""
    kind: tuple[object, ...] = (unit,)
    with contextlib.suppress(UnitError):
        (number, _), kind = to_si(number, unit), (*dimension(unit), power("rad", unit))
    return f"{number + 0.0:.{DIGITS}g}", *kind


def check_tags(records: Sequence[Record]) -> None:
    """Raises DeclarationError where one value is written in two ways: as two conditions, tables would part them."""
    written: dict[tuple[str, object], tuple[str, str]] = {}
    for record in records:
        for tag, value in record.tags.items():
            first, where = written.setdefault((tag, _meaning(value)), (value, record.name))
            if first != value:
                raise DeclarationError(
                    f"tags: {tag} is {first} of {where} and {value} of {record.name}: one condition, or two? Write it "
                    "one way (of a column, in one unit: COLUMN by 1 UNIT), or as words that differ: "
                    f"{{file = ..., tags = {{{tag} = 'no. {value}'}}}}."
                )


def _bare(path: Path) -> str:
    """The name of a file without the suffixes of its format; a point before them may be a decimal one."""
    name = path.name
    for suffix in (".gz", *SUFFIXES):
        name = name[: -len(suffix)] if name.lower().endswith(suffix) else name
    return printable(name)


def groups(records: Sequence[Record]) -> tuple[str, ...]:
    """Groups of recordings that share a tag, as ``tag=value``."""
    return tuple(dict.fromkeys(f"{tag}={value}" for r in records for tag, value in r.tags.items()))


def of_group(records: Sequence[Record], group: str) -> tuple[str, ...]:
    """Names of the recordings of a group, ``tag=value``, or of several at once, ``load=20, oil=40 degC``; of what is no
    tag the recording of that name; all for "".

    A tag may have a sign of equality in its name, and a value in it, as `groups` writes them. A value may be written
    otherwise than there: 40.0 is 40. A recording that is called like a tag of others does not join them.
    """
    if not group:
        return tuple(r.name for r in records)
    found, tags = _tagged(records, group), each_tag(group)
    if not found and len(tags) > 1:
        of_each = [_tagged(records, tag) for tag in tags]
        found = tuple(r.name for r in records if all(r.name in names for names in of_each))
    return found or tuple(r.name for r in records if r.name == group)


def each_tag(group: str) -> tuple[str, ...]:
    """The tags of a group of several: a comma stands before the next ``tag=``, and may be a decimal one.

    >>> each_tag("load=0,5, oil=40 degC"), each_tag("load=2"), each_tag("run_1")
    (('load=0,5', 'oil=40 degC'), ('load=2',), ('run_1',))
    """
    return tuple(part.strip() for part in _NEXT_TAG.split(group))


def _tagged(records: Sequence[Record], group: str) -> tuple[str, ...]:
    asked = {(tag, _meaning(value)) for tag, value in _parted(group)}
    told = [{(tag, _meaning(value)) for tag, value in r.tags.items()} for r in records]
    return tuple(r.name for r, tags in zip(records, told, strict=True) if asked & tags)


def _parted(group: str) -> Iterator[tuple[str, str]]:
    """Every tag and value that a text ``tag=value`` may mean: one for each sign of equality in it, quotes or none."""
    for sign in re.finditer("=", group):
        tag, value = group[: sign.start()].strip(), group[sign.end() :].strip()
        if value:
            yield tag, value
            yield tag, value.strip("\"'")
