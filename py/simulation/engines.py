"""Engines: what runs the equations of a model, compiled or interpreted, kept for the next model with the same."""

from __future__ import annotations

import threading
import warnings
from collections import OrderedDict

from hydrotwin.models.language.flat import FlatModel

from . import equations
from .compiler import compile_library
from .library import Library
from .machine import VirtualMachine
from .source import c_source

_kept: OrderedDict = OrderedDict()
_kept_lock = threading.Lock()


def engine_of(flat: FlatModel, to: equations.Directions, implicit: bool, interpreted: bool, few_runs: bool):
    """The engine of a model, kept for the next `prepare` of the same equations (parameter values may differ)."""
    scales = tuple(s.nominal for s in flat.states)
    key = (id(flat.ode), flat.inputs, scales, tuple(equations.delays(flat)), to, implicit, interpreted, few_runs)
    with _kept_lock:
        if key in _kept:
            _kept.move_to_end(key)
            return _kept[key][0]
    made = VirtualMachine(flat, to, implicit) if interpreted else _compiled(flat, to, implicit, few_runs)
    with _kept_lock:
        _kept[key] = made, flat.ode  # the function is kept alive: its id is the key
        while len(_kept) > 24:
            _kept.popitem(last=False)
    return made


def _compiled(flat: FlatModel, to: equations.Directions, implicit: bool, few_runs: bool):
    name = "".join(c if c.isalnum() else "_" for c in flat.name)
    optimise = ("-O2",) if implicit else ("-O3",)  # the integrator is long: -O3 compiles longer and runs no faster
    optimise = ("-O1", "-ftree-vectorize") if few_runs else optimise
    source = c_source(flat, to, implicit)
    path = compile_library(source, name, optimise)
    if path is not None:
        try:
            return Library(path, len(flat.outputs))
        except OSError:  # a damaged file in the cache
            path.unlink(missing_ok=True)
            return Library(compile_library(source, name, optimise), len(flat.outputs))
    warnings.warn(
        f"{flat.name}: no C compiler found, CasADi's interpreter runs the model, ten times slower. "
        "Install ziglang (pip install ziglang) or set CC.",
        stacklevel=2,
    )
    return VirtualMachine(flat, to, implicit)
