"""A program that writes decimal commas gets the same numbers."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RUN = """
import locale, sys
from pathlib import Path
from tests.export.raw import Library
locale.setlocale(locale.LC_ALL, sys.argv[1])
library = Library(Path(sys.argv[2]), Path(sys.argv[3]))
instance = library.instance().initialise()
found = []
for k in range(20):
    instance.set("command", 0.1 * k)
    instance.step(0.01 * k, 0.01)
    found += [value.hex() for value in instance.get(*library.names("output"))]
print(locale.localeconv()["decimal_point"], *found)
"""


@pytest.fixture(scope="module")
def german(tmp_path_factory):
    """A folder with a German locale, made from the sources of the system's C library."""
    if not shutil.which("localedef"):
        pytest.skip("no localedef")
    folder = tmp_path_factory.mktemp("locales")
    made = subprocess.run(
        ["localedef", "-i", "de_DE", "-f", "UTF-8", str(folder / "de_DE.UTF-8")], capture_output=True, check=False
    )
    if made.returncode > 1:  # 1: made with warnings
        pytest.skip("no sources of the German locale")
    return folder


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_decimal_comma_changes_nothing(variants, german, tmp_path, fmi):
    def run(name):
        line = [sys.executable, "-c", RUN, name, str(variants["cehA", ("fmi", fmi)]), str(tmp_path / name)]
        environment = os.environ | {"LOCPATH": str(german), "PYTHONPATH": str(ROOT)}
        done = subprocess.run(line, capture_output=True, text=True, cwd=ROOT, env=environment, check=True)
        return done.stdout.split()

    plain, with_comma = run("C"), run("de_DE.UTF-8")
    assert (plain[0], with_comma[0]) == (".", ",")
    assert len(plain) == 1 + 20 * 6
    assert with_comma[1:] == plain[1:]
