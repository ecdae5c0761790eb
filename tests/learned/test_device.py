"""Where PyTorch trains: every trainer computes on the device that one function chooses, and answers in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.learned import learn_inverse, learn_rate_network
from hydrotwin.learned.gaussian.dual import learn_dual_gp
from hydrotwin.learned.gaussian.single import learn_gaussian_process
from tests.learned.test_gaussian_process import valve_record
from tests.learned.test_inverse import points

torch = pytest.importorskip("torch")
pytest.importorskip("gpytorch")

TRAINERS = {
    "gp": lambda: learn_gaussian_process([valve_record(1, 20.0)], ["current"], ["spool"], points=100),
    "dual_gp": lambda: learn_dual_gp([valve_record(1, 20.0)], ["current"], ["position"], points=100),
    "nn paper": lambda: learn_rate_network([valve_record(1, 20.0)], ["current"], ["position"], iterations=20),
    "inverse": lambda: learn_inverse(points(), method="monotone", hidden=4, iterations=20),
}


def test_the_gpu_is_taken_when_torch_sees_one(monkeypatch):
    from hydrotwin.learned import device

    for seen, kind in ((True, "cuda"), (False, "cpu")):
        monkeypatch.setattr("torch.cuda.is_available", lambda seen=seen: seen)
        assert device.training_device().type == kind


@pytest.mark.parametrize("kind", TRAINERS)
def test_all_tensors_of_a_training_are_where_the_one_function_says_and_the_block_is_the_same(kind, monkeypatch):
    from tests.learned.another_device import ELSEWHERE, AnotherDevice

    expected = TRAINERS[kind]()
    monkeypatch.setattr("hydrotwin.learned.device.training_device", lambda: ELSEWHERE)
    with AnotherDevice() as another:
        block = TRAINERS[kind]()
    assert another.operations > 500
    assert block.certificate.holds
    for name, array in expected.arrays.items():
        assert isinstance(block.arrays[name], np.ndarray)
        assert np.array_equal(block.arrays[name], array), name


def test_the_second_device_refuses_tensors_of_the_cpu():
    from tests.learned.another_device import ELSEWHERE, AnotherDevice

    with AnotherDevice():
        there = torch.ones(3).to(ELSEWHERE)
        assert (2.0 * there).cpu().tolist() == [2.0] * 3
        with pytest.raises(AssertionError, match="tensors of the CPU met tensors elsewhere"):
            there + torch.ones(3)
