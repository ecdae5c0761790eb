"""Additions that name a place that is not there, or fit none, are refused with what is there."""

from __future__ import annotations

import pytest

from hydrotwin.models.language import Component, DeclarationError, Flange, Model, Parameter, TopologyError, UnitError
from hydrotwin.models.language.additions import Addition
from tests.language.parts import Gain, Hydraulics, Leak, Oscillator, Throttle


@pytest.mark.parametrize(
    ("addition", "named"),
    [
        (Addition("leak", Leak(), ties={"port": "vessel.prot"}), "vessel.port"),
        (Addition("leak", Leak(), ties={"prot": "vessel.port"}), "port"),
        (Addition("gain", Gain(), reads={"u": "vessel.presure"}), "vessel.pressure"),
        (Addition("gain", Gain(), through="der(vessel.presure)"), "der\\(vessel.pressure\\)"),
        (Addition("line", Throttle(), between="source.prot"), "source.port"),
        (Addition("", frees="feed.conductanse"), "conductance"),
    ],
)
def test_a_place_that_is_not_there_is_refused_with_the_nearest_that_is(addition, named):
    with pytest.raises(DeclarationError, match=named):
        _ = Model(Hydraulics()).plus([addition]).flat


def test_a_variable_that_is_no_signal_cannot_be_taken_over():
    with pytest.raises(DeclarationError, match="nothing can be put into"):
        _ = Model(Hydraulics()).plus([Addition("gain", Gain(), through="feed.a.q")]).flat


def test_a_name_that_is_taken_is_refused():
    for name in ("feed", "leak"):
        parts = [Addition(n, Leak(), ties={"port": "vessel.port"}) for n in ("leak", name)]
        with pytest.raises(DeclarationError, match=f"'{name}' is there already"):
            _ = Model(Hydraulics()).plus(parts).flat


def test_a_part_that_is_tied_to_nothing_is_refused():
    with pytest.raises(TopologyError, match=r"leak\.port"):
        _ = Model(Hydraulics()).plus([Addition("leak", Leak())]).flat


def test_a_port_of_another_kind_is_refused():
    with pytest.raises(TopologyError, match="different kinds"):
        _ = Model(Hydraulics()).plus([Addition("odd", _Push(), ties={"flange": "vessel.port"})]).flat


class _Push(Component):
    flange = Flange()
    force = Parameter(1.0, "N")

    def equations(self):
        yield self.flange.f == self.force


def test_units_of_an_added_part_must_fit_the_signal():
    with pytest.raises(UnitError, match="units do not balance"):
        _ = Model(Oscillator()).plus([Addition("gain", Gain(), through="force")]).flat
