"""A cache of compiled libraries for one test."""

from __future__ import annotations

import shutil

import pytest

from hydrotwin.simulation.compiler import compile_library
from hydrotwin.simulation.engines import DRIVER
from hydrotwin.simulation.source import driver_source


@pytest.fixture
def new_cache(tmp_path, monkeypatch):
    """A cache folder that holds nothing but the driver, as after the first model."""
    monkeypatch.delenv("CC", raising=False)
    folder = tmp_path / "cache"
    folder.mkdir()
    shutil.copy(compile_library(driver_source(), "driver", DRIVER, for_this_processor=True), folder)
    monkeypatch.setenv("HYDROTWIN_CACHE", str(folder))
    return folder
