"""What a learned block leaves in the record of its FMU: what it was trained on, and its card."""

from __future__ import annotations

from collections.abc import Mapping

from hydrotwin.models.language.credibility import FIT, JUDGE, LEARN, Credibility, Evidence
from hydrotwin.models.language.provenance import MADE_FROM, known_by
from hydrotwin.simulation import Block

from .report_card import card_of

MODE = "free run"
_NUMBERS = ("rmse", "mae", "maximum", "bias", "fit_percent")  # of an output on a card, SI


def credibility_of_block(block: Block) -> Credibility | None:
    """The recordings that its values and its form follow, and errors by output (SI) on what was held out; None for a
    block that does not say what it was trained on."""
    said = [row for key in MADE_FROM for row in _rows(block.provenance.get(key))]
    if not said:
        return None
    card = card_of(block)
    metrics = [
        {"output": name, "unit": row["unit"], "role": JUDGE, "mode": MODE} | {k: row[k] for k in _NUMBERS if k in row}
        for name, row in card.get("outputs", {}).items()
        if "unit" in row
    ]
    facts = {"kind": str(block.provenance.get("kind", "")), "card": str(card.get("says", ""))}
    known = {(row["name"], row["sha256"]): row for row in map(known_by, said)}
    rows = tuple(known[key] | {"role": FIT} for key in sorted(known))
    versions = {str(k): str(v) for k, v in block.provenance.get("versions", {}).items()}
    return Credibility((Evidence(LEARN, "", "", versions, rows, tuple(metrics), facts=facts),))


def _rows(said: object) -> list[Mapping]:
    listed = said if isinstance(said, list | tuple) else []
    return [row for row in listed if isinstance(row, Mapping) and row.get("name")]
