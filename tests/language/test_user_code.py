"""What Python cannot do with a quantity, and other slips in a model file: file, line and what to write instead."""

from __future__ import annotations

import importlib.util
import math

import casadi as ca
import numpy as np
import pytest

from hydrotwin.models.components import Cylinder, Gain
from hydrotwin.models.language import (
    Component,
    DeclarationError,
    HydrotwinError,
    Input,
    Model,
    Output,
    Parameter,
    State,
    TopologyError,
    UnitError,
    der,
)
from hydrotwin.models.laws import FrictionLaw

HEAD = """import math
import casadi as ca
import numpy as np
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, connect, der, time

class Part(Component):
    u = Input("1", "in")
    y = Output("1", "out")
    x = State(0.5, "1", "x")
    T = Parameter(0.1, "s", "lag")
    def equations(self):
        yield self.T * der(self.x) == self.u - self.x
"""
LINE = 13  # of what follows
REFUSED = {
    "yield self.y == (1 if self.x > 0 else 0)": "ca.if_else",
    "if self.u > 0: yield self.y == 1": "ca.if_else",
    "yield self.y == (self.x > 0 and self.u > 0)": "ca.logic_and",
    "yield self.y == (self.x or self.u)": "ca.logic_or",
    "yield self.y == (not self.x)": "ca.logic_not",
    "yield self.y == (0 < self.x < 1)": "ca.logic_and",
    "yield self.y == (self.x in (1, 2))": "ca.logic_or",
    "yield self.y == (self.x > 0) & (self.u > 0)": "ca.logic_and",
    "yield self.y == max(self.x, 0)": "ca.fmax",
    "yield self.y == min(self.x, self.u)": "ca.fmin",
    "yield self.y == np.max([self.x, self.u])": "ca.fmax",
    "yield self.y == sorted([self.x, self.u])[0]": "ca.fmin",
    "yield self.y == math.sqrt(self.x)": "ca.sqrt",
    "yield self.y == self.x * (math.sqrt(self.x) > 3)": "ca.sqrt",
    "yield self.y == math.fabs(self.x)": "ca.fabs",
    "yield self.y == math.pow(self.x, 2)": r"x\*\*y",
    "yield self.y == float(self.x)": "the quantity itself",
    "yield self.y == int(self.x)": "ca.floor",
    "for k in range(self.x): yield self.y == k": "count = 3",
    "yield self.y == [1, 2][self.x]": "x_1, x_2",
    "yield self.y == self.x[1]": "x_1, x_2",
    "yield self.y == self.x ^ 2": r"x\*\*y",
    "yield self.y == sum(v for v in self.x)": "ca.",
    "yield self.y == f'{self.x:.2f}'": "ca.",
    "yield self.y == ca.if_else(self.x > 0, 1)": r"ca.if_else\(condition, a, b\)",
    "yield self.y == (1 if time > 1 else 0)": "ca.if_else",
    "while self.x > 0: pass": "closed form",
    "yield self.y == self.x * float('nan')": "finite number",
    "yield self.y == ca.if_else(self.x > 0, np.inf, 0)": "finite number",
    "yield self.y == self.x, self.x == self.u": "each equation by itself",
    "yield [self.y == self.x]": "each equation by itself",
    "yield self.y == None": "left == right",
    "yield 3 == 4": "left == right",
    "yield": "left == right",
    "yield self.y <= self.x": "left == right",
    "self.y = self.x": "yield self.y ==",
    "self.y == self.x": "Write 'yield' before it",
    "yield self.y == foo": "Define 'foo'",
    "yield self.y == self.xx": "Did you mean 'x'",
    "yield self.y == 1 / 0": "ZeroDivisionError",
    "yield self.y == {}['a']": "KeyError",
    "yield connect(self.y)": "TypeError",
    "yield self.y == self.T": "units do not balance",
    "yield self.y == ca.SX.sym('z')": r"'z' is a symbol that no component declares.*z = Variable\(unit\)",
    "yield self.y == der(ca.SX.sym('z'))": "'z' is a symbol that no component declares",
    "yield self.y == (q if False and (q := 3) else q)": "Give 'q' a value before that line",
    "from scipy.interpolate import interp1d; yield self.y == interp1d([0, 1], [0, 1])(self.u)": "ca.if_else",
    "v = np.zeros(2); v[0] = self.u; yield self.y == v[0]": "x_1, x_2",
    "yield self.y == np.float64(self.u)": "the quantity itself",
    "yield self.y == np.asarray(self.u, dtype=float)": "the quantity itself",
    "if np.any(self.u): yield self.y == 1": "ca.if_else",
    "yield self.y == ca.interpolant('a', 'linear', [[0, 1, 2]], [0, 1, 4])(self.u)": "ca.pw_lin",
    "z = ca.SX.sym('z'); yield self.y == ca.rootfinder('r', 'newton', {'x': z, 'g': z - 1})(self.u)": "rootfinder",
    "yield self.y == ca.maximum(self.u, 0)": r"Write ca\.fmax\(a, b\)",
    "yield self.y == ca.mod(self.u, 1)": r"Write ca\.fmod\(a, b\)",
    "yield self.y == ca.sqrtt(self.u)": "Did you mean 'sqrt'",
    "Parameter(0.1)": r"Write Parameter\(value, unit, \.\.\)",
    "State(0.1, '1', nominall=3)": "Did you mean 'nominal'",
    "Model(Part(), setings={})": "Did you mean 'settings'",
    "yield self.y == self.u * 10**400": "'self.u . 10..400': a quantity and int do not.*below 1e308",
    "yield self.y == self.u + None": "NoneType do not go together",
    "yield self.y == '2' * self.u": "without quotes",
    "yield self.y == 1j * self.u": "complex do not go together",
    "from decimal import Decimal; yield self.y == self.u * Decimal(2)": r"Write float\(\.\.\) around",
    "from fractions import Fraction; yield self.y == Fraction(1, 2) * self.u": r"Write float\(\.\.\) around",
    "yield self.y == self.u + {}": "dict do not go together",
    "yield self.y == (self.u < None)": "NoneType do not go together",
    "yield self.y == self.u ** None": "NoneType do not go together",
    "self.u += None": "NoneType do not go together",
    "yield self.y == self.u * Parameter(1.0, '1')": "only inside equations",
}


def model_of(tmp_path, body: str) -> Model:
    file = tmp_path / "rig.py"
    file.write_text(f"{HEAD}        {body}\n")
    specification = importlib.util.spec_from_file_location("rig_of_a_test", file)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return Model(module.Part(), "rig")


@pytest.mark.parametrize("body", REFUSED)
def test_what_python_cannot_do_is_refused_with_file_line_and_remedy(tmp_path, body):
    with pytest.raises(HydrotwinError, match=rf"(?s)rig\.py: line {LINE}.*{REFUSED[body]}") as refused:
        model_of(tmp_path, body).flat  # noqa: B018
    assert "casadi/core" not in str(refused.value) and "overloaded function" not in str(refused.value)[:40]


@pytest.mark.parametrize(
    ("body", "value"),
    {
        "yield self.y == (time > 1)": 1.0,
        "yield self.y == ca.if_else(time > 3, 5, self.x)": 0.25,
        "yield self.y == self.x * ca.sin(time / self.T) + self.x * np.sin(2 * time / self.T)": 0.25
        * (math.sin(20) + math.sin(40)),
        "yield self.y == time() / self.T": 20.0,
        "yield self.y == abs(-self.x)": 0.25,
        "yield self.y == np.where(self.x > 0, 4 * self.x, 0)": 1.0,
        "yield self.y == round(3 * self.x)": 1.0,
        "yield self.y == np.clip(self.x, 0, 0.125)": 0.125,
    }.items(),
)
def test_what_has_one_meaning_is_made_right(tmp_path, body, value):
    flat = model_of(tmp_path, body).flat
    assert float(flat.ode(2.0, [0.25], [0.0], flat.parameter_vector())[1]) == pytest.approx(value)


def test_numbers_of_casadi_outside_equations_are_as_they_were():
    model = Model(Gain(), "gain")
    model.flat  # noqa: B018
    assert math.isnan(float(ca.SX.sym("x")))


def test_a_law_is_refused_at_its_own_line():
    class Grip(FrictionLaw):
        """A law that decides."""

        level = Parameter(3.0, "N", "level")

        def force(self, v):
            return self.level if v > 0 else -self.level

    class Slide(Component):
        v = Input("m/s")
        f = Output("N")
        cylinder = Gain()

        def equations(self):
            yield self.f == Grip.force(self.grip, self.v)
            yield self.cylinder.u == 0

        grip = Grip()

    with pytest.raises(DeclarationError, match=r"test_user_code\.py: line \d+: .*ca\.if_else"):
        Model(Slide(), "slide").flat  # noqa: B018


def test_start_values_and_followers_are_under_the_same_net():
    class Started(Component):
        y = Output("1")
        k = Parameter(2.0, "1")
        x = State(lambda c: max(c.k, 1), "1")

        def equations(self):
            yield der(self.x) * self.T == -self.x
            yield self.y == self.x

        T = Parameter(1.0, "s")

    with pytest.raises(DeclarationError, match=r"test_user_code\.py: line \d+: .*ca\.fmax"):
        Model(Started(), "started").flat  # noqa: B018
    with pytest.raises(DeclarationError, match=r"test_user_code\.py: line \d+: .*ca\.sqrt"):
        Model(Started(x=1.0, k=lambda c: math.sqrt(c.T)), "started").flat  # noqa: B018
    with pytest.raises(UnitError, match=r"x: units do not balance"):
        Model(Started(x=lambda c: c.T), "started").flat  # noqa: B018


def test_parts_without_a_name_are_refused_when_the_class_is_declared():
    for held in ([Gain(), Gain()], (Gain(),), {"a": Gain()}):
        with pytest.raises(DeclarationError, match=r"line \d+: Chain\.parts: .* no part of the model.*parts_1"):
            type("Chain", (Component,), {"parts": held})
    with pytest.raises(DeclarationError, match=r"Chain\.part: a class where a part is meant .*Gain\(\.\.\)"):
        type("Chain", (Component,), {"part": Gain})
    with pytest.raises(DeclarationError, match=r"Fixed\.k: declared by a base class and replaced by 3\.0"):
        type("Fixed", (Gain,), {"k": 3.0})
    with pytest.raises(DeclarationError, match="'equations' is a word of the language"):
        type("Odd", (Component,), {"equations": Parameter(1.0, "1")})


def test_parts_made_in_a_constructor_are_refused():
    class Chain(Component):
        u = Input("1")

        def __init__(self):
            super().__init__()
            self.parts = [Gain(), Gain()]

    class Bare(Component):
        u = Input("1")

        def __init__(self):
            self.size = 3

    with pytest.raises(DeclarationError, match=r"test_user_code\.py: line \d+: Chain\.parts: a list of parts"):
        Model(Chain(), "chain").flat  # noqa: B018
    with pytest.raises(DeclarationError, match=r"super\(\).__init__\(\*\*changes\)"):
        Model(Bare(), "bare").flat  # noqa: B018
    with pytest.raises(DeclarationError, match=r"Gain\.k: a component does not change"):
        Gain().k = 3.0


def test_a_missing_super_is_named_where_equations_are_missing():
    class Longer(Gain):
        z = Output("1")

        def equations(self):
            yield self.z == self.u

    with pytest.raises(TopologyError, match=r"Longer\.equations replaces that of Gain.*super\(\)\.equations\(\)"):
        Model(Longer(), "longer").flat  # noqa: B018


def test_a_number_that_is_none_is_refused_where_it_is_declared():
    for make in (
        lambda: Parameter(float("nan"), "m"),
        lambda: Parameter(np.nan, "m"),
        lambda: Parameter(math.inf, "m"),
        lambda: Parameter("5", "m"),
        lambda: State(np.float64("nan"), "m"),
        lambda: Input("m", default=math.nan),
        lambda: Output("m", nominal=0.0),
        lambda: State(0.0, "m", nominal=math.nan),
        lambda: Parameter(1.0, "m", bounds=(2.0, 0.5)),
        lambda: Parameter(1.0, "m", bounds=(2.0, 5.0)),
        lambda: State(9.0, "m", bounds=(2.0, 5.0)),
        lambda: Gain(k=math.nan),
        lambda: Cylinder(cap_pressure=math.nan),
    ):
        with pytest.raises(DeclarationError, match=r"test_user_code\.py: line \d+: "):
            make()


def test_a_vector_is_refused_where_a_model_holds_it():
    class Two(Component):
        x = State([0.0, 0.0], "1", "x")

    with pytest.raises(DeclarationError, match=r"line \d+: State 'x': .*one number: declare each .*x_1"):
        Model(Two(), "two").flat  # noqa: B018


def test_what_is_declared_twice_in_one_class_is_refused_where_the_second_stands():
    with pytest.raises(DeclarationError, match=r"test_user_code\.py: line \d+: 'T' is declared a second time"):

        class Twice(Component):
            T = Parameter(0.1, "s")
            T = Parameter(0.2, "s")

    class Other(Gain):
        k = Parameter(3.0, "1", "a gain of its own")

    assert Model(Other(), "other").flat.parameter_vector() == [3.0]
