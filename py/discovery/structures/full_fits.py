"""Fits of structures: from where their user put them, as `identify` begins, and from where looks led them.

While an effect is missing the base bends to hide that, and looks begin there: so a fit begins where nothing is bent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..fits.whole import led
from .alternatives import batches
from .base import SAME
from .jobs import Jobs
from .table import Entry, Table

AT_ONCE = 2  # fits between which it is asked whether one explains all: one that does not takes all of its seconds


@dataclass(eq=False)
class Fits:
    """What fits structures of a table; run : jobs, and by which function, to answers, in order."""

    table: Table
    jobs: Jobs
    run: Callable[..., list]

    def fit(self, entries: Sequence[Entry], keep: Callable | None = None, later: bool = False) -> None:
        """Fit structures until one explains all: from their own starts through windows, and from where looks led them.

        The second of these where the first left more than the look promised, and of what left least, on which all else
        builds. Looks at whole recordings, which begin where the base is near what it would be, and end near a fit, come
        first. keep : what takes the fits of entries; None: where they leave less. later : they may take all of their
        time.
        """
        keep = keep or self._keep
        ways = [self._plain, self._on_later if later else self._on]
        if self._near():
            ways.reverse()
        for way in ways:
            best = min((e for e in self.table.fitted if e.members), key=self.table.score, default=None)
            left = [e for e in entries if e is best or not self._as_promised(e)]
            for some in batches(left, AT_ONCE):
                way(some, keep)
                if self.table.explained():
                    return

    def _near(self) -> bool:
        """Whether looks go through whole recordings."""
        look = self.table.entry().look
        return look is not None and look.left is not None

    def _as_promised(self, entry: Entry) -> bool:
        return bool(entry.fitted) and self.table.share(entry) < SAME + self.table.promise(entry)

    def _plain(self, entries: Sequence[Entry], keep: Callable) -> None:
        if (self.jobs.windows or self.table.question).lengths:
            keep(entries, self.run([self.jobs.plain_soon(e) for e in entries], led))

    def _on(self, entries: Sequence[Entry], keep: Callable, job: Callable | None = None) -> None:
        seen = [e for e in entries if e.look]
        keep(seen, self.run([(job or self.jobs.whole_soon)(e) for e in seen]))

    def _on_later(self, entries: Sequence[Entry], keep: Callable) -> None:
        self._on(entries, keep, self.jobs.whole)

    def _keep(self, entries: Sequence[Entry], fits: Sequence) -> None:
        for entry, found in zip(entries, fits, strict=True):
            self.table.keep_better(entry, found)
