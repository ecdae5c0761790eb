"""The answer of a comparison in a sentence: which model is best on what, and by how much."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hydrotwin.comparison import Comparison, Residual, Score

from .format import difference_to_shown, number_text, times_text, with_unit

LEVEL = 1.02  # two models whose errors differ by less are level


@dataclass(frozen=True)
class Winner:
    """The best model on one output in one mode. ``times`` is the RMSE of ``next`` over its own; nan when alone."""

    mode: str
    output: str
    model: str
    rmse: float
    unit: str
    fit_percent: float
    next: str | None
    times: float


def winners(comparison: Comparison) -> tuple[Winner, ...]:
    """The best model on each output in each mode, by mean RMSE over the recordings."""
    found = []
    for mode in comparison.modes:
        for signal in comparison.outputs:
            ranking = comparison.ranking(signal.name, mode)
            if ranking:
                found.append(_winner(ranking))
    return tuple(found)


def answer(comparison: Comparison, shown: Mapping[str, str]) -> str:
    """One sentence on the first mode; ``shown`` is the unit of each output."""
    first = [w for w in winners(comparison) if w.mode == comparison.modes[0]]
    return _mode_sentence(first, comparison, shown) if first else "No model could be scored: see what failed below."


def facts(comparison: Comparison, shown: Mapping[str, str]) -> tuple[str, ...]:
    """The same sentence for every further mode, and the fastest model."""
    found = winners(comparison)
    sentences = []
    for mode in comparison.modes[1:]:
        of_mode = [w for w in found if w.mode == mode]
        if of_mode:
            sentences.append(_mode_sentence(of_mode, comparison, shown))
    seconds = comparison.seconds_per_simulated_second
    times = {m: s for m, s in seconds.items() if m not in comparison.yardsticks}
    if len(times) > 1:
        fastest = min(times, key=times.__getitem__)
        sentences.append(f"The fastest is {fastest}: {number_text(1.0 / times[fastest], 2)} times real time.")
    return tuple(sentences)


def _winner(ranking: tuple[Score, ...]) -> Winner:
    best = ranking[0]
    rivals = [s for s in ranking[1:] if s.recordings == best.recordings]
    second = rivals[0] if rivals else None
    if second is None:
        times = float("nan")
    else:
        times = second.rmse / best.rmse if best.rmse > 0 else (1.0 if second.rmse == 0 else float("inf"))
    return Winner(
        best.mode,
        best.output,
        best.model,
        best.rmse,
        best.unit,
        best.fit_percent,
        second.model if second else None,
        times,
    )


def _mode_sentence(found: list[Winner], comparison: Comparison, shown: Mapping[str, str]) -> str:
    mode = {"free run": "In free run", "one step": "One step ahead"}[found[0].mode]
    rest = list(found)
    clauses = []
    for model in dict.fromkeys(w.model for w in found):
        of = [w for w in rest if w.model == model]
        if of:
            clauses.append(_clause(model, of, len(of) == len(found) > 1, comparison, shown))
    return f"{mode}, {'; '.join(clauses)}."


def _clause(model: str, of: list[Winner], everywhere: bool, comparison: Comparison, shown: Mapping[str, str]) -> str:
    lead = of[0]
    unit = shown[lead.output]
    rmse = number_text(float(difference_to_shown(lead.rmse, lead.unit, unit)))
    size = f"{lead.output} RMSE {with_unit(rmse, unit)}"
    if everywhere:
        start = f"{model} is best on all {len(of)} outputs: {size}"
    elif len(of) == 1:
        start = f"{model} is best on {size}"
    else:
        others = ", ".join(w.output for w in of[1:])
        start = f"{model} is best on {size} and on {others}"
    return start + _margin(lead, len(comparison.models), unit)


def _margin(lead: Winner, models: int, unit: str) -> str:
    if lead.next is None:
        return "" if models == 1 else ", where no other model could be scored on as many recordings"
    if lead.times < LEVEL:
        return f", level with {lead.next}"
    if lead.times == float("inf"):
        return f", exactly; the next is {lead.next}"
    rival = number_text(float(difference_to_shown(lead.rmse * lead.times, lead.unit, unit)))
    return f", {times_text(lead.times)} times smaller than that of {lead.next} ({with_unit(rival, unit)})"


def verdicts(comparison: Comparison) -> tuple[str, ...]:
    """For each model what it explains down to the noise, and what not: how large, and what the error follows."""
    sentences = []
    for model in comparison.models:
        rows = [r for r in comparison.residuals if r.model == model]
        if not rows or model in comparison.yardsticks:
            continue
        worst = [max((r for r in rows if r.output == o), key=_size) for o in dict.fromkeys(r.output for r in rows)]
        left = sorted((r for r in worst if not r.only_noise), key=_size, reverse=True)
        done = [r.output for r in worst if r.only_noise]
        parts = [f"explains {', '.join(done)} down to the noise"] if done else []
        parts += [f"leaves {', '.join(map(_left, left))}"] if left else []
        sentences.append(f"{model} {', and '.join(parts)}.")
    return tuple(sentences)


def _size(residual: Residual) -> float:
    return residual.times_noise if residual.times_noise == residual.times_noise else 0.0


def _left(residual: Residual) -> str:
    size = f"error {number_text(residual.times_noise, 2)} times the noise" if _size(residual) else "an error"
    if not residual.follows:
        return f"{residual.output} ({size})"
    return f"{residual.output} ({size}, follows {residual.follows} with correlation {residual.strength:.2f})"
