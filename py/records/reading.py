"""How recordings are read, said once: options of a command or of `read_record`, ``import.toml`` beside the files."""

from __future__ import annotations

import fnmatch
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

from hydrotwin.models.language.errors import DataError, DeclarationError, HydrotwinError, UnitError, nearest
from hydrotwin.models.language.parameter_file import read_toml
from hydrotwin.models.language.quantities import Wanted, apart, in_unit
from hydrotwin.models.language.units import parse_unit

from .clocks import HOURS, MINUTES
from .decimal_sign import SIGNS
from .repairs import REPAIRS
from .scale import Scale, scales_of

BESIDE = "import.toml"
MISSING = ("error", "drop rows", "keep")
_TRUTH = {"true": 1.0, "false": 0.0}
_TABLES = {"columns": "columns", "units": "units", "scale": "scale", "set": "constants"}  # of a file -> fields
_PLAIN = ("time", "rate", "clock", "missing", "decimal", "delimiter", "encoding", "sheet")


@dataclass(frozen=True)
class Reading:
    """How recordings are read.

    columns : name in the record -> column of the file, ``#3`` for the third. units : column or name -> unit, in
    place of what the file says. scale : name -> what one unit of the column stands for. constants : name -> value
    and unit of what was not recorded. time : the column that is the time. rate : samples per second [Hz] in place of
    a time. clock : repairs of `repairs.REPAIRS`, parted by commas. missing : what empty cells mean, see
    `read_record`. decimal, delimiter, encoding : of text files. sheet : of a workbook.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    scale: Mapping[str, Scale] = field(default_factory=dict)
    constants: Mapping[str, str] = field(default_factory=dict)
    time: str | None = None
    rate: float | None = None
    clock: str | None = None
    missing: str | None = None
    decimal: str | None = None
    delimiter: str | None = None
    encoding: str | None = None
    sheet: str | None = None

    def over(self, other: Reading) -> Reading:
        """This one, and what it does not say from ``other``."""
        merged = {}
        for f in fields(self):
            own, theirs = getattr(self, f.name), getattr(other, f.name)
            merged[f.name] = {**theirs, **own} if isinstance(own, Mapping) else theirs if own is None else own
        for name in ("units", "scale"):  # whichever name of a column was used
            theirs = _by_variable(getattr(other, name), other.columns)
            own = _by_variable(getattr(self, name), merged["columns"])
            merged[name] = {**theirs, **own}
        if self.rate is not None or self.time is not None:  # one of them decides the time
            merged["rate"], merged["time"] = self.rate, self.time
        return Reading(**merged)

    def __bool__(self) -> bool:
        return any(getattr(self, f.name) for f in fields(self))


def _by_variable(said: Mapping, columns: Mapping[str, str]) -> dict:
    """What is said of columns, by the names that these have in the record, where one of them has it alone."""
    often = Counter(columns.values())
    variables = {r: n for n, r in columns.items() if r not in columns and often[r] == 1}
    return {variables.get(key, key): value for key, value in said.items()}


def reading_of(**said) -> Reading:
    """A `Reading` from texts, pairs or mappings. Raises `DataError` naming the nearest right word."""
    unknown = next((name for name in said if name not in {f.name for f in fields(Reading)}), None)
    if unknown:
        raise DeclarationError(f"read_record: unknown option '{unknown}'. {nearest(unknown, _all_names())}")
    said = {name: value for name, value in said.items() if value is not None}
    for name in ("columns", "units", "constants"):
        if name in said:
            said[name] = _pairs(said[name], name)
    if "scale" in said:
        said["scale"] = scales_of(said["scale"])
    if "rate" in said:
        said["rate"] = _rate(said["rate"])
    for name, choice in (("clock", REPAIRS), ("missing", MISSING)):
        for word in re.split(r"\s*,\s*", str(said[name])) if name in said else ():
            if word not in choice:
                raise DataError(f"{name}: not a choice (got {word!r}). {nearest(word, choice)}")
    if said.get("decimal", ".") not in SIGNS:
        raise DataError(f"decimal: not a decimal sign (got {said['decimal']!r}). Write '.' or ','.")
    said["delimiter"] = _delimiter(said.get("delimiter"))
    if said.get("rate") and said.get("time"):
        raise DataError("rate: a time column and a sampling rate contradict each other. Give --time or --rate.")
    for name, value in said.get("constants", {}).items():
        constant(name, value)
    for name, unit in said.get("units", {}).items():
        _checked_unit(name, unit)
    return Reading(**said)


def _all_names() -> list[str]:
    return [f.name for f in fields(Reading)]


def _pairs(given: Mapping[str, str] | Sequence[str] | str, option: str) -> dict[str, str]:
    """``name=value`` texts as a mapping; a value may hold '=' too."""
    if isinstance(given, Mapping):
        return {str(name).strip(): str(value).strip() for name, value in given.items()}
    pairs = {}
    for text in [given] if isinstance(given, str) else given:
        name, equals, value = text.rpartition("=") if option == "units" else text.partition("=")
        if not (equals and name.strip() and value.strip()):
            raise DataError(f"{option}: no 'name=value' (got '{text}'). {_EXAMPLES[option]}")
        if pairs.get(name.strip(), value.strip()) != value.strip():
            raise DataError(f"{option}: '{name.strip()}' is given twice (got '{text}' too). Leave one out.")
        pairs[name.strip()] = value.strip()
    return pairs


_EXAMPLES = {
    "columns": "Write --column command=Ventil_Soll: what the model calls it, then what the file calls it.",
    "units": "Write --unit 'Druck A=bar'.",
    "constants": "Write --set supply_pressure=35bar.",
}


def _rate(text: str | float) -> float:
    try:
        rate = in_unit(text, Wanted("rate", "Hz"), "--rate {}")
    except UnitError as error:
        raise DataError(str(error)) from None
    except DeclarationError:
        rate = 0.0
    if not rate > 0:
        raise DataError(f"rate: no sampling rate (got '{text}'). Write samples per second: --rate 1000.")
    return rate


def _delimiter(text: str | None) -> str | None:
    words = {"tab": "\t", "\\t": "\t", "semicolon": ";", "comma": ",", "space": " ", "blank": " ", "bar": "|"}
    text = words.get(str(text).lower(), text)
    if text is not None and len(text) != 1:
        raise DataError(f"delimiter: not one sign (got {text!r}). Write ';', ',', '|', tab or space.")
    return text


def _checked_unit(name: str, unit: str) -> None:
    if unit in (*MINUTES, *HOURS):
        return
    try:
        parse_unit(unit)
    except HydrotwinError as error:
        raise DataError(f"units: '{name}': {error}") from None


def check_constants(reading: Reading, signals: Collection[str], parameters: Collection[str], way: str) -> None:
    """Raises `DeclarationError` for what is said to have been constant, and is no signal: nothing would read it.

    parameters : names that somebody may have meant; way : how such a one is set, with ``{name}`` and ``{value}``.
    """
    for name, value in reading.constants.items():
        if name in signals:
            continue
        meant = nearest(name, signals)
        if name in parameters:
            meant = f"It is a parameter: {way.format(name=name, value=value)}"
        raise DeclarationError(
            f"set: '{name}' is neither an input nor an output here, so that nothing would read it. {meant}"
        )


def constant(name: str, text: str) -> tuple[float, str]:
    """``"35 bar"`` -> (35.0, "bar"). Raises `DataError` for anything else."""
    if text.strip().lower() in _TRUTH:
        return _TRUTH[text.strip().lower()], "1"
    found = apart(text)
    if not found:
        raise DataError(f"set: '{name}' is no finite number with a unit (got '{text}'). {_EXAMPLES['constants']}")
    _checked_unit(name, found[1] or "1")
    return found[0], found[1] or "1"


def is_alone(text: str) -> bool:
    """Whether a constant is a number without a unit; true and false are as they are."""
    found = apart(text)
    return found is not None and not found[1]


def beside(path: Path) -> tuple[Reading, str]:
    """What ``import.toml`` in the folder of a recording says about it, and its name; nothing where there is none."""
    file = path.parent / BESIDE
    if not file.is_file():
        return Reading(), ""
    found = read_import(file, path.name)
    return (found, BESIDE) if found is not None else (Reading(), "")


def read_import(file: Path, name: str) -> Reading | None:
    """The `Reading` that a file of this kind states; None where its ``files`` do not match the recording ``name``.

    ::

        files = ["test_*.csv"]          # optional: for which recordings; all where left out
        time = "Zeit"                   # or rate = 1000
        clock = "spread"
        [columns]
        command = "Ventil_Soll"
        [units]
        "Druck A" = "bar"
        [scale]
        command = "0.05 V/%"
        [set]
        supply_pressure = "35 bar"
    """
    said = import_from({key: value for key, value in read_toml(file).items() if key != "files"}, str(file))
    return said if _is_meant(name, patterns_of(file)) else None


def patterns_of(file: Path) -> list[str]:
    """For which recordings a file of this kind is: the patterns of its ``files``."""
    files = read_toml(file).get("files", ["*"])
    files = [files] if isinstance(files, str) else files
    if not (isinstance(files, list) and all(isinstance(pattern, str) for pattern in files)):
        raise DataError(f'{file}: files: no list of patterns (got {files!r}). Write files = ["run_*.csv"].')
    return files


def _is_meant(name: str, patterns: Sequence[str]) -> bool:
    return any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)


def with_beside(reading: Reading, paths: Sequence[Path]) -> tuple[Reading, list[str]]:
    """How recordings of one folder are read with the ``import.toml`` beside them, and the patterns for a new one."""
    names = list(dict.fromkeys(p.name for p in paths))
    near, file = beside(paths[0])
    if not file:
        return reading, names
    patterns = patterns_of(paths[0].parent / file)
    return reading.over(near), [*patterns, *(n for n in names if not _is_meant(n, patterns))]


def check_replaced(file: Path, paths: Sequence[Path]) -> None:
    """Refuse to replace an ``import.toml`` that says how other recordings than these are read."""
    if not file.is_file():
        return
    patterns = patterns_of(file)
    if not any(_is_meant(p.name, patterns) and p.parent.resolve() == file.parent.resolve() for p in paths):
        raise DataError(
            f"{file}: it is there already, for {', '.join(patterns)}, and would be lost. Write to another name, and "
            "join the two by hand."
        )


def import_from(table: Mapping, where: str) -> Reading:
    """The `Reading` that the keys of an ``import.toml`` state. Raises `DataError` naming the nearest right key."""
    known = (*_TABLES, *_PLAIN)
    for key, value in table.items():
        if key not in known:
            raise DataError(f"{where}: unknown key '{key}'. {nearest(key, known)}")
        if key in _TABLES and not isinstance(value, Mapping):
            raise DataError(f"{where}: '{key}' is a table. Write [{key}] and below it name = 'text'.")
        if key in _PLAIN and (isinstance(value, bool) or not isinstance(value, str | int | float)):
            raise DataError(f'{where}: {key}: no text (got {value!r}). Write {key} = "...".')
        if key in _PLAIN and key != "rate" and not isinstance(value, str):
            raise DataError(f'{where}: {key}: a text is needed (got {value!r}). Write {key} = "{value}".')
    said = {own: table[key] for key, own in _TABLES.items() if key in table}
    try:
        return reading_of(**said, **{key: table[key] for key in _PLAIN if key in table})
    except HydrotwinError as error:
        raise type(error)(f"{where}: {error}") from None


def import_text(reading: Reading, files: Sequence[str] = (), comments: Sequence[str] = ()) -> str:
    """An ``import.toml`` that says what ``reading`` says; comments: sentences on what a person must add."""
    import tomlkit

    document = tomlkit.document()
    document.add(tomlkit.comment("How the recordings in this folder are read: hydrotwin finds this file beside them."))
    for sentence in comments:
        document.add(tomlkit.comment(sentence))
    if files:
        document["files"] = list(files)
    for key, value in reading_told(reading).items():
        document[key] = value
    return tomlkit.dumps(document)


def reading_told(reading: Reading) -> dict:
    """As data, which `import_from` reads."""
    told = {key: value for key in _PLAIN if (value := getattr(reading, key)) is not None}
    for key, own in _TABLES.items():
        if values := getattr(reading, own):
            told[key] = {n: f"{v.factor!r} {v.unit}" if isinstance(v, Scale) else v for n, v in values.items()}
    return told
