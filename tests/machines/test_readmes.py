"""The READMEs of models/ say what is true: their code runs, their numbers are the model's, their tests exist."""

from __future__ import annotations

import doctest
import re
from pathlib import Path

import pytest

from tests.machines.recordings import MODELS

ROOT = Path(__file__).resolve().parents[2]
README = {name: ROOT / "models" / name / "README.md" for name in MODELS}


def code_blocks(path: Path) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("machine", MODELS)
def test_the_examples_of_a_machine_give_what_they_print(machine):
    failed, tried = doctest.testfile(str(README[machine]), module_relative=False)
    assert tried > 5 and failed == 0


@pytest.mark.parametrize("machine", MODELS)
def test_the_parameter_table_is_that_of_the_model(machine):
    lines = README[machine].read_text(encoding="utf-8").splitlines()
    rows = [
        [cell.strip(" `") for cell in line.split("|")[1:-1]] for line in lines if re.match(r"\| `[\w.]+` \| ", line)
    ]
    written = {row[0]: (float(row[2]), row[3], row[4] == "yes") for row in rows if len(row) == 6}
    assert all(row[5] for row in rows if len(row) == 6)
    assert written == {p.name: (p.value, p.unit, p.free) for p in MODELS[machine]().flat.parameters}


@pytest.mark.parametrize("machine", MODELS)
def test_a_readme_names_every_signal_and_state_and_only_tests_that_exist(machine):
    text, flat = README[machine].read_text(encoding="utf-8"), MODELS[machine]().flat
    for quantity in (*flat.inputs, *flat.outputs, *flat.states):
        assert f"`{quantity.name}`" in text
    tests = "".join(p.read_text(encoding="utf-8") for room in ("machines", "components", "laws")
                    for p in (ROOT / "tests" / room).glob("test_*.py"))  # fmt: skip
    named = re.findall(r"`(test_\w+)`", text)
    assert named
    assert [name for name in named if f"def {name}(" not in tests] == []


def test_the_worked_example_of_an_own_law_component_and_model_runs(capsys):
    names = {}
    for number, block in enumerate(code_blocks(ROOT / "models" / "README.md"), start=1):
        exec(compile(block, f"models/README.md, block {number}", "exec"), names)
    first, second = capsys.readouterr().out.strip().splitlines()
    assert first.startswith("wrong: 29 equations for 30 unknowns. Not connected: drive.speed.")
    assert "(got m-1.kg.s-3 on the left and s-1 on the right)" in second
    assert "block 5: line 13: wrong.accumulator: units do not balance" in second


def test_the_accumulator_of_the_worked_example_holds_its_gas_to_p_v_to_the_n():
    from tests.components.bench import bench, run

    names = {}
    for block in code_blocks(ROOT / "models" / "README.md")[:2]:
        exec(compile(block, "models/README.md", "exec"), names)
    y = run(bench(names["Accumulator"](), port="flow"), [0.0, 1.0], port=1e-4)
    volume = 5e-4 * (2e6 / 3e6) ** (1 / 1.4) - 1e-4
    assert y["port_p"][-1] == pytest.approx(2e6 * (5e-4 / volume) ** 1.4, rel=1e-8)
