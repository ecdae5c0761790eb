"""What a model file says of how far its model can be trusted: where it was fitted and judged, and what came of it.

Every `Evidence` is of one state of the model, by the hash of all that its runs depend on (`contents_digest`): once a
value is edited it holds no longer. A hash of its own shows that an entry was changed by hand. It is no signature: who
means to deceive can write both anew.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version

import tomlkit

from .errors import DataError
from .provenance import MADE_FROM, MARKED, OTHERS, SAMPLES, SINCE, known_by, made_from_rows
from .writing import toml_values

FORMAT = 1  # of the block; goes up where keys change their meaning or go
KEY = "credibility"  # of the block in a model file
IDENTIFY, GAP, COMPARE, LEARN = "identify", "gap", "compare", "learn"
MADE_BY = (IDENTIFY, GAP, COMPARE, LEARN)
UNKNOWN = "unknown"  # in facts: samples of outputs that nobody knows, in words, where a comparison was
FIT, JUDGE = "fit", "judge"  # roles of a recording: values follow it, or it had no part in them
SHOWN = 3  # criteria that a sentence names
NEXT = "Take the block [credibility] out, or fit or record the model again."
_ACTING = ("model", "effects", "inputs")  # of a model file: what its runs depend on, beside values and their spread
_NOT_ASKED = ("file", SAMPLES, MARKED)  # of a recording: where it was, and by what it is known again
_TEXTS = ("by", "date", "contents")
_ROWS: Mapping[str, tuple[str, ...]] = {
    "recordings": ("name", "sha256", "role"),
    "metrics": ("output", "unit", "role", "mode"),
    "criteria": ("text",),
}
_TABLES = ("versions", "accuracy", "facts")


class StaleEvidenceWarning(UserWarning):
    """A model is no longer the one that was fitted or judged; the text says so."""


@dataclass(frozen=True)
class Evidence:
    """One time at which a model was fitted (``by`` identify, gap or learn) or judged (``by`` compare).

    contents : hash of the model it is of. recordings : rows ``name``, ``sha256`` and ``role``, fit or judge.
    metrics : rows ``output``, ``unit``, ``role``, ``mode`` and numbers, SI. criteria : rows ``text``, ``passed``,
    ``value``, ``low``, ``high``, ``margin``, and ``caution``, what to know before it is relied on. versions : of
    hydrotwin and Python. accuracy : of the runs. facts : whatever else belongs to it.
    """

    by: str
    date: str
    contents: str
    versions: Mapping[str, str] = field(default_factory=dict)
    recordings: tuple[Mapping, ...] = ()
    metrics: tuple[Mapping, ...] = ()
    criteria: tuple[Mapping, ...] = ()
    accuracy: Mapping = field(default_factory=dict)
    facts: Mapping = field(default_factory=dict)

    @property
    def passed(self) -> bool | None:
        """Whether every criterion held; None where there was none."""
        return all(bool(row["passed"]) for row in self.criteria) if self.criteria else None

    @property
    def told(self) -> str:
        """In a sentence."""
        counts = {role: sum(r["role"] == role for r in self.recordings) for role in (FIT, JUDGE)}
        on = " and ".join(f"{n} recording{'s' if n > 1 else ''} to {role}" for role, n in counts.items() if n)
        made = ", ".join(f"{name} {number}" for name, number in self.versions.items())
        doubted = ", ".join(str(name) for name in _listed(self.facts.get("untrusted_bands")))
        doubt = f". Its bands cannot be trusted for {doubted}" if doubted else ""
        when = f" on {self.date[:10]}" if self.date else ""
        since = "; ".join(map(str, _listed(self.facts.get(SINCE))))
        changed = f". Another since then: {since}" if since else ""
        return f"{self.by}{when} ({made}), {on or 'no recordings'}: {self._result()}{doubt}{changed}"

    def _result(self) -> str:
        if self.criteria:
            missed = [row for row in self.criteria if not row["passed"]]
            rows = missed or self.criteria
            words = [f"“{row['text']}”{_aside(row)}" for row in rows[:SHOWN]]
            more = f" and {len(rows) - SHOWN} more" if len(rows) > SHOWN else ""
            return f"{'FAIL' if missed else 'PASS'}, {'missed' if missed else 'held'}: {'; '.join(words)}{more}"
        lost = "; ".join(map(str, _listed(self.facts.get(UNKNOWN))))
        lost = f"; not judged: {lost}, not known" if lost else ""
        judged = sorted(self.metrics, key=lambda m: m["role"] != JUDGE)
        rows = [f"{m['output']} RMSE {m['rmse']:.4g} {m['unit']} ({m['role']})" for m in judged if "rmse" in m]
        return "no criteria" + (f"; {'; '.join(rows[:4])}" if rows else "") + lost

    def same_question(self, other: Evidence) -> bool:
        """Whether it judged the same on the same recordings in the same way: the later one replaces the earlier.

        One step ahead, read in another scale, under other tags, started otherwise or beside another model a criterion
        is another question: a missed one stays beside it.
        """
        return self._question == other._question

    @property
    def _question(self) -> tuple:
        rows = [{key: value for key, value in row.items() if key not in _NOT_ASKED} for row in self.recordings]
        on = frozenset(_digest(toml_values(row)) for row in rows)
        asked = self.facts.get("asked")
        how = dict(asked) if isinstance(asked, Mapping) else {}
        how |= {"modes": _listed(how.get("modes"))[:1]}  # the first is the one that criteria are about
        return self.by, on, frozenset(map(_asked, self.criteria)), _digest(toml_values(how))

    def as_data(self) -> dict:
        """As data for TOML and JSON, with its own hash."""
        own = toml_values({f.name: getattr(self, f.name) for f in dataclasses.fields(self)})
        return own | {"sha256": _digest(own)}


@dataclass(frozen=True)
class Credibility:
    """All evidence of a model, the oldest first."""

    evidence: tuple[Evidence, ...] = ()

    def holds_for(self, contents: str) -> bool:
        """Whether all of it is of the model with this hash."""
        return all(one.contents == contents for one in self.evidence)

    def of(self, contents: str) -> Credibility:
        """What is of the model with this hash."""
        return Credibility(tuple(one for one in self.evidence if one.contents == contents))

    def plus(self, new: Evidence) -> Credibility:
        """With one more; the same question on the same recordings is asked once."""
        return Credibility((*(one for one in self.evidence if not one.same_question(new)), new))

    @property
    def fitted_on(self) -> tuple[dict, ...]:
        """Rows of the recordings that values follow: name, SHA-256, and marks where they have them."""
        return tuple(known_by(row) for one in self.evidence for row in one.recordings if row["role"] == FIT)

    def as_data(self) -> dict:
        """As data for TOML and JSON."""
        return {"format": FORMAT, "evidence": [one.as_data() for one in self.evidence]}

    def as_toml(self) -> str:
        """The block [credibility], a row of a table a line."""
        lines = [f"[{KEY}]", f"format = {FORMAT}"]
        for one in self.evidence:
            lines += ["", f"[[{KEY}.evidence]]"]
            for key, value in one.as_data().items():
                rows = value if isinstance(value, list) else []
                text = "[\n" + "".join(f"    {_inline(row)},\n" for row in rows) + "]" if rows else _inline(value)
                lines.append(f"{key} = {text}")
        return "\n".join(lines) + "\n"


def from_data(data: object, where: str) -> Credibility:
    """From what `Credibility.as_data` gave. Raises DataError where it is damaged, changed by hand or newer."""
    if not isinstance(data, Mapping) or not isinstance(data.get("evidence", []), list):
        raise DataError(f"{where}: [credibility] is no table with [[credibility.evidence]] (got {data!r:.80}). {NEXT}")
    told = data.get("format")
    if type(told) is not int:
        raise DataError(f"{where}: [credibility] has no 'format' (got {told!r}), so it cannot be read. {NEXT}")
    if told > FORMAT:
        raise DataError(f"{where}: its [credibility] is of a newer version (format {told}). Update hydrotwin.")
    rows = [_evidence(row, f"{where}: evidence {k}") for k, row in enumerate(data.get("evidence", []), 1)]
    once = {_digest(one.as_data()): one for one in rows}  # an entry that was pasted twice was found once
    return Credibility(tuple(once.values()))


def _evidence(row: object, where: str) -> Evidence:
    if not isinstance(row, Mapping):
        raise DataError(f"{where} is no table (got {row!r:.80}). {NEXT}")
    names = {f.name for f in dataclasses.fields(Evidence)}
    if lost := sorted(({*names, "sha256"}) ^ set(row)):
        what = ", ".join(f"'{name}' {'is missing' if name not in row else 'has no place in it'}" for name in lost)
        raise DataError(f"{where} is damaged: {what}. {NEXT}")
    own = {name: row[name] for name in row if name != "sha256"}
    forms = [*((n, str) for n in _TEXTS), *((n, list) for n in _ROWS), *((n, Mapping) for n in _TABLES)]
    if wrong := [name for name, form in forms if not isinstance(own[name], form)]:
        raise DataError(f"{where} is damaged: '{wrong[0]}' has the wrong form (got {own[wrong[0]]!r:.80}). {NEXT}")
    for name, keys in _ROWS.items():
        if any(not isinstance(r, Mapping) or any(not isinstance(r.get(k), str) for k in keys) for r in own[name]):
            raise DataError(f"{where} is damaged: a row of '{name}' lacks one of {', '.join(keys)}. {NEXT}")
    if own["by"] not in MADE_BY or not all(isinstance(r.get("passed"), bool) for r in own["criteria"]):
        raise DataError(f"{where} is damaged: nothing of hydrotwin writes such an entry. {NEXT}")
    if row["sha256"] != _digest(own):
        raise DataError(
            f"{where} ({own['by']}, {own['date']}) was changed after it was written: its SHA-256 differs, so it "
            f"vouches for nothing. {NEXT}"
        )
    return Evidence(**{name: tuple(value) if isinstance(value, list) else value for name, value in own.items()})


def contents_digest(content: Mapping) -> str:
    """SHA-256 of all in a model file that its runs and bands depend on: model, effects, inputs, values, their spread.

    Bounds, sources and notes may be edited.
    """
    acting = {key: content.get(key) for key in _ACTING}
    told = content.get("provenance", {})
    acting |= {key: told.get(key) for key in ("spread", "fmu")} if isinstance(told, Mapping) else {}
    return _digest(acting | {"parameters": _values(content.get("parameters", {}))})


def _values(node: object) -> object:
    """Parameters without what does not act."""
    if not isinstance(node, Mapping):
        return node
    if any(not isinstance(below, Mapping) for below in node.values()):
        return {key: node[key] for key in ("value", "unit") if key in node}
    return {key: _values(below) for key, below in node.items()}


def _listed(value: object) -> list:
    return value if isinstance(value, list) else []


def _asked(row: Mapping) -> tuple[str, ...]:
    """The words of a criterion, and its bounds: another model or an earlier comparison may have set them."""
    return str(row["text"]), *(f"{float(row.get(key, math.nan)):.6g}" for key in ("low", "high"))


def _aside(row: Mapping) -> str:
    """How far inside or outside of its bound a criterion is, of an overall one which output, and what to know before it
    is relied on; else nothing."""
    told = [str(row["worst"])] if row.get("worst") else []
    share = 100 * float(row["margin"])
    told += [f"{share:{'+.2g' if abs(share) < 100 else '+.0f'}} %"] if math.isfinite(share) else []
    told += [str(row["caution"])] if row.get("caution") else []
    return f" ({', '.join(told)})" if told else ""


def _inline(value) -> str:
    """A value of TOML in one line."""
    if isinstance(value, list):
        return f"[{', '.join(map(_inline, value))}]"
    if not isinstance(value, Mapping):
        return tomlkit.item(value).as_string()
    return "{ " + ", ".join(f"{tomlkit.key(k).as_string()} = {_inline(v)}" for k, v in value.items()) + " }"


def _digest(data: object) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True, ensure_ascii=False).encode()).hexdigest()


def with_made_from(known: Credibility | None, provenance: Mapping) -> Credibility | None:
    """What vouches for a model, with the recordings that its values follow as its provenance says, where no evidence
    names them: of values that were edited or set, or that no file holds. Under other equations nothing else does."""
    own = Credibility() if OTHERS in provenance.get(SINCE, ()) else known or Credibility()
    named = {r["sha256"] or r["name"] for r in own.fitted_on}
    rows = [r for r in made_from_rows(provenance) if (r["sha256"] or r["name"]) not in named]
    if not rows:
        return None if known is None else own
    by = LEARN if any(provenance.get(key) for key in MADE_FROM) else IDENTIFY
    facts = {SINCE: list(provenance[SINCE])} if provenance.get(SINCE) else {}
    new = Evidence(by, "", "", versions(), tuple({**r, "role": FIT} for r in rows), facts=facts)
    return Credibility((*own.evidence, new))


def recording_rows(records: Sequence, role: str) -> list[dict]:
    """Rows of ``recordings``: records have ``name`` and ``digest``."""
    return [{"name": r.name, "sha256": r.digest or "", "role": role} for r in records]


def versions() -> dict[str, str]:
    """Of hydrotwin and Python, as they run."""
    try:
        own = version("hydrotwin")
    except PackageNotFoundError:
        own = "unknown"
    return {"hydrotwin": own, "python": platform.python_version()}


def now() -> str:
    """The date, with its time and zone."""
    return datetime.now().astimezone().isoformat(timespec="seconds")
