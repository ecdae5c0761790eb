"""What became better and worse against an earlier comparison: means over the recordings that both have scored."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from .comparison import Comparison, Score

SAME = 0.02  # of an error: a smaller change against an earlier comparison is none
NAN = float("nan")
Key = tuple[str, str, str]  # model, output, mode


@dataclass(frozen=True)
class Change:
    """The mean RMSE of a model in one output and mode, SI, before and now, over the recordings that both have scored.

    NaN where there are none. lost, won : recordings that were scored then and not now, and now and not then. A model
    that failed where it did not fail before is worse, whatever its mean over the others.
    """

    model: str
    output: str
    mode: str
    before: float
    now: float
    unit: str
    lost: tuple[str, ...] = ()
    won: tuple[str, ...] = ()

    @property
    def better(self) -> bool:
        return not self.worse and (bool(self.won) or self.now < (1 - SAME) * self.before)

    @property
    def worse(self) -> bool:
        return bool(self.lost) or self.now > (1 + SAME) * self.before

    @property
    def scored(self) -> str:
        """On what it has no score any more, or has one now, in words; "" where that is as it was."""
        told = [("no score now on", self.lost), ("no score before on", self.won)]
        return "; ".join(f"{word} {', '.join(names)}" for word, names in told if names)


@dataclass(frozen=True)
class Before:
    """An earlier comparison: means, scores of each recording by its name then, these names by hash, and its models."""

    means: Mapping[Key, Mapping]
    scores: Mapping[Key, Mapping[str, Mapping]]
    names: Mapping[str, str]
    models: frozenset[str] = frozenset()

    def changes(self, comparison: Comparison) -> Iterator[Change]:
        """Of every model, output and mode of both, those first that have a mean now."""
        now: dict[Key, dict[str, Score]] = {}
        then_called = {r.name: self.names.get(r.digest or "", r.name) for r in comparison.records}
        for s in comparison.scores:
            now.setdefault((s.model, s.output, s.mode), {})[then_called[s.record]] = s
        units = {s.name: s.unit for s in comparison.outputs}
        failed = self.models - {model for model, *_ in self.means}  # on all: what they score now is new
        asked = [k for k in self.means if k[0] in comparison.models and k[1] in units and k[2] in comparison.modes]
        asked += [k for k in now if k[0] in failed]
        for key in sorted(asked, key=lambda k: list(now).index(k) if k in now else len(now)):
            yield self._change(key, now.get(key, {}), units[key[1]])

    def _change(self, key: Key, now: Mapping[str, Score], unit: str) -> Change:
        mean, then = self.means.get(key), self.scores.get(key, {})
        if mean is None:
            return Change(*key, NAN, _mean([s.rmse for s in now.values()]), unit, won=tuple(now))
        if not then:  # of means alone
            return self._of_means(key, now, unit)
        both = [name for name in now if name in then]
        lost, won = (tuple(n for n in one if n not in other) for one, other in ((then, now), (now, then)))
        before = _mean([then[n]["rmse"] for n in both]) if lost or won else mean["rmse"]
        return Change(*key, before, _mean([now[n].rmse for n in both]), unit, lost, won)

    def _of_means(self, key: Key, now: Mapping[str, Score], unit: str) -> Change:
        """Where it is not told which recordings went into a mean, only as many can be compared."""
        before, scored = float(self.means[key]["rmse"]), self.means[key].get("recordings", len(now))
        if scored == len(now):
            return Change(*key, before, _mean([s.rmse for s in now.values()]), unit)
        some = (f"{abs(scored - len(now))} of {max(scored, len(now))} recordings",)
        return Change(*key, NAN, NAN, unit, *((some, ()) if scored > len(now) else ((), some)))


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else NAN
