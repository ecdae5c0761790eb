"""The answer of a comparison in a sentence: which model is best on what, and by how much."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hydrotwin.comparison import FREE_RUN, ONE_STEP, Comparison, Score
from hydrotwin.export.fmu_settings import AT_REST, REDEFINED
from hydrotwin.export.reader import LATE

from .copies import copies
from .format import difference_to_shown, margin_text, number_text, with_unit

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
    found, told = [], _told(comparison)
    for mode in comparison.modes:
        for signal in comparison.outputs:
            ranking = _among(comparison.ranking(signal.name, mode), told)
            if ranking:
                found.append(_winner(ranking))
    return tuple(found)


def answer(comparison: Comparison, shown: Mapping[str, str]) -> str:
    """One sentence on the first mode; ``shown`` is the unit of each output."""
    sentence = _mode_sentence(comparison, comparison.modes[0], shown)
    return sentence or "No model could be scored: see what failed below."


def facts(comparison: Comparison, shown: Mapping[str, str]) -> tuple[str, ...]:
    """The same sentence for every further mode, who was told more than the others, what is shown late, the fastest."""
    sentences = [_mode_sentence(comparison, mode, shown) for mode in comparison.modes[1:]]
    sentences += [c.sentence for c in copies(comparison)]
    sentences.append(_told_more(comparison))
    sentences += [
        f"Of {e.name}, {e.provenance[LATE]} is shown {LATE}: read its errors there with care."
        for e in comparison.entrants
        if LATE in e.provenance
    ]
    told = [(e.name, e.provenance.get(key)) for key in (REDEFINED, AT_REST) for e in comparison.entrants]
    sentences += [f"Of {name}, {what}." for name, what in told if what]
    seconds = comparison.seconds_per_simulated_second
    times = {m: s for m, s in seconds.items() if m not in comparison.yardsticks}
    if len(times) > 1:
        fastest = min(times, key=times.__getitem__)
        sentences.append(f"The fastest is {fastest}: {number_text(1.0 / times[fastest], 2)} times real time.")
    return tuple(s for s in sentences if s)


def _told_more(comparison: Comparison) -> str:
    """Which models get inputs that others do without; empty when all get the same."""
    inputs = {e.name: {s.name: s for s in e.inputs} for e in comparison.entrants if e.name not in comparison.yardsticks}
    shared = set.intersection(*map(set, inputs.values())) if inputs else set()
    extra = {name: [n for n in own if n not in shared] for name, own in inputs.items()}
    told = [f"{name} is given {' and '.join(names)} as well" for name, names in extra.items() if names]
    return f"Not all models see the same inputs: {', '.join(told)}." if told else ""


def _winner(ranking: tuple[Score, ...]) -> Winner:
    best, *rivals = [s for s in ranking if s.recordings == ranking[0].recordings]
    second = rivals[0] if rivals else None
    times = _times(best, second) if second else float("nan")
    return Winner(
        mode=best.mode,
        output=best.output,
        model=best.model,
        rmse=best.rmse,
        unit=best.unit,
        fit_percent=best.fit_percent,
        next=second.model if second else None,
        times=times,
    )


def _times(best: Score, other: Score) -> float:
    """RMSE of ``other`` over that of ``best``."""
    if best.rmse > 0.0:
        return other.rmse / best.rmse
    return 1.0 if other.rmse == 0.0 else float("inf")


def _mode_sentence(comparison: Comparison, mode: str, shown: Mapping[str, str]) -> str:
    """Few clauses that cover all outputs: again and again the model that is best, or level, on most of the rest.

    The clause with the first output comes first: the outputs stand in the order in which they matter.
    """
    told = _told(comparison)
    rankings = {s.name: _among(comparison.ranking(s.name, mode), told) for s in comparison.outputs}
    rest = {output: _level(r) for output, r in rankings.items() if r}
    clauses = []
    while rest:
        model = max(comparison.models, key=lambda m: sum(m in level for level in rest.values()))
        covered = [output for output, level in rest.items() if model in level]
        text = _clause(model, covered, rankings, shown[covered[0]], comparison.yardsticks)
        clauses.append((list(rankings).index(covered[0]), text))
        rest = {output: level for output, level in rest.items() if output not in covered}
    start = {FREE_RUN: "In free run", ONE_STEP: "One step ahead"}[mode]
    return f"{start}, {'; '.join(text for _, text in sorted(clauses))}." if clauses else ""


def _told(comparison: Comparison) -> set[str]:
    """Models that the sentences speak of; an exported copy is no rival of its model."""
    return set(comparison.models) - {c.fmu for c in copies(comparison)}


def _among(ranking: tuple[Score, ...], models: set[str]) -> tuple[Score, ...]:
    return tuple(s for s in ranking if s.model in models)


def _level(ranking: tuple[Score, ...]) -> set[str]:
    """The best model and those level with it."""
    best = ranking[0]
    return {s.model for s in ranking if s.recordings == best.recordings and _times(best, s) < LEVEL}


def _clause(
    model: str, covered: list[str], rankings: Mapping[str, tuple[Score, ...]], unit: str, yardsticks: frozenset[str]
) -> str:
    """One model: on how many outputs it is best or level, the error on the first, who is level and who comes next."""
    ranking, total = rankings[covered[0]], sum(bool(r) for r in rankings.values())
    own = next(s for s in ranking if s.model == model)
    rivals = [s for s in ranking if s.model != model and s.recordings == own.recordings]
    level = [s.model for s in rivals if s.model in _level(ranking)]
    idle = yardsticks if own.mode == FREE_RUN else frozenset()
    behind = [s for s in rivals if s.model not in _level(ranking) and s.model not in idle]
    what = f"{own.output}:"
    if len(covered) == total > 1:
        what = f"all {total} outputs: {own.output}"
    elif len(covered) > 1:
        what = f"{len(covered)} of {total} outputs: {own.output}"
    leads = all(rankings[output][0].model == model for output in covered)
    text = f"{model} is best{'' if leads else ' or level with the best'} on {what} RMSE {_rmse_text(own, unit)}"
    if level:
        text += f", level with {' and '.join(level)}"
    if behind and own.rmse > 0.0:
        rival = behind[0]
        text += f", {margin_text(_times(own, rival))} smaller than that of {rival.model} ({_rmse_text(rival, unit)})"
    return text


def _rmse_text(score: Score, unit: str) -> str:
    return with_unit(number_text(float(difference_to_shown(score.rmse, score.unit, unit))), unit)
