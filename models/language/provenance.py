"""What a model, a block or an FMU says of where its values come from, and what of that stays when one is made into
another.

Whatever makes a changed copy (another value, an effect more or less, a loop, a block) asks `lasting` what the copy may
say. What a fit or a training found of the model as it was is dropped (`OF_FIT`), and the copy says since what
(`SINCE`). All else stays, before all which recordings its values follow (`made_from`): errors on those say nothing.
"""

from __future__ import annotations

from collections.abc import Mapping

IDENTIFIED = "identified"  # how the source of a value begins that a fit found
OF_NO_FIT = {"sigma": None, "source": ""}  # a value that is set
RECORDINGS = "recordings"  # rows with name, role and sha256
EARLIER = {"fit": "earlier"}  # in a row, of a fit that found other values than the last
TRAIN = "train"  # the role of those that values follow
SPREAD = "spread"  # how sure a fit is: `identification.bands.Spread`
BAND, CARD = "band", "free_run"  # of a learned block: found in its training, and judged in `report_card`
EQUATIONS = "equations"  # hash of those that the values were fitted to
OTHERS = "its equations are others than its values were fitted to"
EDITED = "values, effects or inputs of its file edited"
SINCE = "since the fit"  # what was changed since, in words, one by one
MADE_FROM = ("trained_on", "selected_on", "physics_trained_on")  # rows with name and sha256
SAMPLES, MARKED = "samples", "marks"  # in a row: how many, and by what they are known again: `records.marks`
ASKED = "asked"  # how a fit was asked: its settings
JOINED = (SPREAD, BAND, CARD)  # what bands are made of
OF_FIT = (*JOINED, "chi2_per_sample", "noise", "rmse", "accuracy", "findings", "verdict", "effects", ASKED)
OF_VALUES = (RECORDINGS, "made_by", "date")  # what a fit says of its values, whatever is around them


def lasting(provenance: Mapping, since: str, stay: bool = True) -> dict:
    """What a provenance still says of a model that is another one now.

    since : what was changed, in words that follow a name. stay : whether values that a fit found are among those that
    it has.
    """
    gone = OF_FIT if stay else (*OF_FIT, *OF_VALUES)
    kept = {key: value for key, value in provenance.items() if key not in gone}
    told = since == OTHERS or {*JOINED, SINCE} & provenance.keys()  # under others nothing that was found of it holds
    lost = [*provenance.get(SINCE, ()), *([since] if told else [])]
    return kept | ({SINCE: list(dict.fromkeys(lost))} if lost else {})


def refitted(before: Mapping, new: Mapping, stay: bool) -> dict:
    """The provenance of a model of which a fit found values anew: ``new``, and what stays of that ``before``.

    stay : whether values that an earlier fit found were held. Then they still follow its recordings.
    """
    kept = {key: value for key, value in before.items() if key not in (*OF_FIT, *OF_VALUES, SINCE)}
    here = [(r.get("role"), r.get("sha256") or r.get("name")) for r in _rows(new, RECORDINGS)]
    rows = [r for r in _rows(before, RECORDINGS) if r.get("role") == TRAIN] if stay else []
    rows = [{**r, **EARLIER} for r in rows if (TRAIN, r.get("sha256") or r.get("name")) not in here]
    return kept | new | ({RECORDINGS: [*new.get(RECORDINGS, ()), *rows]} if rows else {})


def of_earlier_fits(provenance: Mapping) -> list[Mapping]:
    """The rows of recordings that values follow which an earlier fit found."""
    return [r for r in _rows(provenance, RECORDINGS) if EARLIER.items() <= r.items()]


def told_since(provenance: Mapping) -> str:
    """What was changed since the fit or the training, and what that means, as a sentence; "" for none."""
    if not (lost := provenance.get(SINCE)):
        return ""
    return (
        "it has no band, for what its fit or training found of how sure it is belongs to another state of it "
        f"({'; '.join(lost)})"
    )


def made_from_rows(provenance: Mapping) -> list[dict]:
    """Name, SHA-256 ("" where it is not known) and marks, where it has them, of the recordings that a model was fitted
    to, or a block trained on or chosen by, as far as its provenance says it."""
    own = [r for r in _rows(provenance, RECORDINGS) if r.get("role") == TRAIN]
    rows = [*own, *(r for key in MADE_FROM for r in _rows(provenance, key))]
    found = [known_by(r) for r in rows]
    return [row for k, row in enumerate(found) if row not in found[:k]]


def known_by(row: Mapping) -> dict:
    """Of a row what tells which recording it is of, whatever it was used for."""
    marks = {key: row[key] for key in (SAMPLES, MARKED)} if {SAMPLES, MARKED} <= row.keys() else {}
    return {"name": str(row.get("name", "")), "sha256": str(row.get("sha256") or "")} | marks


def made_from(provenance: Mapping) -> frozenset[str]:
    """SHA-256 of the recordings of `made_from_rows`, as far as they are known."""
    return frozenset(row["sha256"] for row in made_from_rows(provenance) if row["sha256"])


def _rows(provenance: Mapping, key: str) -> list[Mapping]:
    said = provenance.get(key, ())
    return [r for r in said if isinstance(r, Mapping)] if isinstance(said, list | tuple) else []
