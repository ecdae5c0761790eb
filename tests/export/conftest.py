from __future__ import annotations

import dataclasses

import casadi as ca
import pytest

from fmus.shipped import all_shipped
from hydrotwin.export import export_fmu
from hydrotwin.records import read_record
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


SHIPPED = [shipped.folder.name for shipped in all_shipped()]


@pytest.fixture(scope="session")
def shipped_libraries(tmp_path_factory):
    """(name, version of FMI) -> the loaded library of a shipped FMU, Co-Simulation alone."""

    class Loaded(dict):
        def __missing__(self, key):
            name, fmi = key
            [shipped] = all_shipped(names=[name])
            folder = tmp_path_factory.mktemp("shipped")
            one = dataclasses.replace(shipped, kind="cs")
            self[key] = Library(one.build(fmi, read_record(shipped.reference), folder / "x.fmu"), folder / "unpacked")
            return self[key]

    return Loaded()


OF_FMI3 = ["cehA 3", "delayed mass 3", "stiff 3", "implicit 3", "lag 3", "lag in MX 3"]
IMPLICIT = ("stiff", ("method", "implicit"))


OF_FMI2 = ["cehA", "delayed mass", "stiff", "implicit", "lag", "lag in MX"]


def _label(param) -> str:
    return param if isinstance(param, str) else f"shipped {param[0]} {param[1]}"


@pytest.fixture(params=[*OF_FMI2, *OF_FMI3, *((name, fmi) for name in SHIPPED for fmi in (2, 3))], ids=_label)
def library(request, libraries, exchangers, shipped_libraries):
    """Each kind of Co-Simulation FMU in turn and all that are shipped, of both versions."""
    if isinstance(request.param, tuple):
        return shipped_libraries[request.param]
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
