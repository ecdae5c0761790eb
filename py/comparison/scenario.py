"""A scenario file: which models meet on which recordings. TOML, data only."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from hydrotwin.identification.beginning import MEASURED, check_initial_states
from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.writing import printable
from hydrotwin.records import Reading, import_from, reading_of

from .acceptance import Wanted
from .comparison import MODES
from .loop import Loop, read_loop
from .scenario_files import Files, nearest_file
from .tags import Tags
from .variants import Variant, read_variants

OPTIONS = ("modes", "outputs", "rates", "scale", "missing", "import", "interpolation", "initial_states", "loop")
JUDGING = ("tags", "tag_columns", "accept", "judge", "against")
VARYING = ("variants", "matrix")
KEYS = ("title", "models", "validate", "train", "made_by", *OPTIONS, *JUDGING, *VARYING)
_FILES = (".toml", ".fmu", ".npz")


@dataclass(frozen=True)
class ModelEntry:
    """One model of a scenario: ``model`` as on the command line (name, file or ``file.py:factory``), and its label.

    ``settings`` : parameter -> value in SI; of an FMU start values and inputs too, and texts with a unit ("35 bar").
    """

    model: str
    name: str | None = None
    settings: Mapping[str, float | str] = field(default_factory=dict)

    @property
    def label(self) -> str | None:
        """What it is called in criteria, tables and files: its name, or as it is written, a file without its folder.

        None for what a Python file makes, which has a name of its own.
        """
        if self.name or ".py:" in self.model:
            return self.name
        base, at, values = self.model.partition("@")
        return printable(f"{Path(base).name}{at}{Path(values).name}")


@dataclass(frozen=True)
class Scenario:
    """Shared inputs, starts and metrics on which models are compared.

    ``validate`` and ``train`` are paths of recordings, ``reading`` says how they are read, ``interpolation`` "hold" or
    "linear" by input, ``initial_states`` where models start (see `compare`), ``base`` the folder that relative paths
    start from. With ``loop`` every model runs under the same controller and follows the recorded reference. ``tags``
    says of which condition each recording is, ``wanted`` what is asked of the result. ``variants``, the scenario as it
    stands first, are run by `run_matrix`.
    """

    title: str
    models: tuple[ModelEntry, ...]
    validate: tuple[Path, ...]
    train: tuple[Path, ...] = ()
    modes: tuple[str, ...] = MODES
    outputs: tuple[str, ...] | None = None
    rates: tuple[str, ...] = ()
    reading: Reading = field(default_factory=Reading)
    interpolation: Mapping[str, str] = field(default_factory=dict)
    initial_states: str = MEASURED
    base: Path = Path(".")
    loop: Loop | None = None
    tags: Tags = field(default_factory=Tags)
    wanted: Wanted = field(default_factory=Wanted)
    variants: tuple[Variant, ...] = ()


def read_scenario(path: str | Path) -> Scenario:
    """Read a scenario from TOML; paths in it are relative to the file, and may hold ``*`` and ``$VARIABLE``.

    ::

        title = "C-EHA: physics against formula"
        models = ["cehA", "fitted.toml", {model = "vendor.fmu", name = "vendor"}]
        validate = ["validation_*.csv", {file = "winter.csv", tags = {oil = "cold"}}]
        train = ["training_1.csv"]                # optional, as all that follow
        modes = ["free run", "one step"]
        outputs = ["arm_angle"]
        rates = ["arm_angle"]                     # score its slope as well
        scale = {command = "0.05 V/%"}
        missing = "keep"                          # empty cells: error, drop rows or keep
        import.rate = 1000                        # and all that an import.toml may say, see `read_record`
        interpolation = {force = "linear"}        # between samples, in place of what the recordings show
        initial_states = "auto"                   # start states from the first part: measured (default), auto or free
        tags = "load{load}_stroke{stroke}"        # conditions in the names of the recordings; a star is anything
        tag_columns = {machine = "rig", oil = "oil_temperature by 10 degC"}  # conditions in columns, see `Tags`
        accept = ["arm_angle.rmse < 0.2 deg", "load=2: arm_angle.fit > 90 %"]   # see `criteria`
        judge = "fitted.toml"                     # the model that is judged; by default the first
        against = "last/compare.json"             # an earlier comparison

        [loop]                                    # closed loop: see `Loop`
        reference = "reference"
        measured = "arm_angle"
        command = "command"
        period = 0.01
        numerator = [20.0]
        denominator = [1.0]
        limits = [-5, 5]

        [variants.cold]                           # the whole scenario once more with changes, see `Variant`
        parameters = {"cylinder.oil.bulk_modulus" = "900 MPa"}

        [made_by]                                 # what makes files that are not there, told where one is missing
        "fitted.toml" = "hydrotwin identify cehA training_1.csv --out fitted.toml"

        [matrix]                                  # and once more for every combination of these
        parameters."motor.gain" = [120, 130]
        initial_states = ["measured", "auto"]

    A model is written as on the command line: ``vendor.fmu:mass.s,mass.v`` has these variables as its outputs.
    ``{model = "vendor.fmu", set = {mass = 3.0, supply = "35 bar"}}`` sets parameters, of an FMU start values and
    inputs that nobody recorded too.
    The model ``hold_last`` is the yardstick that repeats the last sample.

    Raises DataError for a file that is missing or no TOML, DeclarationError for keys and modes that do not exist.
    """
    path = Path(path)
    table = _read_toml(path)
    where = path.name
    _only(table, KEYS, where)
    for key in ("models", "validate"):
        if not table.get(key):
            raise DeclarationError(f"{where}: no '{key}'. A scenario lists at least one. Add {key} = [...].")
    modes = _strings(table, "modes", where) or MODES
    for mode in modes:
        if mode not in MODES:
            raise DeclarationError(f"{where}: no mode '{mode}'. {nearest(mode, MODES)}")
    files = Files(path, _texts(table, "made_by", where, "'model.toml' = 'hydrotwin identify ... --out model.toml'"))
    validate, tags = _tagged(table, files)
    return Scenario(
        title=str(table.get("title", printable(path.stem))),
        models=tuple(_entry(e, files) for e in _list(table, "models", where)),
        validate=files.recordings(validate),
        train=files.recordings(_strings(table, "train", where)),
        modes=tuple(modes),
        outputs=_strings(table, "outputs", where) or None,
        rates=_strings(table, "rates", where),
        reading=_reading(table, path),
        interpolation=_texts(table, "interpolation", where, "force = 'linear'"),
        initial_states=check_initial_states(_text(table, "initial_states", where) or MEASURED, where),
        base=path.parent,
        loop=read_loop(table["loop"], where) if "loop" in table else None,
        tags=tags,
        wanted=_wanted(table, path),
        variants=read_variants(table.get("variants"), table.get("matrix"), where),
    )


def _reading(table: Mapping, path: Path) -> Reading:
    """How the recordings are read: ``scale``, ``missing`` and the table ``import``."""
    scale = _texts(table, "scale", path.name, "command = '0.05 V/%'")
    said = reading_of(scale=scale or None, missing=table.get("missing"))
    return said.over(import_from(table.get("import", {}), f"{path.name}: import"))


def _read_toml(path: Path) -> dict:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DataError(f"{path}: no such scenario. {nearest_file(path)}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: not a TOML file ({error}). A scenario is plain TOML. Mend that line.") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}). Check the path and its permissions.") from None


def _only(table: Mapping, known: Sequence[str], where: str) -> None:
    for key in table:
        if key not in known:
            raise DeclarationError(f"{where}: unknown key '{key}'. {nearest(key, known)}")


def _list(table: Mapping, key: str, where: str) -> list:
    value = table.get(key, [])
    if not isinstance(value, list):
        raise DeclarationError(f"{where}: '{key}' is not a list (got {value!r}). Write {key} = [...].")
    return value


def _strings(table: Mapping, key: str, where: str) -> tuple[str, ...]:
    values = _list(table, key, where)
    for value in values:
        if not isinstance(value, str):
            raise DeclarationError(f"{where}: '{key}' holds no text (got {value!r}). Put it in quotes.")
    return tuple(values)


def _tagged(table: Mapping, files: Files) -> tuple[list[str], Tags]:
    """The files of ``validate``, and what is said of their conditions."""
    path, named, by_file = files.scenario, [], {}
    for item in _list(table, "validate", path.name):
        if isinstance(item, dict):
            _only(item, ("file", "tags"), f"{path.name}: validate")
            said = item.get("tags", {})
            if not isinstance(item.get("file"), str) or not isinstance(said, dict):
                raise DeclarationError(
                    f"{path.name}: a recording with tags is {{file = 'a.csv', tags = {{load = 2}}}} (got {item!r})."
                )
            by_file |= {file: said for file in files.recordings([item["file"]])}
            item = item["file"]
        if not isinstance(item, str):
            raise DeclarationError(f"{path.name}: 'validate' holds no text (got {item!r}). Put it in quotes.")
        named.append(item)
    columns = _texts(table, "tag_columns", path.name, "load = 'load_mass'")
    if isinstance(table.get("tags"), dict):
        raise DeclarationError(
            f"{path.name}: 'tags' is a pattern of file names, such as 'load{{load}}_*'. Tags of one recording stand "
            "beside it: validate = [{file = 'a.csv', tags = {load = 2}}]."
        )
    return named, Tags(_text(table, "tags", path.name), by_file, columns)


def _wanted(table: Mapping, path: Path) -> Wanted:
    against = _text(table, "against", path.name)
    return Wanted(
        _strings(table, "accept", path.name),
        _text(table, "judge", path.name),
        path.parent / against if against else None,
        path.parent,
    )


def _text(table: Mapping, key: str, where: str) -> str:
    value = table.get(key, "")
    if not isinstance(value, str):
        raise DeclarationError(f"{where}: '{key}' is no text (got {value!r}). Put it in quotes.")
    return value


def _texts(table: Mapping, key: str, where: str, example: str) -> dict[str, str]:
    texts = table.get(key, {})
    if not isinstance(texts, dict) or not all(isinstance(v, str) for v in texts.values()):
        raise DeclarationError(f"{where}: '{key}' is no table of texts (got {texts!r}). Write {example}.")
    return texts


def _entry(value, files: Files) -> ModelEntry:
    """One item of ``models``: a text, or a table with model and name."""
    path = files.scenario
    if isinstance(value, str):
        return ModelEntry(_located(value, files))
    if not isinstance(value, dict):
        raise DeclarationError(f'{path.name}: a model is a text or a table (got {value!r}). Write "cehA".')
    _only(value, ("model", "name", "set"), f"{path.name}: models")
    if not isinstance(value.get("set", {}), dict):
        raise DeclarationError(f"{path.name}: 'set' is no table (got {value['set']!r}). Write set = {{mass = 3.0}}.")
    if not isinstance(value.get("model"), str):
        raise DeclarationError(
            f"{path.name}: a model has no 'model'. It is a name or a file. Write {{model = 'cehA'}}."
        )
    name = value.get("name")
    return ModelEntry(_located(value["model"], files), None if name is None else str(name), value.get("set", {}))


def _located(model: str, files: Files) -> str:
    """The model with its path made relative to the scenario file, when it is a path."""
    file, colon, factory = model.partition(".py:")
    if colon:
        factory, at, values = factory.partition("@")
        return f"{files.folder / file}.py:{factory}" + (f"@{files.model(values)}" if at and values else at)
    name, fmu, outputs = model.partition(".fmu:")
    name += ".fmu" if fmu else ""
    if not name.endswith(_FILES):
        return model
    file = files.model(name)
    return f"{file}:{outputs}" if fmu else str(file)
