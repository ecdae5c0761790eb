"""An FMU's shared library called through ctypes: statuses as they are, nothing smoothed over."""

from __future__ import annotations

import ctypes as c
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

OK, WARNING, DISCARD, ERROR = 0, 1, 2, 3

LOGGER = c.CFUNCTYPE(None, c.c_void_p, c.c_char_p, c.c_int, c.c_char_p, c.c_char_p, c.c_char_p)


class Callbacks(c.Structure):
    _fields_ = [
        ("logger", LOGGER), ("allocate", c.c_void_p), ("free", c.c_void_p), ("finished", c.c_void_p),
        ("owner", c.c_void_p),
    ]  # fmt: skip


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
        self.dll.fmi2Instantiate.restype = c.c_void_p
        self.variables = {v.get("name"): v for v in self.root.find("ModelVariables")}
        self.references = {n: int(v.get("valueReference")) for n, v in self.variables.items()}
        self.messages: list[tuple[int, str]] = []
        self._logger = LOGGER(
            lambda owner, name, status, category, form, text: self.messages.append((status, text.decode()))
        )

    @property
    def guid(self) -> str:
        return self.root.get("guid")

    def names(self, causality: str) -> list[str]:
        return [n for n, v in self.variables.items() if v.get("causality") == causality]

    def instantiate(self, guid: str | None = None, name: bytes = b"one", logger: bool = True, kind: int = 1):
        callbacks = Callbacks(self._logger if logger else LOGGER(), None, None, None, None)
        text = (guid or self.guid).encode()
        return self.dll.fmi2Instantiate(name, c.c_int(kind), text, None, c.byref(callbacks), 0, 0)

    def instance(self, **options) -> Instance:
        return Instance(self, self.instantiate(**options))


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
        info = EventInfo()
        assert self.NewDiscreteStates(c.byref(info)) == OK
        assert not any((info.needed, info.terminate, info.nominals, info.values, info.next_defined))
        assert self.EnterContinuousTimeMode() == OK
        return self

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
