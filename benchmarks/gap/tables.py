"""Rows as the table of targets, and every case that went wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.effects import CATALOGUE

from . import calibration
from .score import VISIBLE

AS_WELL = 1.01  # times the RMSE of a search among the hidden effects alone, of every output: as well as that
LEAST = 0.01  # probability, in the log loss, of what is so improbable that it is not told


@dataclass(frozen=True)
class Figure:
    """One line of the table: what, the target in words, the figure reached, over how many cases, whether it is met."""

    what: str
    target: str
    value: float
    cases: int
    met: bool | None

    def line(self) -> str:
        shown = f"{self.value:.1%}" if "%" in self.target else f"{self.value:.3g}"
        shown = shown if np.isfinite(self.value) else "-"
        verdict = {True: "met", False: "**missed**", None: ""}[self.met if self.cases else None]
        return f"| {self.what} | {self.target} | {shown} | {self.cases} | {verdict} |"


def figures(rows: Sequence[Mapping]) -> list[Figure]:
    """The targets of the benchmark and further figures, from finished rows of one method."""
    done = [r for r in rows if "verdict" in r]
    seen = [r for r in done if r["kind"] == "single" and r["seen"]]
    swallowed = [r for r in done if r["kind"] == "single" and not r["seen"]]
    controls, outside = ([r for r in done if r["kind"] == kind] for kind in ("none", "out_of_library"))
    outside = [r for r in outside if r["seen"]]
    pairs = [r for r in done if r["kind"] == "pairs" and r["seen"]]
    found = [r for r in seen if all(r["in_class"])]
    parameters = [p for r in done for p in r["parameters"] if p["true"] is not None]  # what a case does not set
    return [
        _share("single, gap seen: exact or right class", ">= 95 %", seen, _named_or_class, 0.95),
        _share("the same where the true structure, refitted, closes half", "(%)", _closable(seen), _named_or_class),
        _share("single, named something: truth inside the stated class", ">= 99 %", _named(seen), _inside, 0.99),
        _share("single, gap seen: top-1", "(%)", seen, lambda r: r["exact"][0]),
        _share("single, gap seen: the simpler effect that it refines, alone", "(%)", seen, _simpler),
        _share("single, gap seen: further effects invented", "(%)", seen, lambda r: r["extra"] > 0),
        _share("single, gap seen: abstained", "(%)", seen, _abstained),
        _share("single, right effect at another place", "(%)", seen, lambda r: r["wrong_place"]),
        _share("single, swallowed by the base: none or right class", "(%)", swallowed, _abstained_or_inside),
        _share("false alarm on `none`", "<= 1 %", controls, lambda r: r["false_alarm"], 0.01, most=True),
        _share("out-of-library, gap seen: abstains", ">= 90 %", outside, _abstained, 0.9),
        _share("out-of-library, gap seen: named, and a gap is left that can be seen", "(%)", outside, _named_amiss),
        _share("confidently wrong", "<= 2 %", done, lambda r: r["confidently_wrong"], 0.02, most=True),
        _quantile("gap closed when named, median", ">= 0.99", _column(found, "gap_closed"), 0.5, 0.99),
        _quantile("held-out RMSE / oracle, 90th %", "<= 1.05", _column(seen, "over_oracle"), 0.9, 1.05, most=True),
        _share("pairs, each of the two seen: both named", ">= 80 %", _each_seen(pairs), _inside, 0.8),
        _share("pairs, one swallowed: the other named, and no more", "(%)", _one_swallowed(pairs), _seen_one_alone),
        _share("all pairs: both named", "(%)", pairs, _inside),
        _quantile("parameter error, median", "<= 5 %", _column(parameters, "error"), 0.5, 0.05, most=True),
        _coverage(parameters),
        _mean("Brier score of named effects", _column(done, "brier")),
        _mean("log loss of what is hidden, nats", [-np.log(max(r["of_truth"], LEAST)) for r in _stating(done)]),
        _share("ended by its limit", "(%)", _stating(done), lambda r: bool(r["notes"].get("untried"))),
        _quantile("seconds, median", "", _column(done, "seconds"), 0.5),
        _quantile("seconds, 90th percentile", "", _column(done, "seconds"), 0.9),
    ]  # fmt: skip


def _inside(r) -> bool:
    return all(r["in_class"])


def _simpler(r) -> bool:
    """Coulomb friction where its dependence on the position was hidden: short of the truth, and not beside it."""
    return len(r["named"]) == 1 and r["named"][0][0] in CATALOGUE[r["hidden"][0][0]].refines


def _abstained_or_inside(r) -> bool:
    return _abstained(r) or _inside(r)


def _named_or_class(r) -> bool:
    return r["verdict"] in ("named", "class", "unknown") and _inside(r)


def _closable(rows):
    """Those whose gap the oracle closes by half at least. A chaotic stick-slip it cannot follow, or it is stuck."""
    return [r for r in rows if r["oracle"] is None or r["oracle"] ** 2 - 1 < 0.5 * (r["before"] ** 2 - 1)]


def _shown(r) -> list[bool]:
    """Of every effect of a pair, whether the true structure refitted without it leaves a gap that can be seen."""
    return [k**2 - r["oracle"] ** 2 >= VISIBLE**2 for k in r.get("lacking") or ()]


def _each_seen(rows):
    """Pairs without those of which the rest of the truth and the base do the work of one: no method finds that."""
    return [r for r in rows if all(_shown(r))]


def _one_swallowed(rows):
    return [r for r in rows if not all(_shown(r))]


def _seen_one_alone(r) -> bool:
    """Whether what leaves a trace is named, if any does, and nothing that was not hidden."""
    return not r["extra"] and all(told for told, seen in zip(r["in_class"], _shown(r), strict=True) if seen)


def _named(rows):
    return [r for r in rows if r["named"]]


def _abstained(r) -> bool:
    return r["abstained"]


def _named_amiss(r) -> bool:
    """A name that does not even predict; one that leaves nothing may be wrong, but no recording says so."""
    return bool(r["named"]) and (r["after"] is None or r["after"] ** 2 - 1 >= VISIBLE**2)


def _stating(rows):
    """Those of methods that state probabilities of all they weighed."""
    return [r for r in rows if r.get("of_truth") is not None]


def _column(rows: Iterable[Mapping], key: str) -> list[float]:
    return [r[key] for r in rows if r[key] is not None]


def _share(what, target, rows, right: Callable, wanted: float | None = None, *, most: bool = False) -> Figure:
    value = float(np.mean([bool(right(r)) for r in rows])) if rows else np.nan
    return Figure(what, target, value, len(rows), _met(value, wanted, most))


def _quantile(what, target, values, q, wanted: float | None = None, *, most: bool = False) -> Figure:
    value = float(np.quantile(values, q)) if values else np.nan
    return Figure(what, target, value, len(values), _met(value, wanted, most))


def _mean(what, values) -> Figure:
    return Figure(what, "", float(np.mean(values)) if values else np.nan, len(values), None)


def _coverage(parameters) -> Figure:
    value = float(np.mean([p["covered"] for p in parameters])) if parameters else np.nan
    return Figure("interval coverage", "90-97 %", value, len(parameters), 0.9 <= value <= 0.97 if parameters else None)


def _met(value, wanted, most) -> bool | None:
    if wanted is None or not np.isfinite(value):
        return None
    return value <= wanted if most else value >= wanted


def misses(rows: Sequence[Mapping]) -> list[str]:
    """A sentence for every case that counts against a target."""
    found = []
    for r in rows:
        if "failed" in r:
            found.append(f"{r['case']}: failed ({r['failed']})")
        elif "verdict" in r and (why := _why(r)):
            said = (
                " + ".join(f"{e} at {s} ({p if p is None else round(p, 2)})" for e, s, p, _ in r["named"]) or "nothing"
            )
            found.append(f"{r['case']} [visible {r['visible']:.2f}]: {why}; {r['verdict']}: {said}")
    return found


def _why(r) -> str:
    reasons = []
    if r["kind"] in ("single", "pairs") and r["seen"] and not _inside(r):
        reasons.append("right effect, wrong place" if r["wrong_place"] else "abstained" if _abstained(r) else "wrong")
    if r["kind"] in ("single", "pairs") and _inside(r) and r["extra"]:
        reasons.append("one effect too many")
    if r["kind"] == "single" and not r["seen"] and not (_abstained(r) or _inside(r)):
        reasons.append("named what is not there")
    if r["false_alarm"]:
        reasons.append("false alarm")
    if r["kind"] == "out_of_library" and r["seen"] and not _abstained(r):
        reasons.append("named what no catalogue has")
    if r["confidently_wrong"]:
        reasons.append("confidently wrong")
    return ", ".join(reasons)


def markdown(rows: Sequence[Mapping]) -> str:
    """Tables per method: targets, the same per machine, top figures by severity and sensors; then the misses."""
    parts = ["# The hidden-effect benchmark", ""]
    for method in dict.fromkeys(r["method"] for r in rows if r.get("method")):
        own = [r for r in rows if r.get("method") == method]
        parts += [f"## {method}", "", *_table(own), ""]
        for machine in dict.fromkeys(r["machine"] for r in own if "verdict" in r):
            parts += [f"### {method}, {machine}", "", *_table([r for r in own if r.get("machine") == machine]), ""]
        parts += [*_by(own, "severity"), *_by(own, "sensors"), *_by(own, "excitation"), *_by_effect(own)]
        parts += calibration.markdown(own, method)
        wrong = misses(own)
        parts += [f"### {method}: {len(wrong)} misses", "", *(f"- {line}" for line in wrong), ""]
    parts += _wide_against_narrow(rows)
    beyond = [r for r in rows if "unreachable" in r]
    parts += [f"## Left out: {len(beyond)} cells that cannot reach their severity", ""]
    return "\n".join([*parts, *(f"- {r['case']}: {r['unreachable']}" for r in beyond), ""])


def _wide_against_narrow(rows) -> list[str]:
    """What the whole catalogue leaves of the recordings to learn from, over what the hidden effects alone do."""
    both = {m: {r["case"]: r for r in rows if r.get("method") == m and "verdict" in r} for m in ("discover", "narrow")}
    lines = []
    for case in (c for c in both["narrow"] if c in both["discover"]):
        wide, narrow = (both[m][case] for m in ("discover", "narrow"))
        least = narrow["notes"]["rmse_fit"]
        worst = max(wide["notes"]["rmse_fit"][name] / value for name, value in least.items())
        lines.append((worst, f"| {case} | {worst:.3f} | {wide['verdict']} | {narrow['verdict']} |"))
    if not lines:
        return []
    as_well = sum(worst <= AS_WELL for worst, _ in lines)
    head = f"## Whole catalogue against the hidden effects alone: as well in {as_well} of {len(lines)}"
    columns = ["| case | RMSE of the fit, whole / alone, worst output | whole | alone |", "|---|---|---|---|"]
    return [head, "", *columns, *(line for _, line in sorted(lines, reverse=True)), ""]


def _table(rows) -> list[str]:
    return ["| | target | reached | cases | |", "|---|---|---|---|---|", *(f.line() for f in figures(rows))]


def _by(rows, key) -> list[str]:
    seen = [r for r in rows if "verdict" in r and r["kind"] == "single" and r["seen"]]
    lines = [f"| single, gap seen, by {key} | exact or class | top-1 | abstained | cases |", "|---|---|---|---|---|"]
    for value in sorted({r[key] for r in seen}):
        lines.append(_line(str(value), [r for r in seen if r[key] == value]))
    return [*lines, ""]


def _by_effect(rows) -> list[str]:
    seen = [r for r in rows if "verdict" in r and r["kind"] == "single" and r["seen"]]
    lines = ["| hidden effect | exact or class | top-1 | abstained | cases |", "|---|---|---|---|---|"]
    for name in sorted({r["hidden"][0][0] for r in seen}):
        lines.append(_line(name, [r for r in seen if r["hidden"][0][0] == name]))
    return [*lines, ""]


def _line(name, rows) -> str:
    shares = [np.mean([f(r) for r in rows]) for f in (_named_or_class, lambda r: r["exact"][0], _abstained)]
    return f"| {name} | {' | '.join(f'{s:.0%}' for s in shares)} | {len(rows)} |"
