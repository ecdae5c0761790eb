"""FMUs built here for other machines run there: aarch64 under qemu, Windows under wine, as they run here."""

from __future__ import annotations

import numpy as np
import pytest

from fmus.machines import machine_for, replayed
from hydrotwin.export import export_fmu

HERE, THERE = "linux64", ("aarch64-linux", "win64")


@pytest.fixture(scope="module")
def built(tmp_path_factory, systems):
    """(fmi, kind) -> an FMU for all these machines."""
    folder = tmp_path_factory.mktemp("machines")

    class Made(dict):
        def __missing__(self, key):
            fmi, kind = key
            path = folder / f"{fmi}{kind}.fmu"
            self[key] = export_fmu(systems["cehA"], path, fmi=fmi, kind=kind, platforms=[HERE, *THERE])
            return self[key]

    return Made()


@pytest.mark.parametrize(("fmi", "kind"), [(2, "cs"), (3, "both")])
@pytest.mark.parametrize("platform", THERE)
def test_an_fmu_runs_on_another_machine_as_here(built, platform, fmi, kind):
    for machine in (HERE, platform):
        if machine_for(machine).missing:
            pytest.skip(machine_for(machine).missing)
    for interface in ("cs", "me") if kind == "both" else (kind,):
        here, there = (replayed(built[fmi, kind], machine, interface) for machine in (HERE, platform))
        assert np.ptp(here, axis=0).min() > 0
        assert np.abs(there - here).max(axis=0) == pytest.approx(0, abs=1e-9 * np.abs(here).max())


def test_what_fails_there_is_told(systems, tmp_path):
    if machine_for(HERE).missing:
        pytest.skip(machine_for(HERE).missing)
    fmu = export_fmu(systems["cehA"], tmp_path / "here.fmu", kind="cs", platforms=[HERE])  # zig takes minutes for all
    with pytest.raises(RuntimeError, match="linux64: the replay ended with 1"):
        replayed(fmu, HERE, "me")
