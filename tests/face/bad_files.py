"""A folder of files that are wrong in one way each, beside good ones that must stay whole."""

from __future__ import annotations

import zipfile
from pathlib import Path

import hydrotwin as ht
from hydrotwin.learned import write_block
from tests.face.command_line import SHIPPED, short

TRAIN = SHIPPED / "cehA/recordings/train_1.csv"
GAIN = 'model = "cehA"\n[parameters.motor]\ngain = {{ {} }}\n'
CODE = """def f():
    return 3


def boom():
    raise ValueError("no rig today")


def needs(rig):
    return rig
"""

RECORDINGS = {
    "bar.csv": lambda t: t.replace("command [V]", "command [bar]"),
    "percent.csv": lambda t: t.replace("command [V]", "command [%]"),
    "no_command.csv": lambda t: t.replace("command [V]", "comand [V]"),
    "no_unit.csv": lambda t: t.replace("command [V]", "command"),
    "odd_unit.csv": lambda t: t.replace("command [V]", "command [vlots]"),
    "no_time.csv": lambda t: t.replace("time [s]", "clock [1]"),
    "time_in_volts.csv": lambda t: t.replace("time [s]", "time [V]"),
    "twice.csv": lambda t: t.replace("arm_angle [deg]", "command [deg]"),
    "no_header.csv": lambda t: t.partition("\n")[2],
    "text.csv": lambda t: t.replace("\n0.02,0.0,", "\n0.02,abc,", 1),
    "nan.csv": lambda t: t.replace("\n0.02,0.0,", "\n0.02,nan,", 1),
    "infinite.csv": lambda t: t.replace("\n0.02,0.0,", "\n0.02,inf,", 1),
    "gap.csv": lambda t: t.replace("\n0.02,0.0,", "\n0.02,,", 1),
    "backward.csv": lambda t: t.replace("\n0.02,", "\n0.005,", 1),
    "same_time.csv": lambda t: t.replace("\n0.02,", "\n0.01,", 1),
    "ragged.csv": lambda t: t.replace("\n0.02,0.0,", "\n0.02,", 1),
    "cut_off.csv": lambda t: t[:-20],
    "empty.csv": lambda t: "",
    "header_only.csv": lambda t: t.partition("\n")[0] + "\n",
    "one_row.csv": lambda t: "\n".join(t.splitlines()[:2]) + "\n",
    "no_output.csv": lambda t: _columns(t, 0, 1),
    "speed.csv": lambda t: _columns(t, 0, 1, 3),
    "still.csv": lambda t: _columns(t, 0, 1, 3, change=lambda row: [*row[:2], "0.5"]),
    "no_move.csv": lambda t: _columns(t, 0, 1, 3, change=lambda row: [row[0], "0.5", row[2]]),
}

MODEL_FILES = {
    "starts_code.toml": 'model = "rig.py:f"\n',
    "fmu_gone.toml": 'model = "absent.fmu"\n',
    "unknown_model.toml": 'model = "cehB"\n',
    "unknown_key.toml": 'model = "cehA"\n\n[run]\ncode = "import os"\n',
    "yaml.toml": '!!python/object/apply:os.system ["touch pwned"]\n',
    "cut.toml": 'model = "cehA"\n\n[parameters]\nmotor.gain = {value = 120.0, unit = "rad/',
    "unknown_parameter.toml": GAIN.format('value = 120, unit = "rad/(s.V)"').replace("gain", "gian"),
    "out_of_bounds.toml": GAIN.format('value = 10, unit = "rad/(s.V)", bounds = [20, 600]'),
    "other_dimension.toml": GAIN.format('value = 120, unit = "m"'),
    "no_unit.toml": GAIN.format("value = 120"),
    "text_value.toml": GAIN.format('value = "120", unit = "rad/(s.V)"'),
    "nan_value.toml": GAIN.format('value = nan, unit = "rad/(s.V)"'),
    "no_table.toml": 'model = "cehA"\nparameters = 3\n',
    "newer.toml": 'format = 99\nmodel = "cehA"\n',
    "effects.toml": 'model = "cehA"\n[[effects]]\neffect = "internal_leakage"\n',
    "nothing.toml": "",
    "odd_block.toml": 'kind = "perceptron"\n',
}

SCENARIOS = {
    "unknown_mode.toml": 'models = ["cehA"]\nvalidate = ["good.csv"]\nmodes = ["fre run"]\n',
    "odd_key.toml": 'models = ["cehA"]\nvalidat = ["good.csv"]\n',
    "no_recording.toml": 'models = ["cehA"]\nvalidate = ["goood.csv"]\n',
    "no_models.toml": 'validate = ["good.csv"]\n',
    "not_a_list.toml": 'models = "cehA"\nvalidate = ["good.csv"]\n',
    "twins.toml": 'models = ["cehA", "cehA"]\nvalidate = ["good.csv"]\n',
    "broken.toml": 'models = ["cehA"\n',
    "scenario.toml": 'models = ["cehA"]\nvalidate = ["good.csv"]\n',
}

PYTHON = {
    "rig.py": CODE,
    "syntax.py": "import math\ndef f(:\n    pass\n",
    "imports.py": "import no_such_package_of_anybody\n",
    "leaves.py": "import sys\n\nsys.exit(0)\n",
}


def make(folder: Path) -> Path:
    """Fill a folder: good.csv, the results of earlier work that must stay whole, and everything that is wrong."""
    short(TRAIN, folder / "good.csv", 3.0)
    for name, edit in RECORDINGS.items():
        short(TRAIN, folder / name, 3.0, edit)
    for name, text in {**MODEL_FILES, **SCENARIOS, **PYTHON}.items():
        (folder / name).write_text(text, encoding="utf-8")
    _earlier_results(folder)
    _damaged(folder)
    return folder


def _columns(text: str, *kept: int, change=lambda row: row) -> str:
    header, *rows = ([line.split(",")[k] for k in kept] for line in text.strip().splitlines())
    return "\n".join([",".join(header), *(",".join(change(row)) for row in rows)]) + "\n"


def _earlier_results(folder: Path) -> None:
    """What a user would hate to lose: an output, a model file, a learned block, an FMU and a report."""
    model = ht.load("cehA")
    ht.write_model_file(folder / "old.toml", "cehA", model.flat)
    (folder / "out.csv").write_text("time [s],arm_angle [rad]\n0,1\n1,2\n")
    (folder / "old.mo").write_text("package old\nend old;\n")
    write_block(ht.published_formula(), folder / "block.toml")
    ht.export_fmu(ht.published_formula(), folder / "old.fmu")
    (folder / "report").mkdir()
    for name in ("report.html", "report.md", "compare.json", "linearisation.html", "friction.html"):
        (folder / "report" / name).write_text("earlier work\n")


def _damaged(folder: Path) -> None:
    """Files that were cut, mixed up, or never were what their name says."""
    lines = (folder / "old.toml").read_text().splitlines(keepends=True)
    (folder / "cut_at_line.toml").write_text("".join(lines[:12]))
    header, arrays = (folder / "block.toml").read_text(), (folder / "block.npz").read_bytes()
    (folder / "cut_header.toml").write_text(header[: header.index('= "', len(header) // 2) + 4])  # inside a text
    (folder / "cut_header_at_line.toml").write_text(header[: header.index("[[outputs]]")])
    for name, packed in (("cut_arrays", arrays[: len(arrays) // 2]), ("other_arrays", arrays[:-1] + b"\1")):
        (folder / f"{name}.toml").write_text(header.replace("block.npz", f"{name}.npz"))
        (folder / f"{name}.npz").write_bytes(packed)
    (folder / "lost_arrays.toml").write_text(header.replace("block.npz", "lost.npz"))
    fmu = (folder / "old.fmu").read_bytes()
    (folder / "cut.fmu").write_bytes(fmu[: len(fmu) // 2])
    (folder / "text.fmu").write_text("not a zip file")
    with zipfile.ZipFile(folder / "other.fmu", "w") as archive:
        archive.writestr("readme.txt", "a zip file, but no FMU")
    (folder / "noise.csv").write_bytes(bytes(range(256)) * 8)
    (folder / "noise.parquet").write_bytes(b"PAR1 and then nothing of use")
    (folder / "noise.mat").write_bytes(b"junk" * 100)
    (folder / "noise.toml").write_bytes(bytes(range(128, 256)))
