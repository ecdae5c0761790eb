"""Python files of users: whatever is wrong with one, the answer names file, line and the next step."""

from __future__ import annotations

import pytest

from hydrotwin import HydrotwinError
from hydrotwin.loading import load
from tests.face.command_line import hydrotwin

PART = """from hydrotwin.models.components import Gain
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, connect, der, time
class Part(Component):
    u = Input("1", "in")
    y = Output("1", "out")
"""
SAYS, MAKES = "    def equations(self):", "\ndef m(): return Model(Part(), 'm')"
FILES = {
    "def m(): return Gain()": r"line 6: .*returns no Model \(got the component Gain\).*Model\(component, 'name'\)",
    "def m(size): return Model(Gain(k=size), 'm')": r"line 6: m needs arguments \(size\)",
    "def m(): return Model(Gain(kk=2), 'm')": r"line 6: Gain: no 'kk'\. Did you mean 'k'\?",
    "def m(): return Model(Gain(), 'm', setings={})": r"line 6: .*unexpected keyword argument 'setings'",
    "def m(): return Model(Gain(), 'm', settings={'k': {'valu': 2}})": r"line 6: m\.k: .*Did you mean 'value'\?",
    "def m(): return {}['gain']": r"line 6: does not run \(KeyError: 'gain'\)",
    "def m() return Model(Gain())": r"line 6: does not run \(SyntaxError",
    "    def equations(self): yield self.y = self.u\ndef m(): return 3": r"line 6: .*SyntaxError.*yield left == right",
    "    half = 0.5 * Parameter(1.0, '1')\ndef m(): return 3": r"line 6: .*Parameter\(lambda c: ",
    "    parts = [Gain(), Gain()]\ndef m(): return 3": r"line 3: Part\.parts: a list of parts.*parts_1",
    "    part = Gain\ndef m(): return 3": r"line 3: Part\.part: a class where a part is meant.*Gain\(\.\.\)",
    "    k = Parameter(5, 'bra')\ndef m(): return 3": r"line 6: Parameter: unit 'bra': not known",
    "    k = Parameter(float('nan'), 'm')\ndef m(): return 3": r"line 6: Parameter: value is not finite",
    "import b_of_a_circle\nM = 1": r"b_of_a_circle\.py: line 1: .*Two files import each other, .* third file",
    f"{SAYS} yield self.y == max(self.u, 0){MAKES}": r"line 6: .*ca\.fmax",
    f"{SAYS} self.y == self.u{MAKES}": r"line 6: .*Write 'yield' before it",
}


@pytest.mark.parametrize("body", FILES)
def test_what_is_wrong_is_told_with_file_line_and_next_step(tmp_path, body):
    (tmp_path / "rig_of_user.py").write_text(PART + body + "\n")
    (tmp_path / "b_of_a_circle.py").write_text("from rig_of_user import M\n")
    with pytest.raises(HydrotwinError, match=rf"(?s){FILES[body]}"):
        _ = load(f"{tmp_path / 'rig_of_user.py'}:m").flat


def test_the_command_line_says_the_same_without_a_traceback(tmp_path):
    (tmp_path / "rig_of_user.py").write_text(f"{PART}{SAYS}\n        if self.u > 0: yield self.y == 1{MAKES}\n")
    answer = hydrotwin("modelica", f"{tmp_path / 'rig_of_user.py'}:m", "--out", tmp_path / "m.mo")
    assert answer.code == 2
    assert "rig_of_user.py: line 7:" in answer.said and "ca.if_else" in answer.said
    assert "Traceback" not in answer.said


def test_a_file_may_import_its_neighbour_late_and_gets_its_own(tmp_path):
    for folder, gain in (("one", 2.0), ("other", 3.0)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "neighbour_of_user.py").write_text(f"GAIN = {gain}\n")
        (tmp_path / folder / "rig_of_user.py").write_text(
            f"{PART}def m():\n    from neighbour_of_user import GAIN\n    return Model(Gain(k=GAIN), 'm')\n"
        )
    gains = [
        load(f"{tmp_path / folder / 'rig_of_user.py'}:m").flat.parameter_vector()[0] for folder in ("one", "other")
    ]
    assert gains == [2.0, 3.0]
