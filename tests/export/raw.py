"""An FMU's shared library called through ctypes: statuses as they are, nothing smoothed over."""

from __future__ import annotations

import ctypes as c
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

OK, WARNING, DISCARD, ERROR = 0, 1, 2, 3

LOGGER = c.CFUNCTYPE(None, c.c_void_p, c.c_char_p, c.c_int, c.c_char_p, c.c_char_p, c.c_char_p)


LOGGER3 = c.CFUNCTYPE(None, c.c_void_p, c.c_int, c.c_char_p, c.c_char_p)
UPDATE3 = c.CFUNCTYPE(
    None, c.c_void_p, c.c_double, c.c_bool, c.c_bool, c.c_bool, c.c_bool, c.POINTER(c.c_bool), c.POINTER(c.c_double)
)


class Callbacks(c.Structure):
    _fields_ = [
        ("logger", LOGGER), ("allocate", c.c_void_p), ("free", c.c_void_p), ("finished", c.c_void_p),
        ("owner", c.c_void_p),
    ]  # fmt: skip


_KINDS = {0: "ModelExchange", 1: "CoSimulation", 2: "ScheduledExecution"}


class EventInfo(c.Structure):
    _fields_ = [(n, c.c_int) for n in ("needed", "terminate", "nominals", "values", "next_defined")] + [
        ("next_time", c.c_double)
    ]


class Library:
    """One FMU unpacked and loaded."""

    def __init__(self, fmu: Path, folder: Path):
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(folder)
        self.root = ET.parse(folder / "modelDescription.xml").getroot()
        self.path = next((folder / "binaries").glob("*/*.*"))
        self.dll = c.CDLL(str(self.path))
        self.fmi = int(self.root.get("fmiVersion")[0])
        creators = ["fmi2Instantiate"] if self.fmi == 2 else [f"fmi3Instantiate{_KINDS[k]}" for k in (0, 1, 2)]
        for name in creators:
            getattr(self.dll, name).restype = c.c_void_p
        self.variables = {v.get("name"): v for v in self.root.find("ModelVariables")}
        self.references = {n: int(v.get("valueReference")) for n, v in self.variables.items()}
        self.messages: list[tuple[int, str]] = []
        self.categories: list[str] = []
        self._logger = LOGGER(lambda owner, name, status, category, form, text: self._hear(status, category, text))
        self._logger3 = LOGGER3(lambda owner, status, category, text: self._hear(status, category, text))

    def _hear(self, status: int, category: bytes, text: bytes):
        self.messages.append((status, text.decode()))
        self.categories.append(category.decode())

    @property
    def guid(self) -> str:
        return self.root.get("guid" if self.fmi == 2 else "instantiationToken")

    def names(self, causality: str) -> list[str]:
        return [n for n, v in self.variables.items() if v.get("causality") == causality]

    def instantiate(
        self, guid: str | None = None, name: bytes = b"one", logger: bool = True, kind: int = 1, update=None,
        early: bool = False, required: tuple[str, ...] = (), logging: bool = False,
    ):  # fmt: skip
        if self.fmi == 3:
            logger3 = self._logger3 if logger else LOGGER3()
            listed = (c.c_uint * len(required))(*(self.references[n] for n in required))
            between = (False, early, listed, c.c_size_t(len(required))) if kind == 1 else ()
            after = {0: (), 1: (update,), 2: (None, None, None)}[kind]
            create = getattr(self.dll, f"fmi3Instantiate{_KINDS[kind]}")
            return create(name, (guid or self.guid).encode(), None, False, logging, *between, None, logger3, *after)
        callbacks = Callbacks(self._logger if logger else LOGGER(), None, None, None, None)
        text = (guid or self.guid).encode()
        return self.dll.fmi2Instantiate(name, c.c_int(kind), text, None, c.byref(callbacks), 0, int(logging))

    def instance(self, **options) -> Instance:
        return (Instance if self.fmi == 2 else Instance3)(self, self.instantiate(**options))

    def knowns(self, tag: str, unknown: str) -> list[str]:
        """Declared dependencies; tag: Output, ContinuousStateDerivative or InitialUnknown."""
        names, structure = list(self.variables), self.root.find("ModelStructure")
        if self.fmi == 3:
            of = {int(e.get("valueReference")): e for e in structure.findall(tag)}
            return [names[int(k)] for k in of[self.references[unknown]].get("dependencies").split()]
        plural = {"Output": "Outputs", "ContinuousStateDerivative": "Derivatives", "InitialUnknown": "InitialUnknowns"}
        of = {int(e.get("index")) - 1: e for e in structure.find(plural[tag])}
        return [names[int(k) - 1] for k in of[names.index(unknown)].get("dependencies").split()]


class Instance:
    """One instance; every method returns the FMI status unless it says otherwise."""

    def __init__(self, library: Library, component: int):
        assert component, library.messages
        self.library, self.dll, self.component = library, library.dll, c.c_void_p(component)

    def __getattr__(self, name: str):
        function = getattr(self.dll, f"fmi2{name}")
        return lambda *args: function(self.component, *args)

    def set(self, name: str, value: float) -> int:
        return self.set_reference(self.library.references[name], value)

    def set_reference(self, reference: int, value: float) -> int:
        return self.SetReal(c.byref(c.c_uint(reference)), c.c_size_t(1), c.byref(c.c_double(value)))

    def status_of_get(self, reference: int) -> int:
        return self.GetReal(c.byref(c.c_uint(reference)), c.c_size_t(1), c.byref(c.c_double()))

    def get(self, *names: str) -> list[float]:
        references = (c.c_uint * len(names))(*(self.library.references[n] for n in names))
        values = (c.c_double * len(names))()
        assert self.GetReal(references, c.c_size_t(len(names)), values) == OK, self.library.messages
        return list(values)

    def setup(self, start: float = 0.0, stop: float | None = None) -> int:
        return self.SetupExperiment(
            0, c.c_double(0.0), c.c_double(start), int(stop is not None), c.c_double(stop or 0.0)
        )

    def initialise(self, start: float = 0.0, stop: float | None = None, **starts: float) -> Instance:
        assert self.setup(start, stop) == OK
        for name, value in starts.items():
            assert self.set(name, value) == OK
        assert self.EnterInitializationMode() == OK
        assert self.ExitInitializationMode() == OK
        return self

    def step(self, time: float, size: float) -> int:
        return self.DoStep(c.c_double(time), c.c_double(size), 1)

    def slope(self, name: str, value: float) -> int:
        reference = c.c_uint(self.library.references[name])
        return self.SetRealInputDerivatives(
            c.byref(reference), c.c_size_t(1), c.byref(c.c_int(1)), c.byref(c.c_double(value))
        )

    def directional(self, unknown: str, known: str) -> float:
        refs = self.library.references
        found = c.c_double()
        status = self.GetDirectionalDerivative(
            c.byref(c.c_uint(refs[unknown])), c.c_size_t(1), c.byref(c.c_uint(refs[known])), c.c_size_t(1),
            c.byref(c.c_double(1.0)), c.byref(found),
        )  # fmt: skip
        assert status == OK, self.library.messages
        return found.value

    def exchange(self, start: float = 0.0, **starts: float) -> Instance:
        """Through initialization and the first event mode into continuous-time mode."""
        self.initialise(start, **starts)
        assert self.update_discrete_states() == OK
        assert self.EnterContinuousTimeMode() == OK
        return self

    def update_discrete_states(self) -> int:
        info = EventInfo()
        status = self.NewDiscreteStates(c.byref(info))
        assert not any((info.needed, info.terminate, info.nominals, info.values, info.next_defined))
        return status

    def free_state(self, state: c.c_void_p) -> int:
        return self.FreeFMUstate(c.byref(state))

    def set_time(self, time: float) -> int:
        return self.SetTime(c.c_double(time))

    def set_states(self, values: list[float]) -> int:
        return self.SetContinuousStates((c.c_double * len(values))(*values), c.c_size_t(len(values)))

    def vector(self, what: str, size: int) -> list[float]:
        """ContinuousStates, Derivatives or NominalsOfContinuousStates."""
        values = (c.c_double * size)()
        assert getattr(self, f"Get{what}")(values, c.c_size_t(size)) == OK, self.library.messages
        return list(values)

    def get_state(self) -> c.c_void_p:
        state = c.c_void_p()
        assert self.GetFMUstate(c.byref(state)) == OK
        return state

    def serialized(self) -> bytes:
        state, size = self.get_state(), c.c_size_t()
        assert self.SerializedFMUstateSize(state, c.byref(size)) == OK
        buffer = c.create_string_buffer(size.value)
        assert self.SerializeFMUstate(state, buffer, size) == OK
        assert self.FreeFMUstate(c.byref(state)) == OK
        return buffer.raw

    def restore(self, data: bytes) -> int:
        state = c.c_void_p()
        status = self.DeSerializeFMUstate(data, c.c_size_t(len(data)), c.byref(state))
        if status == OK:
            status = self.SetFMUstate(state)
            self.FreeFMUstate(c.byref(state))
        return status

    def free(self):
        self.dll.fmi2FreeInstance(self.component)


class Instance3(Instance):
    """The same calls for FMI 3.0; the experiment is set up where initialization begins."""

    _start, _stop = 0.0, None

    def __getattr__(self, name: str):
        function = getattr(self.dll, f"fmi3{name}")
        return lambda *args: function(self.component, *args)

    def set_reference(self, reference: int, value: float) -> int:
        one = c.c_size_t(1)
        return self.SetFloat64(c.byref(c.c_uint(reference)), one, c.byref(c.c_double(value)), one)

    def status_of_get(self, reference: int) -> int:
        one = c.c_size_t(1)
        return self.GetFloat64(c.byref(c.c_uint(reference)), one, c.byref(c.c_double()), one)

    def get(self, *names: str) -> list[float]:
        references = (c.c_uint * len(names))(*(self.library.references[n] for n in names))
        values, count = (c.c_double * len(names))(), c.c_size_t(len(names))
        assert self.GetFloat64(references, count, values, count) == OK, self.library.messages
        return list(values)

    def setup(self, start: float = 0.0, stop: float | None = None) -> int:
        self._start, self._stop = start, stop
        return OK

    def EnterInitializationMode(self) -> int:
        stop = self._stop is not None, c.c_double(self._stop or 0.0)
        enter = self.dll.fmi3EnterInitializationMode
        return enter(self.component, False, c.c_double(0.0), c.c_double(self._start), *stop)

    def step(self, time: float, size: float) -> int:
        status, early, last = self.step_until(time, size)
        assert not early
        assert status != OK or abs(last - time - size) < 1e-9 * (1 + abs(time + size))
        return status

    def step_until(self, time: float, size: float) -> tuple[int, bool, float]:
        """Status, whether it returned early, and the time it reached."""
        event, terminate, early, last = c.c_bool(True), c.c_bool(True), c.c_bool(True), c.c_double()
        status = self.DoStep(
            c.c_double(time), c.c_double(size), True, c.byref(event), c.byref(terminate), c.byref(early), c.byref(last)
        )
        assert not (event.value or terminate.value)
        return status, early.value, last.value

    def update_discrete_states(self) -> int:
        flags, following = [c.c_bool(True) for _ in range(5)], c.c_double()
        status = self.UpdateDiscreteStates(*(c.byref(f) for f in flags), c.byref(following))
        assert not any(f.value for f in flags)
        return status

    def vector(self, what: str, size: int) -> list[float]:
        return super().vector("ContinuousStateDerivatives" if what == "Derivatives" else what, size)

    def directional(self, unknown: str, known: str) -> float:
        return self._derivative("DirectionalDerivative", unknown, known)

    def adjoint(self, unknown: str, known: str) -> float:
        return self._derivative("AdjointDerivative", unknown, known)

    def _derivative(self, which: str, unknown: str, known: str) -> float:
        references, one, found = self.library.references, c.c_size_t(1), c.c_double()
        of, to = (c.byref(c.c_uint(references[n])) for n in (unknown, known))
        status = getattr(self, f"Get{which}")(of, one, to, one, c.byref(c.c_double(1.0)), one, c.byref(found), one)
        assert status == OK, self.library.messages
        return found.value

    def get_state(self) -> c.c_void_p:
        state = c.c_void_p()
        assert self.GetFMUState(c.byref(state)) == OK
        return state

    def free_state(self, state: c.c_void_p) -> int:
        return self.FreeFMUState(c.byref(state))

    def serialized(self) -> bytes:
        state, size = self.get_state(), c.c_size_t()
        assert self.SerializedFMUStateSize(state, c.byref(size)) == OK
        buffer = c.create_string_buffer(size.value)
        assert self.SerializeFMUState(state, buffer, size) == OK
        assert self.free_state(state) == OK
        return buffer.raw

    def restore(self, data: bytes) -> int:
        state = c.c_void_p()
        status = self.DeserializeFMUState(data, c.c_size_t(len(data)), c.byref(state))
        if status == OK:
            status = self.SetFMUState(state)
            self.free_state(state)
        return status

    def free(self):
        self.dll.fmi3FreeInstance(self.component)
