"""Why a run stopped: the status of a driver as an error that names the time, the place and the likely cause."""

from __future__ import annotations

import numpy as np

from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel

from .machine import DONE, NO_MEMORY, OUTPUT, STATE


class Diverged(SolveError):
    """A run that left the finite numbers; ``time`` [s] and ``state`` say where (state: None when no state did)."""

    def __init__(self, message: str, time: float, state: str | None):
        super().__init__(message)
        self.time, self.state = time, state


def raise_stop(flat: FlatModel, status: int, where, time, u, p) -> None:
    """Raise what a driver's status means; nothing where the run went through.

    where : the time [s] and the last states (nx,) before the stop.
    """
    if status == DONE:
        return
    name = flat.name
    if status == NO_MEMORY:
        raise SolveError(f"{name}: out of memory for the run. Shorten the recording.")
    t, x = float(where[0]), where[1:]
    k = max(int(np.searchsorted(time, t, side="right")) - 1, 0)
    if not np.isfinite(x).all():
        state = flat.states[int(np.argmin(np.isfinite(x)))].name
        raise Diverged(
            f"{name}.{state}: it has no start value at t = {t:.6g} s: the initial equations have no solution that "
            "Newton's iteration finds for these inputs and parameters. Correct those, or give the state a start.",
            t,
            state,
        )
    if lost := flat.lost_loop(t, x, u[k], p) or flat.lost_loop(t, x, u[min(k + 1, len(u) - 1)], p):
        raise Diverged(
            f"{name}: the equations for {lost} have no solution at t = {t:.6g} s, or none that Newton's iteration "
            "finds from their start values. Check inputs and parameters there, or give the variables a nearer start.",
            t,
            None,
        )
    if status == OUTPUT:
        bad = ~np.isfinite(flat.ode(t, x, u[k], p)[1].full().ravel())
        blown = flat.outputs[int(np.argmax(bad))].name if bad.any() else "an output"
        raise Diverged(
            f"{name}.{blown}: the output is not finite at t = {t:.6g} s. Check the parameters it depends on.", t, None
        )
    blown = _fastest(flat, t, x, u[k], p)
    what = "left the finite numbers" if status == STATE else "could not be integrated further"
    raise Diverged(
        f"{name}.{flat.states[blown].name}: the run {what} at t = {t:.6g} s "
        f"(got {x[blown]:.3g} {flat.states[blown].unit} last). "
        "Check parameters and start there, or give a smaller step or method='implicit'.",
        t,
        flat.states[blown].name,
    )


def _fastest(flat: FlatModel, t, x, u, p) -> int:
    """The state that moves fastest, in nominal units, from the last finite point."""
    scale = np.array([s.nominal for s in flat.states])
    speed = np.abs(flat.ode(t, x, u, p)[0].full().ravel() / scale)
    return int(np.argmax(np.where(np.isfinite(speed), speed, np.inf)))
