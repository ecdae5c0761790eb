"""One law on its own: a model whose inputs are the law's arguments and whose output is its answer."""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydrotwin.models.language import Component, FlatModel, Input, Law, Model, Output, Slot
from hydrotwin.models.laws import BulkModulusLaw, FrictionLaw, LeakageLaw, MeteringEdgeLaw, OrificeLaw, PumpLossLaw

# kind of law -> its function, the arguments with unit and a typical magnitude, the unit of the answer
FORMS = {
    FrictionLaw: ("force", {"v": ("m/s", 0.05)}, "N"),
    BulkModulusLaw: ("effective", {"p": ("Pa", 1e7)}, "Pa"),
    LeakageLaw: ("flow", {"dp": ("Pa", 1e7)}, "m3/s"),
    OrificeLaw: ("flow", {"opening": ("1", 1.0), "dp": ("Pa", 1e7)}, "m3/s"),
    MeteringEdgeLaw: ("opening", {"x": ("1", 1.0)}, "1"),
    PumpLossLaw: ("delivered", {"ideal": ("m3/s", 1e-4), "dp": ("Pa", 1e7)}, "m3/s"),
}


def form_of(law: Law | type[Law]):
    kind = law if isinstance(law, type) else type(law)
    base = next((base for base in FORMS if issubclass(kind, base)), None)
    assert base, f"{kind.__name__} belongs to no family of laws in FORMS: add its form, so that it is tested."
    return base


def probe(law: Law, answer_unit: str | None = None) -> FlatModel:
    """The law as a model without states; flattening checks its units."""
    base = form_of(law)
    function, arguments, unit = FORMS[base]

    def equations(self):
        yield self.answer == getattr(self.law, function)(*(getattr(self, name) for name in arguments))

    content = {name: Input(u, name, nominal=size) for name, (u, size) in arguments.items()}
    content |= {"law": Slot(base, default=law), "answer": Output(answer_unit or unit, "the law's answer")}
    return Model(type("Probe", (Component,), {**content, "equations": equations})(), "probe").flat


def values(law: Law, *arguments) -> np.ndarray:
    """The law's answer at arrays of its arguments."""
    flat = probe(law)
    return _evaluated(flat.ode, flat.parameter_vector(), arguments)


def slopes(law: Law, *arguments, along: int = 0) -> np.ndarray:
    """The derivative of the law's answer with respect to the argument number ``along``."""
    flat = probe(law)
    t, x, u, p = flat.ode.sx_in()
    slope = ca.jacobian(flat.ode(t, x, u, p)[1], u)[along]
    return _evaluated(ca.Function("slope", [t, x, u, p], [x, slope]), flat.parameter_vector(), arguments)


def _evaluated(function, p, arguments) -> np.ndarray:
    table = np.stack(np.broadcast_arrays(*map(np.asarray, arguments)), axis=-1).astype(float)
    rows = table.reshape(-1, table.shape[-1])
    return np.array([float(function(0, [], row, p)[1]) for row in rows]).reshape(table.shape[:-1])
