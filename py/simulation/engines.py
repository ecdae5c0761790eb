"""Engines: what runs the equations of a model, compiled or interpreted, kept for the next model with the same."""

from __future__ import annotations

import ctypes
import os
import warnings
from collections import OrderedDict
from collections.abc import Callable

from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel

from . import equations
from .compiler import compile_library
from .library import LanesLibrary, Library
from .machine import VirtualMachine
from .source import driver_source, functions_of, lanes_source, model_source
from .tables import Tables

# Straight lines of arithmetic: at -O3 the compiler takes twice as long for runs that are a few percent faster.
MODEL = ("-O1",)
ALIGNED = os.name != "nt"  # gcc does not align long vectors on the stack of Windows
# The driver, which is compiled once, may use whatever this processor has: sensitivities gain a tenth.
# Below -O2 gcc leaves the upper halves of registers dirty, and libm becomes six times slower behind them.
DRIVER = ("-O2", "-ftree-vectorize", "-fopenmp-simd")

_kept: OrderedDict = OrderedDict()


def engine_of(flat: FlatModel, to: equations.Directions, implicit: bool, interpreted: bool):
    """The engine of a model, kept for the next `prepare` of the same equations (parameter values may differ)."""

    def make():
        return VirtualMachine(flat, to, implicit) if interpreted else _compiled(flat, to, implicit)

    return _kept_for(flat, (to, implicit, interpreted), make)


def lanes_of(flat: FlatModel) -> LanesLibrary | None:
    """What runs many parameter sets of a model side by side, kept as an engine is.

    None where there is no compiler, where it knows no vectors, and where the equations have no vector form.
    """
    return _kept_for(flat, ("lanes",), lambda: _compiled_lanes(flat))


@equations.alone
def _kept_for(flat: FlatModel, asked: tuple, make: Callable):
    scales = tuple(s.nominal for s in (*flat.states, *flat.parameters))
    key = (id(flat.ode), flat.inputs, scales, tuple(equations.delays(flat)), *asked)
    if key not in _kept:
        _kept[key] = make(), flat.ode  # the function is kept alive: its id is the key
    _kept.move_to_end(key)
    while len(_kept) > 24:
        _kept.popitem(last=False)
    return _kept[key][0]


def _compiled(flat: FlatModel, to: equations.Directions, implicit: bool):
    functions = functions_of(flat, to, implicit)
    model = _library(model_source(functions), _c_name(flat), MODEL)
    if model is None:
        warnings.warn(
            f"{flat.name}: no C compiler found, CasADi's interpreter runs the model, ten times slower. "
            "Install ziglang (pip install ziglang) or set CC.",
            stacklevel=2,
        )
        return VirtualMachine(flat, to, implicit)
    tables = Tables(flat, to, implicit, functions, model)
    return Library(_driver(), tables, len(flat.outputs))


def _compiled_lanes(flat: FlatModel) -> LanesLibrary | None:
    to = equations.directions(flat, (), ())
    functions = functions_of(flat, to, implicit=False)
    source = lanes_source(flat, functions) if ALIGNED else None
    try:
        model = source and _library(source, _c_name(flat), DRIVER, for_this_processor=True)
        driver = model and _driver(side_by_side=True)
    except SolveError:  # a compiler without vectors: single runs do
        return None
    if not model:
        return None
    side_by_side = ctypes.addressof(ctypes.c_char.in_dll(model, "hydrotwin_lanes"))
    return LanesLibrary(driver, Tables(flat, to, False, functions, model), len(flat.outputs), side_by_side)


def _driver(side_by_side: bool = False) -> ctypes.CDLL:
    return _library(driver_source(side_by_side), "driver", DRIVER, for_this_processor=ALIGNED)


def _c_name(flat: FlatModel) -> str:
    return "".join(c if c.isalnum() else "_" for c in flat.name)


def _library(source: str, name: str, optimise: tuple[str, ...], for_this_processor: bool = False) -> ctypes.CDLL | None:
    """Compiled again where the cache holds a damaged one; None without a compiler."""
    path = compile_library(source, name, optimise, for_this_processor)
    if path is None:
        return None
    try:
        return ctypes.CDLL(str(path))
    except OSError:
        path.unlink(missing_ok=True)
        return ctypes.CDLL(str(compile_library(source, name, optimise, for_this_processor)))
