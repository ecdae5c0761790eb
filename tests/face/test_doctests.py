"""The examples in docstrings run, in the package as it is installed."""

from __future__ import annotations

import doctest
import importlib
import pkgutil

import pytest

import hydrotwin

SKIPPED = ("hydrotwin.__main__", "hydrotwin.examples", "hydrotwin.learned.network.free_run")


def modules(package=hydrotwin, prefix="hydrotwin."):
    methods = ("records", "simulation", "identification", "learned", "comparison", "discovery", "report", "export")
    rooms = (*methods, "models")
    for name in ("", *rooms):
        module = importlib.import_module(f"hydrotwin.{name}".rstrip("."))
        yield module.__name__
        for found in pkgutil.walk_packages(module.__path__, f"{module.__name__}."):
            if not found.name.startswith(SKIPPED) and not found.name.endswith("__main__"):
                yield found.name


@pytest.mark.parametrize("name", sorted(set(modules())))
def test_the_examples_of_a_module_say_what_it_does(name):
    results = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert results.failed == 0
