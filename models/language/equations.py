"""Which equations a model has, as a hash: a fit says of its values how sure they are in those, and in no others."""

from __future__ import annotations

import hashlib

import casadi as ca

from .errors import DeclarationError
from .flat import FlatModel


def equations_digest(flat: FlatModel) -> str:
    """SHA-256 of rates, outputs and start as functions of time, states, inputs and parameters, and of their names;
    whatever values these have. "" where a part has no equations, for an FMU is known by its file, and of a copy that
    was made to travel, which has not all of its starts."""
    try:
        start = None if flat.black_box else flat.start_given()
    except DeclarationError:
        start = None
    if start is None:
        return ""
    names = [[s.name for s in some] for some in (flat.inputs, flat.outputs, flat.states, flat.parameters)]
    found = hashlib.sha256(repr(names).encode())
    for function in (flat.ode, start):
        found.update(_written(function))
    return found.hexdigest()


def _written(function: ca.Function) -> bytes:
    return function.serialize().encode()
