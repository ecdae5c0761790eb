"""The floors of ARCHITECTURE.md: a room imports only rooms below it."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

LINT = """
import sys
sys.meta_path[:] = [f for f in sys.meta_path if "editable" not in type(f).__module__.lower()]
sys.path.insert(0, sys.argv[1])
from importlinter.cli import lint_imports
sys.exit(lint_imports(config_filename=sys.argv[2], no_cache=True))
"""


def test_every_room_imports_only_rooms_below_it(tmp_path):
    rooms = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["scikit-build"]["wheel"]["packages"]
    for name, folder in rooms.items():
        if name != "hydrotwin/examples":
            ignore = shutil.ignore_patterns("__pycache__", "runtime", "templates")
            shutil.copytree(ROOT / folder, tmp_path / name, ignore=ignore, dirs_exist_ok=True)
    command = [sys.executable, "-c", LINT, str(tmp_path), str(ROOT / "pyproject.toml")]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert "3 kept" in answer.stdout, answer.stdout


def test_the_base_package_imports_without_torch():
    code = (
        "import sys\n"
        "class Blocked:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.split('.')[0] in ('torch', 'gpytorch', 'pyoperon'): raise ImportError(name)\n"
        "sys.meta_path.insert(0, Blocked())\n"
        "import hydrotwin, hydrotwin.learned, hydrotwin.comparison, hydrotwin.report, hydrotwin.cli\n"
        "hydrotwin.load('eq17')"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert answer.returncode == 0, answer.stderr


def test_the_picture_in_architecture_md_shows_the_floors_that_are_checked():
    lint = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    floors = [
        {r.strip().removeprefix("hydrotwin.") for r in layer.split("|")} for layer in lint["contracts"][0]["layers"]
    ]
    picture = (ROOT / "ARCHITECTURE.md").read_text().split("```text")[1].split("```")[0]
    order = [room for floor in floors for room in sorted(floor) if room != "__main__"]
    drawn = {room: picture.find(f" {room} ") for room in order}
    assert all(place >= 0 for place in drawn.values()), drawn
    heights = [picture[: drawn[room]].count("\n") for floor in floors for room in sorted(floor) if room in drawn]
    assert heights == sorted(heights)
