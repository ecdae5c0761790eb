"""What several tests of the search begin with."""

import pytest

from hydrotwin.discovery.structure import Structure
from tests.discovery.slides import question, records, searching


@pytest.fixture(scope="module")
def rubbing():
    """30 N of dry friction: search, base, screen and ranking."""
    effects = ("coulomb_friction", "stribeck_friction", "null_bias", "drift", "viscous_friction")
    search, fitted = searching(question(records(3, dry=30.0)), effects)
    base = Structure((), fitted)
    return search, base, *search.screened(base)
