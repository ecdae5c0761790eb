"""Variants of a scenario: what each changes, and how the tables ``[variants.NAME]`` and ``[matrix]`` say it."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields

from hydrotwin.identification.beginning import check_initial_states
from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.quantities import Wanted, in_unit
from hydrotwin.simulation.propagator import METHODS

BASE = "base"  # the scenario as it stands: the variant that changes nothing
MOST_VARIANTS = 200  # each has a page of its own, of a megabyte and more
MOST_RUNS = 20_000  # models x variants x recordings: some hours on two cores
AXES = ("parameters", "effects_off", "effects_on", "step", "method", "period", "initial_states")
KEYS = (*AXES, "models")
_NAME = re.compile(r"[^:*?\[\]/\\\n]*[^:*?\[\]/\\\s]")  # stands in criteria, and names a folder
_FILES = (".html", ".md", ".json")  # of the overview, which lies beside the folders of variants


@dataclass(frozen=True)
class Variant:
    """What one variant changes; None, or nothing, for as it stands.

    parameters : value by path, a number in SI or a text with a unit; models without any of them stay as they are.
    effects_off, effects_on : effects of the models that are taken out, and effects of the catalogue that are added,
        ``effect`` or ``effect at site``; the values of these are among ``parameters``.
    step, method : longest step [s] and method of models with equations, see `prepare`.
    period : sample time [s] to which the recordings are thinned out. initial_states : as in `compare`.
    models : names of the models that it changes; all that it can by default.
    """

    name: str = BASE
    parameters: Mapping[str, float | str] = field(default_factory=dict)
    effects_off: tuple[str, ...] = ()
    effects_on: tuple[str, ...] = ()
    step: float | None = None
    method: str | None = None
    period: float | None = None
    initial_states: str | None = None
    models: tuple[str, ...] = ()

    @property
    def changes(self) -> dict:
        """What it changes, as data."""
        told = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "name"}
        return {key: dict(v) if isinstance(v, Mapping) else v for key, v in told.items() if v not in (None, (), {})}

    @property
    def folder(self) -> str:
        """A name of a folder that every file system takes, below that of the overview and none of its own files."""
        found = re.sub(r"[^0-9A-Za-z._=+-]+", "_", self.name)
        return f"_{found}" if found.startswith(".") or found.lower().endswith(_FILES) else found

    def __str__(self) -> str:
        """In words."""
        words = [f"{path} = {value_text(value)}" for path, value in self.parameters.items()]
        words += [f"without {effect}" for effect in self.effects_off] + [f"with {effect}" for effect in self.effects_on]
        words += [f"{key} {value_text(value)}" for key in AXES[3:] if (value := getattr(self, key)) is not None]
        words += [f"of {' and '.join(self.models)}"] if self.models else []
        return ", ".join(words) or "as the scenario stands"


def value_text(value: object) -> str:
    """A value of a variant in few characters, but all that tell it from another.

    >>> value_text(9e8), value_text("35 bar"), value_text(["leak", "play"]), value_text([])
    ('9e+08', '35 bar', 'leak+play', 'none')
    >>> value_text(100.00001), value_text(0.1)
    ('100.00001', '0.1')
    """
    if isinstance(value, list | tuple):
        return "+".join(map(str, value)) or "none"
    if not isinstance(value, float | int):
        return str(value)
    return f"{value:g}" if float(f"{value:g}") == value else f"{value:.15g}"


def read_variants(named: object, product: object, where: str) -> tuple[Variant, ...]:
    """The variants of a scenario file, the base first; none where it has neither table.

    named : the table ``[variants]``. product : the table ``[matrix]``: lists of values, every combination of which is a
    variant. Raises DeclarationError for keys, values and names that do not exist or say nothing.
    """
    if named is None and product is None:
        return ()
    found = [Variant(BASE), *_named(named, where), *_product(product, where)]
    for names in ([v.name for v in found], [v.folder.casefold() for v in found]):
        twice = next((n for k, n in enumerate(names) if n in names[:k]), None)
        if twice:
            raise DeclarationError(f"{where}: two variants are called '{twice}'. Give one of them another name.")
    check_many(len(found), 1, 1, where)
    return tuple(found)


def check_many(variants: int, models: int, recordings: int, where: str) -> None:
    """Raise DeclarationError for more than can be meant, with how many they are."""
    runs = variants * models * recordings
    if variants > MOST_VARIANTS:
        raise DeclarationError(
            f"{where}: {variants} variants, more than {MOST_VARIANTS}. Take fewer values in [matrix], or several files."
        )
    if runs > MOST_RUNS:
        raise DeclarationError(
            f"{where}: {models} models x {variants} variants x {recordings} recordings are {runs} runs, more than "
            f"{MOST_RUNS}. Take fewer of them, or several files."
        )


def _named(table: object, where: str) -> list[Variant]:
    if table is None:
        return []
    table = _table(table, f"{where}: 'variants'", "[variants.cold]")
    if not table:
        raise DeclarationError(f"{where}: [variants] is empty. Name one: [variants.cold].")
    return [_variant(name, said, f"{where}: [variants.{name}]") for name, said in table.items()]


def _variant(name: str, said: object, where: str) -> Variant:
    if name == BASE:
        raise DeclarationError(f"{where}: '{BASE}' is the scenario as it stands. Give the variant another name.")
    if not _NAME.fullmatch(name):
        raise DeclarationError(f"{where}: a name of a variant is a word or two, without : * ? [ ] / and \\. Rename it.")
    said = _table(said, where, "parameters = {mass = 3.0}")
    _known(said, KEYS, where)
    if not said:
        raise DeclarationError(f"{where} changes nothing. Say what: {', '.join(KEYS)}.")
    one = Variant(name, **{key: _checked(key, value, where) for key, value in said.items()})
    if not {key: value for key, value in one.changes.items() if key != "models"}:
        raise DeclarationError(f"{where} changes nothing. Say what: {', '.join(AXES)}.")
    return one


def _product(table: object, where: str) -> list[Variant]:
    """Every combination of the values of ``[matrix]``, the last key running fastest."""
    if table is None:
        return []
    where = f"{where}: [matrix]"
    table = _table(table, where, "step = [0.001, 0.002]")
    _known(table, AXES, where)
    parameters = _paths(_table(table.get("parameters", {}), f"{where} parameters", "parameters.mass = [2.0, 3.0]"))
    axes = {("parameters", path): values for path, values in parameters.items()}
    axes |= {(key, key): values for key, values in table.items() if key != "parameters"}
    if not axes:
        raise DeclarationError(f"{where} is empty. Give lists of values, such as step = [0.001, 0.002].")
    for (_, path), values in axes.items():
        if not isinstance(values, list) or not values:
            raise DeclarationError(
                f"{where} {path} is no list of values (got {values!r}). Write {path} = [...], with one value at least."
            )
    check_many(math.prod(len(values) for values in axes.values()), 1, 1, where)
    short = _short([path for _, path in axes])
    return [
        _combined(dict(zip(axes, values, strict=True)), short, where) for values in itertools.product(*axes.values())
    ]


def _combined(values: Mapping[tuple[str, str], object], short: Mapping[str, str], where: str) -> Variant:
    name = ", ".join(f"{short[path]}={value_text(value)}" for (_, path), value in values.items())
    said: dict[str, object] = {}
    for (key, path), value in values.items():
        if key == "parameters":
            said.setdefault(key, {})[path] = value
        else:
            said[key] = value
    return Variant(re.sub(r"[:*?\[\]/\\\n]", "_", name), **{key: _checked(key, v, where) for key, v in said.items()})


def _short(paths: Sequence[str]) -> dict[str, str]:
    """The last word of each path; the whole path where two end alike."""
    last = [path.rpartition(".")[2] for path in paths]
    return {path: word if last.count(word) == 1 else path for path, word in zip(paths, last, strict=True)}


def _checked(key: str, value: object, where: str):
    """The value of a key as `Variant` has it."""
    if key == "parameters":
        values = _paths(_table(value, f"{where} parameters", "parameters = {mass = 3.0}"))
        for path, one in values.items():
            if isinstance(one, bool) or not isinstance(one, float | int | str):
                raise DeclarationError(f"{where} {path} is no number (got {one!r}). Write it in SI, or '35 bar'.")
        return values
    if key in ("effects_off", "effects_on", "models"):
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise DeclarationError(f"{where} {key} is no list of texts (got {value!r}). Write {key} = ['...'].")
        return tuple(value)
    if key in ("step", "period"):
        seconds = in_unit(value, Wanted(f"{where} {key}", "s"), f"{key} = '2ms'")
        if not seconds > 0:
            raise DeclarationError(f"{where} {key} is no time above zero (got {value!r}). Write {key} = '2ms'.")
        return seconds
    if not isinstance(value, str):
        raise DeclarationError(f"{where} {key} is no text (got {value!r}). Put it in quotes.")
    if key == "initial_states":
        return check_initial_states(value, where)
    if value not in METHODS:
        raise DeclarationError(f"{where}: no method '{value}'. {nearest(value, METHODS)}")
    return value


def _paths(table: Mapping) -> dict[str, object]:
    """Dotted paths, whether their dots were in quotes or not."""
    found: dict[str, object] = {}
    for key, value in table.items():
        inner = _paths(value) if isinstance(value, dict) else {"": value}
        found |= {f"{key}.{rest}" if rest else key: one for rest, one in inner.items()}
    return found


def _table(value: object, where: str, example: str) -> dict:
    if not isinstance(value, dict):
        raise DeclarationError(f"{where} is no table (got {value!r}). Write {example}.")
    return value


def _known(table: Mapping, known: Sequence[str], where: str) -> None:
    for key in table:
        if key not in known:
            raise DeclarationError(f"{where} has an unknown key '{key}'. {nearest(key, known)}")
