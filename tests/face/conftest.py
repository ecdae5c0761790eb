"""A folder of short recordings, made once for each test file."""

from __future__ import annotations

import pytest

from tests.face.command_line import SHIPPED, short


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """The first seconds of the shipped recordings of the C-EHA, under their own names."""
    folder = tmp_path_factory.mktemp("recordings")
    for source in sorted((SHIPPED / "cehA/recordings").glob("*.csv")):
        short(source, folder / source.name, 60.0 if "friction" in source.name else 6.0)
    return folder
