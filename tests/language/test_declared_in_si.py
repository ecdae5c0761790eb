"""Whatever unit a number is declared or set in, the equations see SI; every key is known or refused."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydrotwin import Record, simulate
from hydrotwin.models.components import FlowSource, LinearLoad, LineVolume, Reservoir
from hydrotwin.models.language import (
    Component,
    DataError,
    DeclarationError,
    HydraulicPort,
    Input,
    Model,
    Output,
    Parameter,
    State,
    UnitError,
    Variable,
    connect,
    der,
)
from hydrotwin.models.language.modelica import modelica_text
from hydrotwin.models.language.parameter_file import parameter_settings


class Relief(Component):
    """Opens at a pressure given in bar."""

    a = HydraulicPort("inlet")
    b = HydraulicPort("outlet")
    setting = Parameter(160, "bar", "opening pressure", bounds=(0, 400), nominal=100)
    slope = Parameter(4e-10, "m3/(s.Pa)", "flow per pressure")

    def equations(self):
        yield self.a.q == self.slope * ca.fmax(self.a.p - self.b.p - self.setting, 0)
        yield self.a.q + self.b.q == 0


class Line(Component):
    """A volume that is filled, and emptied through the valve."""

    flow = Input("L/min", "flow", nominal=6, default=6)
    p = Output("bar", "pressure", nominal=10)
    volume = LineVolume(volume=1e-3, pressure=State(150, "bar", "pressure", nominal=10))
    source = FlowSource()
    tank = Reservoir(pressure=5e5)
    relief = Relief()

    def equations(self):
        yield connect(self.flow, self.source.flow)
        yield connect(self.source.port, self.volume.a)
        yield connect(self.volume.b, self.relief.a)
        yield connect(self.relief.b, self.tank.port)
        yield self.p == self.volume.pressure


def test_the_pressure_of_a_line_settles_at_what_its_valve_tank_and_flow_make():
    time = np.arange(0, 5, 0.01)
    recording = Record(time, {"flow": np.full(len(time), 1e-4)}, {"flow": "m3/s"}, "filling")
    answer = simulate(Model(Line(), "line"), recording)
    assert answer["p"][0] == pytest.approx(150e5)
    assert answer["p"][-1] == pytest.approx(160e5 + 5e5 + 1e-4 / 4e-10, rel=1e-6)


def test_every_number_of_a_declaration_is_in_si():
    flat = Model(Line(), "line").flat
    setting = next(p for p in flat.parameters if p.name == "relief.setting")
    assert (setting.value, setting.unit, setting.bounds, setting.nominal) == (160e5, "Pa", (0, 400e5), 100e5)
    (flow,), (p,), (state,) = flat.inputs, flat.outputs, flat.states
    assert (flow.unit, flow.nominal, flow.default) == ("m3/s", pytest.approx(1e-4), pytest.approx(1e-4))
    assert (p.unit, p.nominal, state.unit, state.nominal) == ("Pa", 1e6, "Pa", 1e6)
    guess = Variable("mm", nominal=2.0, start=5.0)
    assert (guess.unit, guess.nominal, guess.start) == ("m", pytest.approx(2e-3), pytest.approx(5e-3))
    warm = Parameter(40.0, "degC", bounds=(0, 100), nominal=10.0)
    assert (warm.value, warm.bounds, warm.nominal) == (pytest.approx(313.15), pytest.approx((273.15, 373.15)), 10.0)


@pytest.mark.parametrize(
    "change",
    (
        {"value": 5, "unit": "bar"},
        {"value": 5e5},
        {"value": 0.5, "unit": "MPa", "bounds": (0, 1), "sigma": 0.01},
        5e5,
    ),
)
def test_a_setting_is_in_the_unit_it_says(change):
    model = Model(Line(), "line", settings={"tank.pressure": change})
    for again in (model, Model(Line(), "line").with_settings({"tank.pressure": change}), model.with_settings({})):
        p = next(p for p in again.flat.parameters if p.name == "tank.pressure")
        assert p.value == pytest.approx(5e5)
        if isinstance(change, dict) and "sigma" in change:
            assert p.bounds == pytest.approx((0, 1e6)) and p.sigma == pytest.approx(1e4)


def test_a_number_alone_for_what_was_declared_in_bar_is_asked_for_its_unit():
    of_a_file = Model(Line(), "line", settings={"relief.setting": {"value": 200e5, "unit": "Pa", "sigma": 1e5}})
    assert of_a_file.with_settings({"relief.setting": {"sigma": None, "free": True}}).flat.parameters
    for refused in (
        lambda: Relief(setting=200),
        lambda: Model(Line(), "line", settings={"relief.setting": 200}).flat,
        lambda: Model(Line(), "line", settings={"relief.setting": {"bounds": (100, 300)}}).flat,
        lambda: of_a_file.with_settings({"relief.setting": 210}).flat,  # the unit of the file is that of its number
        lambda: of_a_file.with_settings({"relief.setting": {"value": 210, "sigma": None}}).flat,
    ):
        with pytest.raises(DeclarationError, match=r"declared in bar, so .* alone may mean bar or Pa"):
            refused()
    for right in (
        Model(Line(relief=Relief(setting=Parameter(200, "bar"))), "line"),
        Model(Line(), "line", settings={"relief.setting": {"value": 200, "unit": "bar"}}),
        Model(Line(), "line").with_parameters({"relief.setting": 200e5}),
    ):
        assert right.flat.parameter_vector()[right.flat.index_of("relief.setting")] == 200e5


@pytest.mark.parametrize(
    ("change", "said"),
    (
        ({"valu": 6e5, "frei": True}, r"'valu'\. Did you mean 'value'\?.*'frei'\. Did you mean 'free'\?"),
        ({"value": 6e5, "unnit": "Pa"}, r"Did you mean 'unit'\?"),
        ({"bounds": (3, 1)}, "in no order"),
        ({"bounds": 3}, "no pair of numbers"),
        ({"sigma": -1}, "sigma not negative"),
        ({"value": float("nan")}, "must be finite"),
        ({"value": "5 bar"}, "no number"),
        ({"value": True}, "no number"),
        ({"free": "yes"}, "true or false"),
        ("5 bar", "no number"),
        (None, r"no number \(got None\)\. Give a number, such as 1\.0"),
        ({"value": None}, "no number"),
        ([5], "no number"),
        ({"unit": "MPa"}, "a unit and no value"),
        ({"unit": "MPa", "free": True}, "a unit and no value"),
    ),
)
def test_what_a_setting_cannot_say_is_refused_with_the_nearest_key(change, said):
    with pytest.raises(DeclarationError, match=rf"line\.tank\.pressure: .*{said}"):
        Model(Line(), "line", settings={"tank.pressure": change})


def test_an_unknown_unit_or_another_dimension_is_refused():
    with pytest.raises(UnitError, match=r"tank\.pressure: unit 'bra'"):
        Model(Line(), "line", settings={"tank.pressure": {"value": 5, "unit": "bra"}})
    with pytest.raises(UnitError, match="'m': cannot become 'Pa'"):
        Model(Line(), "line", settings={"tank.pressure": {"value": 5, "unit": "mm"}}).flat  # noqa: B018
    with pytest.raises(UnitError, match=r"Relief\.setting: its unit is Pa"):
        Relief(setting=Parameter(5, "mm"))
    with pytest.raises(DeclarationError, match=r"LinearLoad: no 'mas'\. Did you mean 'mass'\?"):
        LinearLoad(mas=95)
    with pytest.raises(DeclarationError, match="step"):
        Model(Line(), "line", step=-1e-3)


@pytest.mark.parametrize(
    ("table", "said"),
    (
        (
            {"tank": {"pressure": {"valu": 5, "unit": "bar"}}},
            r"tank\.pressure: unknown key 'valu'\. Did you mean 'value'",
        ),
        ({"tank": {"pressure": {"value": 5, "unit": "bar", "bound": [0, 9]}}}, "Did you mean 'bounds'"),
        ({"tank": {"pressure": {"unit": "bar"}}}, "no value"),
        ({"tank.pressure": {"value": 5, "unit": "bar"}, "tank": {"pressure": {"value": 6, "unit": "bar"}}}, "twice"),
        ({"tank": {"pressure": {"value": 5, "unit": "bar", "bounds": [9, 0]}}}, "in no order"),
    ),
)
def test_what_a_file_cannot_say_is_refused(table, said):
    with pytest.raises(DataError, match=rf"f\.toml: .*{said}"):
        parameter_settings(table, "f.toml")


@pytest.mark.parametrize(
    ("outer", "inner", "factor"),
    (("bar", "Pa", 1e-5), ("deg", "rad", 180 / np.pi), ("m", "mm", 1e-3), ("%", "1", 100.0), ("L/min", "m3/s", 6e4)),
)
def test_a_conversion_by_hand_is_one_too_many(outer, inner, factor):
    def part(by):
        content = {"u": Input(inner), "y": Output(outer)}
        return Model(type("Part", (Component,), {**content, "equations": lambda s: iter([s.y == by(s.u)])})(), "part")

    assert float(part(lambda u: u).flat.ode(0, [], [2.0], [])[1]) == 2.0
    for by in (lambda u: u * factor, lambda u: u / (1 / factor)):
        with pytest.raises(UnitError, match="by hand"):
            part(by).flat  # noqa: B018


def test_a_conversion_in_two_literals_is_found_too():
    class Turning(Component):
        w = Input("rad/s")
        n = Output("rpm")
        x = State(0.0, "rpm")
        T = Parameter(20, "ms")

        def equations(self):
            yield self.n == self.w * 60 / 2 / np.pi
            yield self.T * der(self.x) == self.w - self.x

    with pytest.raises(UnitError, match="to or from rpm by hand"):
        Model(Turning(), "turning").flat  # noqa: B018


@pytest.mark.parametrize(
    ("given", "said"),
    (
        ({"name": 5}, "the name is no text"),
        ({"settings": None}, "settings are not given by name"),
        ({"settings": 5}, "settings are not given by name"),
        ({"settings": "tank"}, "settings are not given by name"),
        ({"settings": {5: 1.0}}, "one of the settings has no name"),
        ({"settings": {"line.volume.volume": 1e-3}}, r"Write 'volume\.volume': paths begin within"),
        ({"settings": {"tnk.pressure": 1e5}}, r"line: no parameter 'tnk\.pressure'\. Did you mean 'tank\.pressure'"),
        ({"inputs": None}, "inputs are not given by name"),
        ({"inputs": {"flow": "hold"}}, "changes are not given by name"),
        ({"inputs": {"flw": {"interpolation": "hold"}}}, "no input 'flw'. Did you mean 'flow'"),
        ({"inputs": {"flow": {"interpolation": "cubic"}}}, "unknown interpolation"),
        ({"inputs": {"flow": {"interpolaton": "hold"}}}, "Did you mean 'interpolation'"),
        ({"inputs": {"flow": {"nominal": 0}}}, "nothing to change by the name 'nominal'"),
        ({"inputs": {"flow": {"shift": float("nan")}}}, "the shift is no time"),
    ),
)
def test_what_a_model_cannot_be_given_is_refused_with_what_to_write(given, said):
    with pytest.raises(DeclarationError, match=said):
        Model(Line(), **{"name": "line", **given}).flat  # noqa: B018
    if "inputs" in given:
        with pytest.raises(DeclarationError, match=said):
            Model(Line(), "line").with_inputs(given["inputs"])
    if "settings" in given:
        with pytest.raises(DeclarationError, match=said):
            Model(Line(), "line").with_settings(given["settings"]).flat  # noqa: B018


def following(**declared) -> Model:
    class Part(Component):
        y = Output("1")
        x = State(0.0, "1")
        T = Parameter(0.1, "s")
        n = Parameter(2.0, "1")
        turn = Parameter(10, "deg")
        low, high = Parameter(5, "bar"), Parameter(10, "bar")

        def equations(self):
            yield self.T * der(self.x) == -self.x
            yield self.y == self.x

    return Model(type("Given", (Part,), declared)(), "given")


@pytest.mark.parametrize(
    ("function", "unit", "right"),
    (
        (lambda c: 30.0, "deg", np.pi / 6),
        (lambda c: 1, "deg", np.pi / 180),
        (lambda c: 50.0, "%", 0.5),
        (lambda c: 160, "bar", 160e5),
        (lambda c: 20, "degC", 293.15),
        (lambda c: ca.SX(3), "ms", 3e-3),
        (lambda c: 2 * c.turn, "deg", np.pi / 9),
        (lambda c: c.low / c.high, "%", 0.5),
        (lambda c: 3 * c.low, "bar", 15e5),
    ),
)
def test_what_a_function_gives_is_in_si_as_if_it_stood_there(function, unit, right):
    ((follower, _),) = [f for f in following(a=Parameter(function, unit)).followers if f[0].name == "a"]
    assert follower.value == pytest.approx(right)
    assert following(x=State(function, unit), y=Output(unit)).equilibrium()[0] == pytest.approx(right)


@pytest.mark.parametrize("name", ("a", "x"))
def test_a_function_of_pure_numbers_does_not_tell_a_degree_from_a_radian(name):
    kind = {"a": Parameter, "x": State}[name]
    unclear = (
        (lambda c: 30 * c.n, "deg"),
        (lambda c: 50 * c.low / c.high, "%"),
        (lambda c: c.turn + 45, "deg"),
        (lambda c: c.turn + 1, "deg"),
        (lambda c: ca.fmax(c.turn, 45), "deg"),
        (lambda c: 3 - c.turn / 2, "deg"),
    )
    for function, unit in unclear:
        with pytest.raises(UnitError, match=rf"{name}: declared in {unit}, so .* may mean {unit} or"):
            following(**{name: kind(function, unit)}).equilibrium()
    with pytest.raises(DeclarationError, match="declared in deg, so 30 alone may mean deg or rad"):
        changed = following(**{name: kind(1.0, "deg")}).root.but(**{name: lambda c: 30.0})
        Model(changed, "given").equilibrium()


def test_what_follows_a_signal_is_no_follower_and_no_parameter_of_modelica():
    class Warming(Component):
        u = Input("K", "temperature", nominal=300.0)
        y = Output("1")
        x = State(1.0, "1")
        T = Parameter(lambda c: c.T0 * c.u / c.u0, "s")
        T0, u0 = Parameter(0.1, "s"), Parameter(300, "K")

        def equations(self):
            yield self.T * der(self.x) == -self.x
            yield self.y == self.x

    model = Model(Warming(), "warming")
    assert model.followers == () and model.varying == ("T",)
    assert [p.name for p in model.flat.parameters] == ["T0", "u0"]
    with pytest.raises(DeclarationError, match="warming: T follows a signal"):
        modelica_text(model)
