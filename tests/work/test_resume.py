"""Finished jobs are kept on disk by their content and found again, whole or not at all."""

from __future__ import annotations

import dataclasses
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from hydrotwin.models import cehA
from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.work.executor import executor_for, portable
from hydrotwin.work.memory import Memory, key_of, packed, recalled, unpacked

ANSWER = {
    "values": {"a.b": 1 / 3, "c": np.float64(np.pi)},
    "runs": [np.arange(6.0).reshape(2, 3) / 7, np.array([np.nan, np.inf, -0.0])],
    "counts": np.array([1, 2], dtype=np.int32),
    "converged": True,
    "note": None,
    "words": ["diverged", "élan"],
    "bad": float("nan"),
}


def test_an_answer_comes_back_bit_by_bit(tmp_path):
    memory, key = Memory(tmp_path / "kept"), key_of("job", 1)
    assert memory.get(key) is None and len(memory) == 0
    memory.put(key, ANSWER)
    found = Memory(tmp_path / "kept").get(key)
    assert len(memory) == 1
    assert found["values"] == {"a.b": 1 / 3, "c": np.pi}
    for ours, theirs in zip(ANSWER["runs"], found["runs"], strict=True):
        assert ours.tobytes() == theirs.tobytes() and ours.shape == theirs.shape
    assert found["counts"].dtype == np.int32
    assert (found["converged"], found["note"], found["words"]) == (True, None, ["diverged", "élan"])
    assert np.isnan(found["bad"])


@pytest.mark.parametrize("damage", ["cut", "empty", "other"])
def test_a_damaged_file_is_as_good_as_none(tmp_path, damage):
    memory, key = Memory(tmp_path), key_of("job")
    memory.put(key, ANSWER)
    (path,) = tmp_path.glob("*.npz")
    whole = path.read_bytes()
    path.write_bytes({"cut": whole[: len(whole) // 2], "empty": b"", "other": b"not a file of ours"}[damage])
    assert memory.get(key) is None
    memory.put(key, ANSWER)
    assert memory.get(key) is not None


def test_no_code_is_ever_read_from_the_folder(tmp_path):
    memory, key = Memory(tmp_path), key_of("job")
    np.savez(
        tmp_path / f"{key}.npz", a0=np.array([object], dtype=object), __json__=np.array('{"x": {"__array__": "a0"}}')
    )
    assert memory.get(key) is None
    with pytest.raises(DeclarationError, match="objects"):
        memory.put(key, {"x": np.array([object])})


@pytest.mark.parametrize("key", ["", "../elsewhere", "ABC", "a/b"])
def test_only_a_hash_is_a_key(tmp_path, key):
    with pytest.raises(DeclarationError, match="is no key"):
        Memory(tmp_path).get(key)


def test_a_memory_that_is_done_leaves_nothing(tmp_path):
    memory = Memory(tmp_path / "kept")
    memory.put(key_of(1), ANSWER)
    memory.remove()
    assert not (tmp_path / "kept").exists()
    memory.remove()


def test_the_key_follows_everything_a_job_depends_on():
    flat = cehA.model().flat
    job = {"flat": flat, "free": ("motor.gain",), "u": np.zeros(3), "weight": None}
    changes = [
        {"flat": flat.with_parameters({"motor.gain": 131.0})},
        {"flat": cehA.third_order().flat},
        {"flat": dataclasses.replace(flat, step=5e-4)},
        {"free": ("motor.gain", "arm.mass")},
        {"free": ("motor", "gain")},
        {"u": np.array([0.0, 0.0, 1e-300])},
        {"u": np.zeros((3, 1))},
        {"u": np.zeros(3, dtype=np.float32)},
        {"weight": 0.0},
    ]
    keys = [key_of(job), *(key_of({**job, **change}) for change in changes)]
    assert len(set(keys)) == len(keys)


def test_the_same_job_has_the_same_key_built_twice_and_packed():
    first, again = cehA.model().flat, cehA.model().flat
    assert key_of(first) == key_of(again) == key_of(portable(first))
    assert key_of({"a": 1, "b": 2}) == key_of({"b": 2, "a": 1})


def test_a_model_packed_for_one_job_alone_has_a_key_too():
    flat = cehA.model().flat
    from hydrotwin.work.executor import Starts

    alone = dataclasses.replace(flat, initialisation=Starts({("arm.angle",): flat.start_given(("arm.angle",))}))
    assert key_of(alone) != key_of(flat)


@dataclasses.dataclass(frozen=True, eq=False)
class Fitted:
    """An answer with everything an answer may have in it."""

    values: dict
    runs: tuple
    inner: object = None


def test_an_answer_made_of_dataclasses_and_tuples_is_made_again(tmp_path):
    answer = Fitted({"a.b": 0.1}, (np.array([1.0, 2.0]), ("x", 1)), Fitted({}, ()))
    memory = Memory(tmp_path)
    memory.put(key_of("it"), {"answer": packed(answer)})
    again = unpacked(memory.get(key_of("it"))["answer"], {"Fitted": Fitted})
    assert isinstance(again, Fitted) and isinstance(again.inner, Fitted) and again.inner.runs == ()
    assert again.values == {"a.b": 0.1} and again.runs[1] == ("x", 1)
    assert np.array_equal(again.runs[0], answer.runs[0])


def squared(x: float) -> Fitted | str:
    """A job; the negative one fails once."""
    if x < 0:
        raise KeyboardInterrupt
    return Fitted({"square": x * x}, ()) if x else "nothing to fit"


@pytest.mark.parametrize("kept", [True, False])
def test_an_interrupted_list_of_jobs_goes_on_where_it_stopped(tmp_path, kept):
    memory, told = Memory(tmp_path) if kept else None, []
    with executor_for("here") as pool:
        with pytest.raises(KeyboardInterrupt):
            recalled(memory, pool, squared, [1.0, 0.0, -1.0, 3.0], kinds=[Fitted])
        if kept:
            for path in tmp_path.glob("*.npz"):  # what is known is not computed: the stored answer is believed
                stored = memory.get(path.stem)
                if isinstance(stored["answer"], dict):
                    memory.put(path.stem, {"answer": packed(Fitted({"square": 42.0}, ()))})
        answers = recalled(memory, pool, squared, [1.0, 0.0, 2.0, 3.0], lambda k, a: told.append(k), kinds=[Fitted])
    assert [a if isinstance(a, str) else a.values["square"] for a in answers] == [
        42.0 if kept else 1.0,
        "nothing to fit",
        4.0,
        answers[3].values["square"],
    ]
    assert sorted(told) == [0, 1, 2, 3]


# -- seconds -----------------------------------------------------------------------------------------------------------
TICK = 0.15  # s


def waited(x: float) -> Fitted:
    """A job that takes a while."""
    time.sleep(TICK)
    return Fitted({"square": x * x}, ())


def through(memory: Memory, jobs, **more) -> float:
    """Seconds that a search through these jobs takes by itself."""
    began = time.perf_counter()
    memory.begin()
    with executor_for("here") as pool:
        recalled(memory, pool, waited, jobs, kinds=[Fitted], **more)
        return time.perf_counter() - began


@pytest.mark.parametrize("kept", [True, False])
def test_the_seconds_of_a_search_are_those_of_all_its_parts(tmp_path, kept):
    """Whether answers are kept, or found again in no time and only their seconds known."""
    first = through(Memory(tmp_path), [1.0, 2.0], kept=kept)
    memory = Memory(tmp_path)
    second = through(memory, [1.0, 2.0, 3.0], kept=kept)
    assert first > 2 * TICK and memory.earlier == pytest.approx(first, abs=0.1)
    assert second > (1 if kept else 3) * TICK
    memory = Memory(tmp_path)
    through(memory, [1.0, 2.0, 3.0], kept=kept)
    assert memory.earlier == pytest.approx(first + second, abs=0.1)


def test_what_a_search_asks_twice_counts_once_and_another_search_counts_what_it_found(tmp_path):
    memory = Memory(tmp_path)
    through(memory, [1.0, 2.0])
    assert memory.earlier == 0.0
    with executor_for("here") as pool:
        recalled(memory, pool, waited, [1.0, 2.0], kinds=[Fitted])
    assert memory.earlier == 0.0, "of this very search"
    through(memory, [2.0, 2.0])
    assert memory.earlier == pytest.approx(TICK, abs=0.1), "what is not asked again is of no search"


def test_a_killed_search_loses_the_seconds_of_one_job_at_most(tmp_path):
    killed = f"""
import os, signal, time
from tests.work.test_resume import Memory, waited, recalled, executor_for, Fitted
def now_and_then(index, answer):
    if index == 2:
        os.kill(os.getpid(), signal.SIGKILL)
memory = Memory({str(tmp_path)!r})
with executor_for("here") as pool:
    recalled(memory, pool, waited, [1.0, 2.0, 3.0, 4.0], now_and_then, kinds=[Fitted])
"""
    ended = subprocess.run([sys.executable, "-c", killed], check=False)
    assert ended.returncode == -signal.SIGKILL
    memory = Memory(tmp_path)
    assert len(memory) == 3
    through(memory, [1.0, 2.0, 3.0])
    assert memory.earlier >= 3 * TICK


def test_seconds_that_cannot_be_read_are_none(tmp_path):
    memory = Memory(tmp_path)
    through(memory, [1.0])
    (path,) = tmp_path.glob("*.seconds")
    path.write_text("soon")
    through(memory, [1.0])
    assert memory.earlier == 0.0
    memory.remove()
    assert not tmp_path.exists()


def test_what_has_no_content_is_refused():
    with pytest.raises(DeclarationError, match="no content to hash"):
        key_of(lambda: 0)
