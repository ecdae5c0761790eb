"""Engines: what runs the equations of a model, compiled or interpreted, kept for the next model with the same."""

from __future__ import annotations

import os
import threading
import warnings
from collections import OrderedDict
from collections.abc import Callable

from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel

from . import equations
from .compiler import compile_library
from .library import LanesLibrary, Library
from .machine import VirtualMachine
from .source import c_source, lanes_source

# Below -O2 gcc leaves the upper halves of registers dirty, and libm becomes six times slower behind them.
SIDE_BY_SIDE = ("-O2", "-ftree-vectorize", "-fopenmp-simd")

_kept: OrderedDict = OrderedDict()
_kept_lock = threading.Lock()


def engine_of(flat: FlatModel, to: equations.Directions, implicit: bool, interpreted: bool, few_runs: bool):
    """The engine of a model, kept for the next `prepare` of the same equations (parameter values may differ)."""

    def make():
        return VirtualMachine(flat, to, implicit) if interpreted else _compiled(flat, to, implicit, few_runs)

    return _kept_for(flat, (to, implicit, interpreted, few_runs), make)


def lanes_of(flat: FlatModel) -> LanesLibrary | None:
    """What runs many parameter sets of a model side by side, kept as an engine is.

    None where there is no compiler, where it knows no vectors, and where the equations have no vector form.
    """
    return _kept_for(flat, ("lanes",), lambda: _compiled_lanes(flat))


def _kept_for(flat: FlatModel, asked: tuple, make: Callable):
    scales = tuple(s.nominal for s in flat.states)
    key = (id(flat.ode), flat.inputs, scales, tuple(equations.delays(flat)), *asked)
    with _kept_lock:
        if key in _kept:
            _kept.move_to_end(key)
            return _kept[key][0]
    made = make()
    with _kept_lock:
        _kept[key] = made, flat.ode  # the function is kept alive: its id is the key
        while len(_kept) > 24:
            _kept.popitem(last=False)
    return made


def _compiled(flat: FlatModel, to: equations.Directions, implicit: bool, few_runs: bool):
    optimise = ("-O2",) if implicit else ("-O3",)  # the integrator is long: -O3 compiles longer and runs no faster
    optimise = ("-O1", "-ftree-vectorize") if few_runs else optimise
    library = _loaded(flat, Library, c_source(flat, to, implicit), optimise)
    if library is not None:
        return library
    warnings.warn(
        f"{flat.name}: no C compiler found, CasADi's interpreter runs the model, ten times slower. "
        "Install ziglang (pip install ziglang) or set CC.",
        stacklevel=2,
    )
    return VirtualMachine(flat, to, implicit)


def _compiled_lanes(flat: FlatModel) -> LanesLibrary | None:
    source = lanes_source(flat) if os.name != "nt" else None  # gcc does not align vectors on the stack there
    try:
        return source and _loaded(flat, LanesLibrary, source, SIDE_BY_SIDE, for_this_processor=True)
    except SolveError:  # a compiler without vectors: single runs do
        return None


def _loaded(flat: FlatModel, kind: Callable, source: str, optimise: tuple[str, ...], for_this_processor: bool = False):
    """The library of a source, compiled again where the cache holds a damaged one; None without a compiler."""
    name = "".join(c if c.isalnum() else "_" for c in flat.name)
    path = compile_library(source, name, optimise, for_this_processor)
    if path is None:
        return None
    try:
        return kind(path, len(flat.outputs))
    except OSError:
        path.unlink(missing_ok=True)
        return kind(compile_library(source, name, optimise, for_this_processor), len(flat.outputs))
