"""Where a segment starts: the states that are given, and the rest as the model finds it."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import FlatModel


class StartStates:
    """x0(u0, p, z) of a segment with its derivatives; ``names`` are the states that z gives, the model finds the rest.

    ``held`` are given but not free: they keep their value. ``measured`` : the index of the output that
    measures each, -1 where none does.
    """

    def __init__(self, flat: FlatModel, names: Sequence[str], free_index: np.ndarray, held: bool = False):
        order = [s.name for s in flat.states]
        self.names = tuple(n for n in order if n in names)
        self.columns = np.array([order.index(n) for n in self.names], dtype=int)
        self.nominal = np.array([flat.states[i].nominal for i in self.columns])
        self.bounds = np.array([flat.states[i].bounds for i in self.columns]).reshape(-1, 2)
        outputs = {o.name: k for k, o in enumerate(flat.outputs)}
        self.measured = np.array([outputs.get(flat.states[i].measured_by, -1) for i in self.columns], dtype=int)
        self.held = held
        self.whole = len(self.names) == len(order)
        self.free_index = free_index
        self.size = len(order)
        self._unit = np.zeros((self.size, len(self.free_index))), np.eye(self.size)[:, self.columns]
        if not self.whole:
            self._function = _start_with_jacobians(flat, self.names, free_index)

    def __call__(self, u0: np.ndarray, p: np.ndarray, z: np.ndarray):
        """x0 (nx,), dx0/dp of the free parameters (nx, np), dx0/dz (nx, nz)."""
        if self.whole:
            x0 = np.empty(self.size)
            x0[self.columns] = z
            return x0, *self._unit
        x0, by_p, by_z = (np.array(m) for m in self._function(u0, p, z))
        return x0.ravel(), by_p, by_z.reshape(self.size, -1)


def _start_with_jacobians(flat: FlatModel, names: Sequence[str], free_index: np.ndarray) -> ca.Function:
    u, p, z = ca.SX.sym("u", len(flat.inputs)), ca.SX.sym("p", len(flat.parameters)), ca.SX.sym("z", len(names))
    x0 = flat.start_given(names)(u, p, z)
    by_p = ca.jacobian(x0, p)[:, [int(i) for i in free_index]] if len(free_index) else ca.SX(x0.shape[0], 0)
    return ca.Function("start_states", [u, p, z], [x0, ca.densify(by_p), ca.densify(ca.jacobian(x0, z))])
