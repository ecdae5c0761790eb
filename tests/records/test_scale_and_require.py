"""Scales for columns, and the check that a record holds what a model needs."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError, UnitError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record, Scale, parse_scale, read_record, require

COMMAND = Signal("command", "V", nominal=5.0)
ANGLE = Signal("arm_angle", "rad")


@pytest.fixture
def train(tmp_path):
    path = tmp_path / "train_2.csv"
    path.write_text("time [s],command [%],arm_angle [deg],spare [1]\n0,100,180,4\n1,-50,90,8\n")
    return path


def test_a_scale_turns_percent_into_volts(train):
    for scale in ("command=0.05 V/%", ["command=0.05 V/%"], {"command": "0.05 V/%"}, [parse_scale("command=0.05 V/%")]):
        record = read_record(train, scale=scale)
        np.testing.assert_allclose(record["command"], [5.0, -2.5], rtol=1e-14)
        assert record.units["command"] == "V"
        assert record.display_units["command"] == "V"


def test_a_scale_may_flip_a_sign_or_calibrate_a_raw_column(train):
    record = read_record(train, scale=["arm_angle=-1", "spare=2.5 bar"])
    np.testing.assert_allclose(record["arm_angle"], [-np.pi, -np.pi / 2])
    np.testing.assert_allclose(record["spare"], [1e6, 2e6])
    assert record.units["arm_angle"] == "rad"
    assert record.units["spare"] == "Pa"


def test_a_scale_stands_in_for_a_missing_unit(tmp_path):
    path = tmp_path / "raw.csv"
    path.write_text("time [s],counts\n0,0\n1,4096\n")
    record = read_record(path, scale="counts=0.025 mm")
    np.testing.assert_allclose(record["counts"], [0, 0.1024])


@pytest.mark.parametrize(
    "text",
    ["command:0.05", "command=", "=0.05 V", "command=V/%", "command=1.2.3 V", "command=0 V/%", "command=1e999 V"],
)
def test_a_scale_that_is_not_understood_shows_the_form(text):
    with pytest.raises(DataError, match=r"scale: .*Write --scale command=0.05 V/%\."):
        parse_scale(text)


def test_a_scale_in_an_unknown_unit_or_for_an_unknown_column(train):
    with pytest.raises(UnitError, match=r"scale: 'command=1 Volts': .*not known"):
        parse_scale("command=1 Volts")
    with pytest.raises(DataError, match=r"train_2.csv: no column 'comand', named in scale. Did you mean 'command'\?"):
        read_record(train, scale="comand=0.05 V/%")


def test_scales_read_like_numbers():
    assert parse_scale("a.b = -2.5e-3 m3/(s.Pa)") == Scale("a.b", -2.5e-3, "m3/(s.Pa)")
    assert parse_scale("x=+.5") == Scale("x", 0.5, "1")


def test_a_model_gets_its_columns_in_its_order(train):
    record = require(read_record(train, scale="command=0.05 V/%"), [ANGLE, COMMAND], "cehA")
    assert record.names == ("arm_angle", "command")
    assert record.source == str(train)


def proposed(error) -> str:
    """The scale that a sentence ends with, as a shell hands it on."""
    return str(error.value).rpartition("--scale '")[2].rstrip(".'")


def test_percent_for_volts_asks_for_a_scale_with_the_right_example(train):
    with pytest.raises(UnitError) as error:
        require(read_record(train), [COMMAND], "cehA")
    assert str(error.value).endswith(
        "column 'command' is in %, the model needs V. Say what one of it stands for: --scale 'command=FACTOR V/%'."
    )
    example = proposed(error).replace("FACTOR", "0.05")
    np.testing.assert_allclose(read_record(train, scale=example)["command"], [5.0, -2.5])


@pytest.mark.parametrize("unit", ["C", "F"])
def test_a_temperature_that_is_written_as_a_coulomb_or_a_farad_is_no_matter_of_scale(unit, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"time [s],oil [{unit}]\n0,1\n1,2\n")
    with pytest.raises(UnitError, match=f"If it is a temperature, give its unit: --unit 'oil=deg{unit}'"):
        require(read_record(path), [Signal("oil", "K")], "tank")
    assert require(read_record(path, units={"oil": f"deg{unit}"}), [Signal("oil", "K")], "tank")["oil"][0] > 200


@pytest.mark.parametrize(
    ("unit", "needed"),
    [("bar", "rad"), ("N.s/m", "m3/s"), ("m3/s", "rad/s"), ("%", "rad"), ("1", "rad/s"), ("Hz", "rad/s")],
)
def test_the_scale_an_error_proposes_is_one_that_works(unit, needed, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"time [s],x [{unit}]\n0,1\n1,2\n")
    signal = Signal("x", needed, nominal=3.0)
    with pytest.raises(UnitError, match="--scale 'x=") as error:
        require(read_record(path), [signal], "rig")
    example = proposed(error).replace("FACTOR", "3")
    assert len(require(read_record(path, scale=example), [signal], "rig")) == 2


def test_a_missing_column_names_file_model_and_nearest(train):
    with pytest.raises(
        DataError, match=r"train_2.csv: no column 'arm_angel', cehA needs 'arm_angel \[rad\]'. Did you mean"
    ):
        require(read_record(train), [Signal("arm_angel", "rad")], "cehA")


def test_a_bare_number_is_not_an_angle():
    record = Record([0, 1], {"arm_angle": [1, 2], "ratio": [1, 2]}, {"arm_angle": "1", "ratio": "rad"}, "run")
    with pytest.raises(UnitError, match="run: column 'arm_angle' is in 1, the model needs rad"):
        require(record, [ANGLE], "cehA")
    with pytest.raises(UnitError, match="'ratio' is in rad, the model needs 1"):
        require(record, [Signal("ratio", "1")], "cehA")


@pytest.mark.parametrize("unit", ["1/s", "Hz", "s-1"])
def test_a_bare_rate_for_a_speed_of_rotation_is_refused_with_what_to_write(unit, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"time [s],speed [{unit}]\n0,1\n1,2\n")
    signal = Signal("speed", "rad/s", nominal=100.0)
    radians = "" if unit == "Hz" else " where it counts turns, --scale 'speed=1 rad' where it counts radians"
    with pytest.raises(UnitError, match=rf"write rad/s, rpm or rev/s.*--scale 'speed=1 rev'{radians}\.$"):
        require(read_record(path), [signal], "rig")
    np.testing.assert_allclose(require(read_record(path, scale="speed=1 rad"), [signal], "rig")["speed"], [1, 2])
    turns = require(read_record(path, scale="speed=1 rev"), [signal], "rig")["speed"]
    np.testing.assert_allclose(turns, [2 * np.pi, 4 * np.pi])
    np.testing.assert_allclose(require(read_record(path), [Signal("speed", "1/s")], "rig")["speed"], [1, 2])


def test_revolutions_for_a_rate_are_refused_with_the_scale_that_counts_them(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time [s],rate [rpm]\n0,60\n1,120\n")
    with pytest.raises(UnitError, match=r"'1/s' holds no angle.*--scale 'rate=1 1/rev'\.$"):
        require(read_record(path), [Signal("rate", "1/s")], "rig")
    np.testing.assert_allclose(
        require(read_record(path, scale="rate=1 1/rev"), [Signal("rate", "1/s")], "rig")["rate"], [1, 2]
    )


@pytest.mark.parametrize("unit", ["1/min", "min-1", "min^-1", "/min"])
@pytest.mark.parametrize(("needed", "one"), [("1/s", 1.0), ("Hz", 1.0), ("rad/s", 2 * np.pi), ("rpm", 2 * np.pi)])
def test_per_minute_counts_turns_only_where_an_angle_is_needed(unit, needed, one, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"time [s],strokes [{unit}]\n0,60\n1,120\n")
    record = require(read_record(path), [Signal("strokes", needed)], "rig")
    np.testing.assert_allclose(record["strokes"], [one, 2 * one], rtol=1e-14)
    assert require(record, [Signal("strokes", needed)], "rig")["strokes"][0] == record["strokes"][0]


@pytest.mark.parametrize(
    ("unit", "needed", "told"), [("L", "m3/rad", "=1 1/rev' .*=1 1/rad' "), ("1/s2", "rad/s2", "=1 rev' .*=1 rad' ")]
)
def test_an_angle_left_out_is_scaled_by_a_turn_or_a_radian(unit, needed, told, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"time [s],x [{unit}]\n0,1\n1,2\n")
    with pytest.raises(UnitError, match=told):
        require(read_record(path), [Signal("x", needed)], "rig")
