"""The base: led from where its user put it through windows, and fitted to whole recordings."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.identification.frequencies import detuned
from hydrotwin.identification.horizon import horizons
from hydrotwin.identification.problem import free_parameters
from hydrotwin.models.language.errors import SolveError

from ..evidence.deciding import DECIDING
from ..fits.job import Fitted, Look
from ..fits.nearby import lowest_nearby
from .extent import SHORT, telling, with_fewer_windows
from .jobs import Jobs
from .starts import different
from .table import Entry, Table

SAME = 0.02  # of what the base leaves in windows: promises that differ by less are alike
NEAR = 5.0  # times the noise that the base leaves of whole recordings: it is near what it would be, and runs tell most
LEFT = 1.5  # times the size that the longest windows, or a fit, leave: what leaves no more is near to them


@dataclass(eq=False)
class BaseFit:
    """What fits the base of a table; run : jobs to answers, in order."""

    table: Table
    jobs: Jobs
    run: Callable[..., list]

    @property
    def entry(self) -> Entry:
        return self.table.entry()

    def identify(self) -> int:
        """Lead the base through all windows and fit it; how many lengths of windows looks go through.

        Raises SolveError where it diverges.
        """
        first, base = self.lead(), self.entry
        starts = different(self.jobs.whole(base).starts if base.look else ({},))
        size, states = (base.look.size, base.look.states) if base.look else (None, ())
        near = self._fit(starts, size, states, first)
        first = self.looks_through(first)
        if near and not first and not self.table.explained([base]):
            (found,) = self.run([self.jobs.further(base)], lowest_nearby)
            self.table.keep_better(base, found)
        return first

    def looks_through(self, first: int) -> int:
        """How many lengths of windows looks go through, of those that show what is missing; 0: whole recordings.

        A base that leaves little of these is hardly bent: few steps from there tell effects apart. In short windows,
        whose starts are free, little may be what another minimum of the starts leaves.
        """
        if not first or np.nanmax(self.entry.fitted.rmse / self.table.noise) > NEAR:
            return first
        self.further()
        return 0

    def fit_from(self, known: Fitted, first: int) -> None:
        """Fit it to all recordings from where that to their beginnings ended. Raises SolveError where it diverges."""
        self._fit([known.values], known.rmse, known.states, first)

    def lead(self) -> int:
        """Lead the base through all windows; how many lengths of them show what is missing."""
        table, q, base = self.table, self.table.question, self.entry
        start = free_parameters(table.base.flat, table.free)
        lengths = tuple(horizons(table.base.flat, q.fit, start.vector(start.scaled(start.start))))
        table.question = dataclasses.replace(q, lengths=lengths)
        if lengths and not self.jobs.begin:
            self.find_valley(detuned(table.base.flat, q.fit, start, q.usual))
        self._lead(SHORT)
        first, seen = telling(table), base.look
        if with_fewer_windows(table, first):
            base.look = None  # it begins anew with those
        self._lead(len(lengths))
        base.look = base.look or seen
        return first

    def further(self) -> None:
        """Go on with a fit that has not come to its end."""
        if self.entry.fitted and not self.entry.fitted.converged:
            (found,) = self.run([self.jobs.further(self.entry)])
            self.table.keep_better(self.entry, found)

    def find_valley(self, starts: Sequence[Mapping[str, float]]) -> None:
        """Look at the base from the user's start, and where that leaves much from those of other frequencies, too.

        It begins where the shortest windows leave clearly least.
        """
        table, found = self.table, []
        for some in (starts[:1], starts[1:]):
            settings = {"stages": (0, 1), "seconds": self.jobs.effort.look}
            looks = zip(self.run([self.jobs.of(self.entry, [start], **settings) for start in some]), some, strict=True)
            found += [(table.in_windows(look, 0), start) for look, start in looks if isinstance(look, Look)]
            if found and found[0][0] < DECIDING.visible:
                break
        if found:
            enough = (1 + SAME) * min(left for left, _ in found) + 1.0
            self.jobs.begin = next(start for left, start in found if left <= enough)

    def _lead(self, lengths: int) -> None:
        """Lead it through the first ``lengths`` of windows, where it has not gone through them."""
        base, known = self.entry, len(self.table.question.lengths)
        if not self.table.usable(base) or (base.look and base.look.end >= min(lengths, known)):
            return
        (found,) = self.run([self.jobs.next(base, lengths)])
        if isinstance(found, Look):
            base.look = found.after(base.look)
        elif isinstance(found, Fitted):
            base.fitted = found
        else:
            base.failed = found

    def _fit(self, starts: Sequence[Mapping[str, float]], size, states, first: int) -> bool:
        """Fit it from where its windows ended, or where that leaves more than they did from all it came by.

        Where they show nothing missing it has to explain all, or each of these is tried to its end: all of a search may
        be spent on a base that came to rest beside its minimum. It may be so stiff there that a step takes seconds:
        each start has a little time, the best goes on. Whether it leaves no more than what windows did.
        """
        table, base, near = self.table, self.entry, False
        for some in (starts[:1], starts[1:]):
            settings = {"size": size, "states": states, "seconds": self.jobs.effort.look}
            for found in self.run([self.jobs.of(base, [start], **settings) for start in some]):
                table.keep_better(base, found)
            near = base.fitted and size is not None and not np.nanmax(base.fitted.rmse / size) > LEFT
            if near and (first or table.explained([base])):
                break
        base.failed = "" if base.fitted else base.failed
        if not first:  # else it leaves far too much, wherever it would come to rest
            self.further()
        if not base.fitted:
            why = f"gap: the base model cannot be identified ({base.failed}). Correct its start values first."
            raise SolveError(why)
        return bool(near)
