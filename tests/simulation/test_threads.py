"""One propagator, several threads."""

from __future__ import annotations

import threading
import time as clock
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from hydrotwin.simulation import engines, equations, prepare, stiffness
from tests.simulation.flat_cehA import flat_cehA
from tests.simulation.small_models import lag

TIME = np.arange(400) * 0.01


def test_threads_give_the_answers_of_a_single_one():
    model = flat_cehA()
    p, free = model.parameter_vector(), ("motor.gain", "cylinder.oil.bulk_modulus")
    x0 = model.start_given(["arm.angle"])(0, p, [0.1]).full().ravel()
    commands = [np.sin((2 + k) * TIME)[:, None] for k in range(8)]
    propagator = prepare(model, free_parameters=free)  # "auto" is settled by whichever thread comes first

    def answer(u):
        return propagator.sensitivity(TIME, u, p, x0, np.zeros((5, 2)))

    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(answer, commands))
    for alone, threaded in zip(map(answer, commands), together, strict=True):
        for a, b in zip(alone, threaded, strict=True):
            assert (a == b).all()


def test_expressions_are_built_in_one_thread_at_a_time(monkeypatch):
    """CasADi lets other threads in, and two that build at once crash the process, now and then."""
    inside, most = [], []

    def watched(build):
        def built(*given, **named):
            inside.append(threading.get_ident())
            most.append(len(set(inside)))
            clock.sleep(0.01)
            try:
                return build(*given, **named)
            finally:
                inside.remove(threading.get_ident())

        return built

    monkeypatch.setattr(equations, "rate", watched(equations.rate))
    monkeypatch.setattr(engines, "functions_of", watched(engines.functions_of))
    models = [lag() for _ in range(4)]

    def run(model):
        p, x, u = model.parameter_vector(), np.zeros((len(TIME), 1)), np.ones((len(TIME), 1))
        assert stiffness.explicit_will_do(model, 0.01, TIME, u, p, x[0], x)
        for method in ("explicit", "implicit", "vm"):
            assert np.isfinite(prepare(model, method=method).run(TIME, u, p, x[0])[0]).all()

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(run, models))
    assert len(most) >= 2 * len(models)
    assert max(most) == 1


def test_python_goes_on_while_a_run_is_in_c():
    model = lag()
    propagator = prepare(model, method="explicit", step=1e-6)
    time = np.linspace(0, 3, 3)
    arguments = (time, np.ones((3, 1)), model.parameter_vector(), np.zeros(1))
    worker = threading.Thread(target=propagator.run, args=arguments)
    worker.start()
    turns = 0
    while worker.is_alive():
        turns += 1
    assert turns > 1000  # with the lock held this loop would hardly turn
