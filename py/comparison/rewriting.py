"""What people write in place of a criterion, and the criterion that they mean: for refusals only.

Nothing is judged by what stands here: a reader sees it and writes it, or does not.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from .metric import METRICS

_N = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_BE = r"(?:(?:is|be|must\s+be|shall\s+be|should\s+be|has\s+to\s+be|stays?)\s+)?"
_FLIPPED = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}
_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺", "0123456789-+")
_WORDS = {  # the longest first: "no more than" is not "more than"
    "<=": r"less\s+than\s+or\s+equal(?:\s+to)?|at\s+most|no(?:t)?\s+(?:more|greater|larger|higher)\s+than"
    r"|not?\s+(?:above|over)|up\s+to|does\s+not\s+exceed|within",
    ">=": r"(?:more|greater)\s+than\s+or\s+equal(?:\s+to)?|at\s+least|no(?:t)?\s+(?:less|smaller|lower)\s+than"
    r"|not?\s+(?:below|under)",
    "<": r"(?:less|smaller|lower)\s+than|below|under",
    ">": r"(?:more|greater|larger|higher)\s+than|above|over|exceeds",
}


@dataclass(frozen=True)
class Form:
    """What a text may mean.

    why : it is no criterion itself. sentences : to write; either : only one of them is meant.
    """

    why: str
    sentences: tuple[str, ...]
    either: bool = False

    @property
    def joined(self) -> str:
        """The sentences in words.

        >>> Form("", ("a < 1.000 Pa", "a < 1000 Pa"), either=True).joined
        "'a < 1.000 Pa' or 'a < 1000 Pa'"
        """
        return (" or " if self.either else ", ").join(f"'{one}'" for one in self.sentences)


@dataclass(frozen=True)
class _Rule:
    """Of texts that hold ``pattern`` what is wrong and what stands in its place."""

    why: str
    pattern: re.Pattern
    instead: str | Callable[[re.Match], str]


def _rule(why: str, pattern: str, instead: str | Callable[[re.Match], str]) -> _Rule:
    return _Rule(why, re.compile(pattern, re.IGNORECASE), instead)


def _power(found: re.Match) -> str:
    return f"{found['digits'] or '1'}e{(found['plain'] or found['raised']).translate(_SUPERSCRIPTS)}"


def _with_point(found: re.Match) -> str:
    return found[1] + found[2].replace(",", ".", 1).replace(",", "")


def _turned(found: re.Match) -> str:
    return f"{found['what']} {_FLIPPED[found['sign']]} {found['bound']}"


def _equal(found: re.Match) -> str:
    name = found["what"].rpartition(".")[2].strip()
    return f"{found['what']} {'>=' if name in METRICS and METRICS[name].best else '<='} "


_RANGES = (
    _rule("has decimal commas", r"\[\s*([-+]?\d+),(\d+)\s*[,;]\s*([-+]?\d+),(\d+)", r"[\1.\2, \3.\4"),
    _rule("parts its bounds by no comma", rf"\[\s*({_N})\s*(?:;|\.\.+|to|-|\s)\s*({_N})", r"[\1, \2"),
    _rule("has a range in other brackets", rf"\bin\s*[(\]{{]\s*({_N})\s*[,;]\s*({_N})\s*[)\[}}]", r"in [\1, \2]"),
    _rule("has a range in other words", rf"{_BE}(?:between|from|within|in)\s+({_N})\s*[^\s\d,.]*\s*"
          rf"(?:and|to|\.\.+|,)\s*({_N})", r"in [\1, \2]"),
    _rule("has a unit behind one of its bounds", rf"\[\s*({_N})\s*([^\s,\]\d][^,\]]*?)\s*,\s*({_N})\s*\]",
          r"[\1, \3] \2"),
    _rule("has a unit behind one of its bounds", rf"\[\s*({_N})\s*,\s*({_N})\s*([^\s,\]][^,\]]*?)\s*\]",
          r"[\1, \2] \3"),
    _rule("has a bound on either side", rf"^({_N})\s*\S*?\s*<=?\s*([^<>]+?)\s*<=?\s*({_N})\s*([^<>]*)$",
          r"\2 in [\1, \3] \4"),
    _rule("has a bound on either side", rf"^({_N})\s*\S*?\s*>=?\s*([^<>]+?)\s*>=?\s*({_N})\s*([^<>]*)$",
          r"\2 in [\3, \1] \4"),
)  # fmt: skip
_NUMBERS = (
    _rule("parts the thousands of a number", r"(?<=\d)(?:[\s'’_](?=\d{3}(?:\D|$)))", ""),
    _rule("has a decimal comma", r"(?<=\d),(?=\d)", "."),
    _rule("has a power of ten in other signs", r"(?:(?P<digits>\d+(?:\.\d*)?|\.\d+)\s*[·×x*]\s*)?\b10"
          r"(?:\s*(?:\^|\*\*)\s*\(?(?P<plain>[-+]?\d+)\)?|(?P<raised>[⁻⁺]?[⁰¹²³⁴-⁹]+))", _power),
)  # fmt: skip
_THAN = (
    _rule("says it in other words", rf"(?:not|no|at)\s+(?:more\s+than\s+|most\s+)?({_N}\s*(?:%|percent)?)\s+worse\s+"
          r"than\s+(.+)$", r"not worse than \2 by \1"),
    _rule("says it in other words", r"better\s+than\s+(.+?)\s+by\s+(\d)", r"not worse than \1 by -\2"),
    _rule("says it in other words", rf"{_BE}(?:(?:no|never|not)[\s_-]+wors[et][\s_-]+the?[an]n?|at\s+least\s+as\s+good"
          r"\s+as|as\s+good\s+as|better\s+than)\b", "not worse than"),
    _rule("says in other words how much worse it may be",
          rf"(not\s+worse\s+than\s+.+?),?\s+(?:by|plus|with|within|\+|\()\s*(?:more\s+than|at\s+most|up\s+to|max\.?)?\s*"
          rf"({_N})\s*(%|percent)?\s*(?:tolerance|\))?$", r"\1 by \2 \3"),
    _rule("says in other words how much worse it may be", r"(not\s+worse\s+than\s+.+?),\s+by\b", r"\1 by"),
)  # fmt: skip
_SIGNS = (
    *(_rule("says its sign in words", rf"\s+{_BE}(?:{some})\s+(?={_N})", f" {sign} ") for sign, some in _WORDS.items()),
    _rule("asks for a number to the last digit",
          rf"(?P<what>.*?[^\s<>=!])\s*(?:={{1,3}}|:=|≈|~|\bis|\bequals)\s*(?={_N})", _equal),
    _rule("has its bound in front",
          rf"^(?P<bound>{_N}[^<>=]*?)\s*(?P<sign><=|>=|<|>)\s*(?P<what>[^<>=\d][^<>=]*)$", _turned),
    _rule("has no number behind its sign, and a model stands behind 'not worse than'",
          r"^([^<>]+?)\s*<=?\s*(?!nan|inf)([^\W\d][^<>]*?)(?:\.(?:rmse|mae|max|bias))?$", r"\1 not worse than \2"),
)  # fmt: skip
_ENDS = (
    _rule("ends in a sign of its own", r"(?:\s+#.*|\s*[.;,!]+)$", ""),
    _rule("stands in quotes", r"^([\"'])(.+)\1$", r"\2"),
    _rule("says behind it what it is about", r"^(.+?)\s+(?:on|for|in|at|of)\s+(\w[^<>=]*=\s*\S[^<>=]*)$", r"\2: \1"),
)
_RULES = (*_ENDS, *_RANGES, *_NUMBERS, *_THAN, *_SIGNS)
_THOUSANDS = re.compile(r"\b(\d{1,3})((?:,\d{3})+)\b(?!,)")
_SEVERAL = (
    (re.compile(r"\s*;\s*|\s*,?\s+(?:and|&&?)\s+|\s*,\s+(?=[^\[\]]*[<>])"), "is more than one criterion", False),
    (re.compile(r"\s*,?\s+or\s+"), "says 'or', while all criteria must hold", True),
)


def forms(text: str) -> Iterator[Form]:
    """What a text may mean, the nearest first; each still has to be read."""
    group, rest = _parted(text)
    if _THOUSANDS.search(rest) and "[" not in rest:
        meant = (_THOUSANDS.sub(_with_point, rest), _THOUSANDS.sub(lambda found: found[0].replace(",", ""), rest))
        yield Form("has a comma in a number", tuple(group + one for one in meant), either=True)
    for head, tail in {(group, rest): None, ("", text): None}:
        yield from _rewritten(head, tail)
    for sign, why, either in _SEVERAL:
        parts = sign.split(rest)
        if len(parts) > 1:
            yield Form(why, tuple(group + one for one in parts), either)


def _rewritten(group: str, rest: str) -> Iterator[Form]:
    """By each rule alone, then by one after the other."""
    for rule in _RULES:
        if rule.pattern.search(rest):
            yield Form(rule.why, (_tidy(group + rule.pattern.sub(rule.instead, rest)),))
    whys: dict[str, None] = {}
    for rule in _RULES:
        if rule.pattern.search(rest):
            rest, whys[rule.why] = _tidy(rule.pattern.sub(rule.instead, rest)), None
            yield Form(" and ".join(whys), (group + rest,))


def _parted(text: str) -> tuple[str, str]:
    """The group with its colon, as far as it is one, and the rest."""
    found = re.match(r"(\s*\S[\s\S]*:\s+)(\S[\s\S]*)", text)
    return (found[1], found[2]) if found else ("", text)


def _tidy(text: str) -> str:
    return re.sub(r"[ \t]+", " ", text).strip()
