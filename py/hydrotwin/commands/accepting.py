"""Acceptance criteria of a block that was learnt: its free run, or its steady points, on what took no part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from .shared import mark, out

CARD = {"rmse": "rmse", "mae": "mae", "max": "maximum", "bias": "bias"}  # metric -> field of the card, SI
STEADY = (*CARD, "nrmse", "fit")  # of an inverse: it has no band
JUDGED = (*STEADY, "coverage")
DOUBTED = "read what the card says against the block"  # of a criterion that holds all the same
HELD_OUT, VALIDATED = "on what was held out", "on the recordings to validate with"  # where a criterion has to hold
NOT_VALIDATED = "judged on what was held out alone, for of the recordings to validate with only RMS errors are known."


def criteria(
    texts: Sequence[str] | None, records: Sequence[Record], outputs: Sequence[Signal | str], model, kind: str
) -> list:
    """The criteria of ``learn`` understood before a long training. Raises as `understood`."""
    from hydrotwin.learned.report_card import yardsticks_of

    names = [getattr(s, "name", s) for s in outputs]
    if model is not None and not names:
        names = [s.name for s in getattr(model, "flat", model).outputs if all(s.name in r for r in records)]
    known = Judge(f"learn {kind}", yardsticks_of(kind, model is not None))
    return understood(texts, [Signal(n, records[0].units[n]) for n in names], known)


@dataclass(frozen=True)
class Judge:
    """The command that judges, its yardsticks by name, and the metrics that it knows."""

    verb: str
    yardsticks: Sequence[str]
    metrics: Sequence[str] = JUDGED


def understood(texts: Sequence[str] | None, signals: Sequence[Signal], by: Judge) -> list:
    """Criteria on ``signals``, of each sentence one, or one for every output, as `hydrotwin.comparison.criteria_of`.

    Raises as that, and for what is not judged.
    """
    from hydrotwin.comparison import criteria_of

    found, verb = [criteria_of(text, list(signals)) for text in texts or ()], by.verb.split()[0]
    for one in (one for many in found for one in many):
        if one.metric not in by.metrics:
            raise DeclarationError(
                f"accept: '{one.text}': {verb} judges {', '.join(by.metrics)}. Judge {one.metric} with compare."
            )
        if one.group:
            raise DeclarationError(
                f"accept: '{one.text}': {verb} judges all that was held out. Write it without '{one.group}:'; compare "
                "judges recordings one by one."
            )
        if one.than:
            _require_yardstick(one, by)
    return found


def _require_yardstick(one, by: Judge) -> None:
    """DeclarationError when a block is not held against what the criterion names."""
    if one.metric != "rmse":
        raise DeclarationError(f"accept: '{one.text}': yardsticks have rmse only.")
    if len(_meant(one.than, by.yardsticks)) != 1:
        raise DeclarationError(
            f"accept: '{one.text}': {by.verb} has no yardstick '{one.than}'. {nearest(one.than, by.yardsticks)}"
        )


def _meant(name: str, known: Sequence[str]) -> list[str]:
    return [one for one in known if name.lower() == one.lower() or name.lower() in one.lower().split()]


def accepted(asked: Sequence, block, silent: bool) -> bool:
    """Whether every criterion holds of the block's card, what was held out of its making; each is said.

    One on the RMS error has to hold of the recordings to validate with, too, where there are any: who names them means
    them. The other metrics are not known of these, which is said.
    """
    from hydrotwin.comparison import judge, worst
    from hydrotwin.learned.bands import known_bands
    from hydrotwin.learned.report_card import card_of
    from hydrotwin.learned.validation import as_card
    from hydrotwin.report.acceptance import found_told, margin_told

    places = [(card_of(block), HELD_OUT)] + ([(own, VALIDATED)] if (own := as_card(block)) else [])
    doubts, good = {n: band.says for n, band in known_bands(block.provenance).items() if not band.trustworthy}, True
    for many in asked:
        for card, where in places:
            if where == VALIDATED and not _known(many, card):
                if not silent:
                    mark(out, "note", f"{many[0].text}: {NOT_VALIDATED}", "yellow")
                continue
            found = worst(
                [replace(judge(one, _Card(one.text, card)), doubt=doubts.get(one.output, "")) for one in many]
            )
            good &= found.passed
            if not silent:
                word, style = ("PASS", "green") if found.passed else ("FAIL", "red")
                place = f", {where}" if len(places) > 1 else ""
                place += f"; {DOUBTED}" if found.passed and card.get("bad") else ""
                mark(out, word, f"{found.criterion.text}: {found_told(found)}, {margin_told(found)}{place}", style)
    return good


def _known(many: Sequence, card: dict) -> bool:
    """Whether a card of validation recordings says what the criteria of one sentence ask for."""
    rows = card["outputs"]
    return all(
        one.metric == "rmse"
        and one.output in rows
        and (not one.than or len(_meant(one.than, rows[one.output]["yardsticks"])) == 1)
        for one in many
    )


class _Card:
    """value(group, output, metric, model) of a card; infinite where the block has no number."""

    def __init__(self, text: str, card: dict):
        self.text, self.outputs = text, card.get("outputs", {})

    def __call__(self, group: str, output: str, metric: str, model: str) -> float:
        row = self.outputs.get(output, {})
        if model:
            return self._yardstick(row, metric, model)
        if metric == "nrmse":
            return row.get("percent_of_range", float("inf")) / 100
        if metric == "fit":
            return row.get("fit_percent", float("-inf")) / 100
        if metric == "coverage":
            return row.get("band", {}).get("coverage", float("nan"))
        return row.get(CARD[metric], float("inf"))

    def _yardstick(self, row: dict, metric: str, model: str) -> float:
        known = row.get("yardsticks", {})
        found = _meant(model, known)
        if row and (metric != "rmse" or len(found) != 1):
            unknown = f"no yardstick '{model}'. {nearest(model, known)}"
            words = unknown if metric == "rmse" else "yardsticks have rmse only."
            raise DeclarationError(f"accept: '{self.text}': {words}")
        return known[found[0]] if row else float("nan")
