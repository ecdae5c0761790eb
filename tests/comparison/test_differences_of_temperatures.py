"""A recorded difference of temperatures is what a model declares it to be: 5 degC of a rise is 5 K, not 278 K."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.comparison import compare
from hydrotwin.comparison.comparison import FREE_RUN
from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.identification import identify
from hydrotwin.learned import learn
from hydrotwin.models.language import Component, Input, Model, Output, Parameter
from hydrotwin.models.language.errors import UnitError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record, as_needed, read_record
from hydrotwin.simulation import simulate

RISE, ROOM = Signal("rise", "K", written_in="delta_degC"), Signal("room", "K", written_in="degC")


class Cooler(Component):
    """What flows over a wall, from the difference over it."""

    drop = Input("delta_degC", "difference over the wall", nominal=10.0)
    room = Input("degC", "room", nominal=300.0)
    heat = Output("W", "heat", nominal=30.0)
    rise = Output("delta_degC", "of the far side over the room", nominal=10.0)
    conductance = Parameter(3.0, "W/delta_degC", bounds=(0.0, 100.0), nominal=1.0)

    def equations(self):
        yield self.heat == self.conductance * self.drop
        yield self.rise == 0.5 * self.drop


def cooler(**change):
    return Model(Cooler(), "cooler", settings={"conductance": {"free": True, **change}}, step=0.1)


@pytest.fixture(params=["degC", "°C", "degF", "K", "delta_degC"])
def wall(request, tmp_path):
    """A recording of drop, heat and rise, differences in one unit or another."""
    unit, rng = request.param, np.random.default_rng(0)
    drop = rng.uniform(5, 20, 60).repeat(4)
    factor = 1.8 if "F" in unit else 1.0
    rows = [f"{0.1 * k:.1f},{d * factor!r},20,{3 * d!r},{0.5 * d * factor!r}" for k, d in enumerate(drop.tolist())]
    path = tmp_path / "wall.csv"
    head = f"time [s],drop [{unit}],room [degC],heat [W],rise [{unit}]"
    path.write_text("\n".join([head, *rows]), encoding="utf-8")
    return read_record(path)


def errors(found) -> dict[str, float]:
    return {f"{s.model}.{s.output}": s.rmse for s in found.scores}


def test_every_way_to_write_a_difference_is_the_same_to_runs_fits_and_scores(wall, tmp_path):
    simulated = simulate(cooler(), wall)
    np.testing.assert_allclose(simulated["heat"], wall["heat"], rtol=1e-9)
    assert identify(cooler(value=4.0), [wall]).values["conductance"] == pytest.approx(3.0, rel=1e-3)
    fmu = dataclasses.replace(read_fmu(export_fmu(cooler(), tmp_path / "cooler.fmu")), name="fmu")
    found = errors(compare([cooler(), fmu], [wall], modes=[FREE_RUN], repeats=0))
    assert set(found) == {"cooler.heat", "cooler.rise", "fmu.heat", "fmu.rise"}
    assert max(found.values()) < 1e-6


def test_a_difference_is_converted_once():
    record = Record([0.0, 1.0], {"rise": [278.15, 283.15]}, {"rise": "K"}, display_units={"rise": "degC"})
    once = as_needed(record, [RISE])
    np.testing.assert_allclose(once["rise"], [5.0, 10.0])
    assert once.display_units["rise"] == "delta_degC"
    assert as_needed(once, [RISE]) is once


@pytest.mark.parametrize("shown", ["degC", "delta_degC"])
def test_a_column_is_no_difference_to_one_and_a_temperature_to_another(shown):
    """Whoever reads it as the other is wrong by 273 K."""
    record = Record([0.0, 1.0], {"rise": [278.15, 283.15]}, {"rise": "K"}, display_units={"rise": shown})
    temperature = dataclasses.replace(ROOM, name="rise")
    for signals in ([RISE, temperature], [temperature, RISE]):
        with pytest.raises(UnitError, match=r"a difference of temperatures to one .* wrong by 273.15 K"):
            as_needed(record, signals)


def test_a_temperature_stays_one():
    record = Record([0.0, 1.0], {"room": [293.15, 294.15]}, {"room": "K"}, display_units={"room": "degC"})
    assert as_needed(record, [ROOM, RISE]) is record


def test_a_learned_block_is_judged_by_the_difference_that_it_learned():
    """Its card had held runs in K against a column from 273 K on."""

    def walk(seed):
        rng = np.random.default_rng(seed)
        drop = rng.uniform(5, 20, 60).repeat(10)
        rise = 0.5 * drop + rng.normal(0, 0.01, len(drop))
        signals = {"drop": drop + 273.15, "rise": rise + 273.15}
        units = {"drop": "K", "rise": "K"}
        return Record(0.1 * np.arange(600), signals, units, f"walk_{seed}", display_units=dict.fromkeys(units, "degC"))

    drop = dataclasses.replace(RISE, name="drop")
    block = learn("arx", [walk(0), walk(1)], [drop], [RISE], validate=[walk(2)])
    (card,) = block.provenance["free_run"]["outputs"].values()
    assert card["rmse"] < 0.1 and block.provenance["validation"]["rise"] < 0.1
