from __future__ import annotations

import dataclasses

import casadi as ca
import pytest

from hydrotwin.export import export_fmu
from hydrotwin.simulation import TrainingDomain
from tests.export.raw import Library
from tests.export.systems import clocked_mass, delayed_mass, lag_block, network_block, stiff_oscillator
from tests.simulation.flat_cehA import flat_cehA

BOX = TrainingDomain(("command", "rate"), (-1.0, -0.9), (1.0, 0.9))


@pytest.fixture(scope="session")
def systems():
    """Name -> what is exported under it."""
    return {
        "cehA": flat_cehA(),
        "delayed mass": delayed_mass(),
        "stiff": stiff_oscillator(),
        "clocked mass": clocked_mass(),
        "lag": lag_block(),
        "lag in MX": dataclasses.replace(lag_block(ca.MX), name="lag in MX"),
        "network": network_block(),
        "lag with domain": lag_block(domain=BOX),
    }


@pytest.fixture(scope="session")
def fmus(systems, tmp_path_factory):
    """Name -> path of the FMU, all with the defaults of `export_fmu`; made when first asked for."""
    folder = tmp_path_factory.mktemp("fmus")

    class Made(dict):
        def __missing__(self, name):
            self[name] = export_fmu(systems[name], folder / f"{name}.fmu")
            return self[name]

    return Made()


@pytest.fixture(scope="session")
def variants(systems, tmp_path_factory):
    """(name, options of `export_fmu` as pairs) -> path of the FMU; made when first asked for."""
    folder = tmp_path_factory.mktemp("variants")

    class Made(dict):
        def __missing__(self, key):
            name, *options = key
            self[key] = export_fmu(systems[name], folder / f"{len(self)}.fmu", **dict(options))
            return self[key]

    return Made()


@pytest.fixture(scope="session")
def exchangers(variants, tmp_path_factory):
    """(name, options ...) -> the variant's loaded library."""

    class Loaded(dict):
        def __missing__(self, key):
            self[key] = Library(variants[key], tmp_path_factory.mktemp("unpacked"))
            return self[key]

    return Loaded()


@pytest.fixture(scope="session")
def libraries(fmus, tmp_path_factory):
    """Name -> the FMU's loaded library."""

    class Loaded(dict):
        def __missing__(self, name):
            self[name] = Library(fmus[name], tmp_path_factory.mktemp("unpacked"))
            return self[name]

    return Loaded()


OF_FMI3 = ["cehA 3", "delayed mass 3", "stiff 3", "implicit 3", "lag 3", "lag in MX 3"]
IMPLICIT = ("stiff", ("method", "implicit"))


@pytest.fixture(params=["cehA", "delayed mass", "stiff", "implicit", "lag", "lag in MX", *OF_FMI3])
def library(request, libraries, exchangers):
    """Each kind of Co-Simulation FMU in turn, of both versions."""
    if request.param in OF_FMI3:
        return _of_fmi3(exchangers, request.param)
    return exchangers[IMPLICIT] if request.param == "implicit" else libraries[request.param]


def _of_fmi3(exchangers, label):
    name = label.removesuffix(" 3")
    return exchangers[*(IMPLICIT if name == "implicit" else (name,)), ("fmi", 3)]


@pytest.fixture(params=OF_FMI3)
def library3(request, exchangers):
    """Each kind of Co-Simulation FMU of FMI 3 in turn."""
    return _of_fmi3(exchangers, request.param)
