"""Starts that first order expects: a parameter of the model stays near its value, other effects may be large."""

import hydrotwin as ht
from hydrotwin.discovery.structures.starts import usually
from hydrotwin.models.effects import candidates


def one(name):
    return next(c for c in candidates(ht.load("cehA")) if c.label.startswith(name))


def test_no_mass_is_expected_to_be_negative_or_many_times_its_size():
    payload = one("payload_error at arm.extra_mass")
    ((name, (low, high)),) = payload.typical.items()
    assert low > 0 and usually(payload, {name: -293.0}) == {name: low}
    assert usually(payload, {name: 5000.0}) == {name: high}
    assert usually(payload, {name: 0.5 * (low + high)}) == {name: 0.5 * (low + high)}


def test_a_friction_of_a_large_machine_is_expected_as_large_as_it_is():
    friction = one("coulomb_friction")
    start = {name: 5e4 for name in friction.free}
    assert usually(friction, start) == start
