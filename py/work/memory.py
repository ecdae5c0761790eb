"""Finished jobs on disk, so that an interrupted search goes on where it stopped. Data only: NPZ and JSON, no pickle."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import shutil
import struct
import time
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.models.language.writing import replacing

from .executor import mapped, portable, versions

_WORDLESS = ("initialisation", "provenance")  # of a FlatModel: hashed as what it gives; no run depends on it
_TEXT = "__json__"
_ARRAY, _TUPLE, _KIND = "__array__", "__tuple__", "__kind__"


class Memory:
    """Answers of jobs by key, one file each, in a folder of its own.

    An answer is a mapping of names to arrays, numbers, strings, None, and lists and mappings of these; arrays come
    back as arrays with the same bits.

    Beside each stands how long a search waited for it. ``earlier`` : seconds [s] that earlier parts of the search which
    has begun spent on what it found here: with its own they are those of the whole search.
    """

    def __init__(self, folder: Path | str):
        self.folder, self._asked = Path(folder), set()
        self.begin()

    def begin(self) -> None:
        """A search begins."""
        self.earlier, self._counted, self._noted = 0.0, set(), time.perf_counter()

    def __len__(self) -> int:
        return len(list(self.folder.glob("*.npz")))

    def get(self, key: str) -> dict | None:
        """The answer under ``key``; None when there is none, or its file was damaged."""
        self._asked.add(key)
        try:
            with self._path(key).open("rb") as file, np.load(file, allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in stored.files if name != _TEXT}
                return _with_arrays(json.loads(str(stored[_TEXT][()])), arrays)
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    def put(self, key: str, answer: Mapping) -> None:
        """Keep an answer; a file is whole or not there."""
        arrays: dict[str, np.ndarray] = {}
        text = json.dumps(_without_arrays(dict(answer), arrays), allow_nan=True)
        with replacing(self._path(key)) as beside, beside.open("wb") as file:
            np.savez(file, **arrays, **{_TEXT: np.array(text)})

    def count(self, key: str) -> None:
        """Count the seconds that earlier parts of this search waited for an answer, each once."""
        if key not in self._counted:
            self._counted.add(key)
            self.earlier += self._seconds(key)

    def note(self, key: str) -> None:
        """An answer has come: the seconds since the last one, beside those of parts that were lost with it."""
        now = time.perf_counter()
        path, seconds = self._path(key, ".seconds"), self._seconds(key) + now - self._noted
        self._noted = now
        with replacing(path) as beside:
            beside.write_text(repr(seconds), encoding="ascii")

    def _seconds(self, key: str) -> float:
        try:
            return float(self._path(key, ".seconds").read_text(encoding="ascii"))
        except (OSError, ValueError):
            return 0.0

    def forget_others(self) -> None:
        """Keep only what was asked for since this memory was opened."""
        for path in [*self.folder.glob("*.npz"), *self.folder.glob("*.seconds")]:
            if path.stem not in self._asked:
                path.unlink(missing_ok=True)

    def remove(self) -> None:
        """Forget everything: the work is done."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _path(self, key: str, suffix: str = ".npz") -> Path:
        if not key or not set(key) <= set("0123456789abcdef"):
            raise DeclarationError(f"memory: '{key}' is no key. Make one with key_of(...).")
        return self.folder / f"{key}{suffix}"


def recalled(
    memory: Memory | None,
    executor: Executor,
    function: Callable,
    jobs: Sequence,
    on_done: Callable[[int, object], None] | None = None,
    kinds: Iterable[type] = (),
    kept: bool = True,
) -> list:
    """``function(job)`` of every job in order, as `mapped`; what ``memory`` knows is not computed again.

    kinds : the dataclasses that answers are made of. kept : False for answers that are soon found again, of which the
    memory knows but the seconds.
    """
    if memory is None:
        return list(mapped(executor, function, jobs, on_done))
    keys = [key_of(f"{function.__module__}.{function.__qualname__}", job) for job in jobs]
    known = {kind.__name__: kind for kind in kinds}
    found: dict[int, object] = {}
    for index, key in enumerate(keys):
        memory.count(key)
        stored = memory.get(key) if kept else None
        if stored is not None:
            found[index] = unpacked(stored["answer"], known)
            if on_done:
                on_done(index, found[index])
    open_jobs = [index for index in range(len(jobs)) if index not in found]

    def done(position: int, answer) -> None:
        index = open_jobs[position]
        if kept:
            memory.put(keys[index], {"answer": packed(answer)})
        memory.note(keys[index])
        if on_done:
            on_done(index, answer)

    answers = mapped(executor, function, [jobs[index] for index in open_jobs], done)
    found |= dict(zip(open_jobs, answers, strict=True))
    return [found[index] for index in range(len(jobs))]


def packed(value):
    """A value as a `Memory` keeps it: dataclasses and tuples become tables that say so."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: packed(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {_KIND: type(value).__name__, **fields}
    if isinstance(value, tuple):
        return {_TUPLE: [packed(v) for v in value]}
    if isinstance(value, list):
        return [packed(v) for v in value]
    if isinstance(value, Mapping):
        return {name: packed(v) for name, v in value.items()}
    return value


def unpacked(value, kinds: Mapping[str, type]):
    """What `packed` was given; ``kinds``: the dataclasses by name that may be made."""
    if isinstance(value, list):
        return [unpacked(v, kinds) for v in value]
    if not isinstance(value, dict):
        return value
    if set(value) == {_TUPLE}:
        return tuple(unpacked(v, kinds) for v in value[_TUPLE])
    fields = {name: unpacked(v, kinds) for name, v in value.items() if name != _KIND}
    return kinds[value[_KIND]](**fields) if _KIND in value else fields


def key_of(*content) -> str:
    """A hash of everything a job depends on: its data, the model's equations, the versions that compute.

    >>> key_of("refit", {"a": 1.0}) == key_of("refit", {"a": 1.0})
    True
    >>> key_of(np.array([1.0])) == key_of(np.array([1]))
    False
    """
    digest = hashlib.sha256()
    _feed(digest, [content, versions()])
    return digest.hexdigest()[:40]


def _feed(digest, value) -> None:
    """A value into the hash, with its kind and size, so that no two different contents feed the same bytes."""
    if isinstance(value, np.ndarray):
        data = np.ascontiguousarray(value)
        _put(digest, "array", f"{data.dtype.str}{data.shape}".encode())
        _put(digest, "", data.tobytes())
    elif isinstance(value, FlatModel):
        known = {f.name: getattr(value, f.name) for f in dataclasses.fields(value) if f.name not in _WORDLESS}
        starts = portable(value).initialisation.functions
        _put(digest, "flat", b"")
        _feed(digest, [known, {"\0".join(names): function for names, function in starts.items()}])
    elif (content := getattr(value, "content", None)) is not None:  # it says itself what it is
        _put(digest, type(value).__name__, b"")
        _feed(digest, content)
    elif isinstance(value, ca.Function):
        _put(digest, "function", value.serialize().encode())
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        _put(digest, type(value).__name__, b"")
        fields = (f.name for f in dataclasses.fields(value) if f.name != "threads")  # they change no answer
        _feed(digest, {name: getattr(value, name) for name in fields})
    elif isinstance(value, Mapping):
        _put(digest, "mapping", str(len(value)).encode())
        for name in sorted(value, key=str):
            _feed(digest, str(name))
            _feed(digest, value[name])
    elif isinstance(value, list | tuple | set | frozenset):
        members = sorted(value, key=str) if isinstance(value, set | frozenset) else value
        _put(digest, "list", str(len(members)).encode())
        for member in members:
            _feed(digest, member)
    elif isinstance(value, np.generic):
        _feed(digest, value.item())
    elif isinstance(value, float):
        _put(digest, "float", struct.pack("<d", value))
    elif value is None or isinstance(value, str | int | bool | bytes):
        _put(digest, type(value).__name__, value if isinstance(value, bytes) else str(value).encode())
    else:
        raise DeclarationError(f"memory: a job holds a {type(value).__name__}, which has no content to hash.")


def _put(digest, kind: str, data: bytes) -> None:
    digest.update(f"{kind}:{len(data)}:".encode())
    digest.update(data)


def _without_arrays(value, arrays: dict[str, np.ndarray]):
    """A value for JSON; its arrays go into ``arrays``, a reference stays."""
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise DeclarationError("memory: an array of objects cannot be kept. Keep numbers and strings.")
        name = f"a{len(arrays)}"
        arrays[name] = value
        return {_ARRAY: name}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return {str(k): _without_arrays(v, arrays) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_without_arrays(v, arrays) for v in value]
    return value


def _with_arrays(value, arrays: Mapping[str, np.ndarray]):
    if isinstance(value, dict):
        return (
            arrays[value[_ARRAY]] if set(value) == {_ARRAY} else {k: _with_arrays(v, arrays) for k, v in value.items()}
        )
    return [_with_arrays(v, arrays) for v in value] if isinstance(value, list) else value
