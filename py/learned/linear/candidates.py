"""State spaces of several periods, forms and orders from subspaces, ranked by free run over what is held out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .arx import Chosen
from .orders import NOTHING, SIMPLER, free_run_of
from .regressors import Rows
from .state_space import Form
from .subspace import hankel_factor, observability
from .whole_runs import Fitted, WholeRuns

ORDERS = (1, 2, 3, 4, 6, 8)
DEPTH = 14  # block rows of the Hankel matrices, at most
FEWEST = 5  # samples for each column of the Hankel matrices


@dataclass(frozen=True, eq=False)
class Candidate:
    """A form and order at a period, where its subspace comes from, its mean square on what is held out, over scales.

    spaces : observability by the fold it is without; None: from all that may be fitted.
    """

    period: float
    runs: WholeRuns
    order: int
    source: str
    spaces: Mapping[int | None, np.ndarray]
    error: float = np.inf
    refined: bool = False
    evaluations: int = 0

    def tried(self, iterations: int = 0) -> Candidate:
        """With the error of fits without each held fold in turn."""
        total, count, evaluations = 0.0, 0, 0
        for fold in self.runs.rows.held:
            fitted = self.fit(fold, iterations)
            squares, samples = self.runs.held_out_error(fitted, fold)
            total, count, evaluations = total + squares, count + samples, evaluations + fitted.evaluations
        mean = total / max(count, 1)
        error = float(np.exp(np.mean(np.log(np.maximum(mean, 1e-24))))) if np.isfinite(mean).all() else np.inf
        return replace(self, error=error, evaluations=evaluations)

    def fit(self, fold: int | None, iterations: int) -> Fitted:
        """From the subspace, without a fold; refined where it is to be."""
        begun = self.runs.linear(self.spaces[fold], self.order, fold)
        return self.runs.refined(begun, fold, iterations) if self.refined else begun


def forms_of(chosen: Chosen, period: float) -> list[Form]:
    """Those of the ARX equations, all levels, all rates; with inputs that act at once where the ARX has them."""
    orders = [eq.order for eq in chosen.equations]
    first = min(delay for o in orders for delay, _ in o.windows)
    own = tuple(o.rate for o in orders)
    rates = dict.fromkeys([own, (False,) * len(own), (True,) * len(own)])
    delay = int(max(first - 1, 0) * chosen.period / period + 1e-9)
    late = [Form(r, False, d) for r in rates for d in dict.fromkeys([0, delay])]
    return late + ([Form(r, True, 0) for r in rates] if first == 0 else [])


def candidates(rows: Rows, period: float, form: Form, chosen: Chosen | None, orders=ORDERS) -> Iterator[Candidate]:
    """All orders of a form at a period, from what was measured and from what the ARX equations run to."""
    runs = WholeRuns(rows, form)
    sources = {"measured": [p.y for p in rows.parts]}
    if chosen is not None:
        sources["arx"] = [
            np.vstack([
                p.y[:1],
                np.column_stack([free_run_of(rows, k, j, eq) for j, eq in enumerate(chosen.equations)]),
            ])
            for k, p in enumerate(rows.parts)
        ]  # fmt: skip
    for source, outputs in sources.items():
        spaces = _spaces(runs, outputs)
        for order in orders if spaces is not None else ():
            if order < spaces[rows.never].shape[0] - len(form.rates) and runs.fits(order):
                yield Candidate(period, runs, order, source, spaces)


def _spaces(runs: WholeRuns, outputs: Sequence[np.ndarray]) -> dict[int | None, np.ndarray] | None:
    rows = runs.rows
    nu, ny = runs.inputs[0].shape[1], len(runs.form.rates)
    depth = min(DEPTH, min(len(u) for u in runs.inputs) // rows.count // 4, rows.fitted // (FEWEST * 2 * (nu + ny)))
    if depth < 2:
        return None
    inputs = [u[int(runs.form.direct) :] for u in runs.inputs]
    pieces = list(zip(inputs, runs.increments(outputs), rows.cuts, strict=True))
    factors = [
        hankel_factor([(u[c[k] : c[k + 1]][: len(w[c[k] :])], w[c[k] : c[k + 1]]) for u, w, c in pieces], depth)
        for k in range(rows.count)
    ]
    return {
        fold: observability([f for n, f in enumerate(factors) if n != fold], nu, ny, depth)
        for fold in dict.fromkeys([*rows.held, rows.never])
    }


def ranked(tried: Sequence[Candidate]) -> list[Candidate]:
    """Those that run: the simplest of those within `SIMPLER` of the least error first, then by error."""
    found = sorted((c for c in tried if np.isfinite(c.error)), key=lambda c: c.error)
    near = [c for c in found if c.error <= SIMPLER**2 * found[0].error + NOTHING]
    first = min(near, key=lambda c: (c.order, c.error), default=None)
    return [first, *(c for c in found if c is not first)] if found else []
