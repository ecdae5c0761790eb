"""One row per case and method: was the hidden effect named, at which price, and how well does the result predict?"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .cases import Made

SURE = 0.5  # probability above which a wrong name is confidently wrong
VISIBLE = (
    0.3  # times the noise, in theory or in fact: below it the base model has swallowed the gap; `none` is right too
)

# Names that are the same physics at that place, by (machine, rig effect). Everything else must match by id.
SAME = {
    ("spool_valve", "spool_lag"): {"actuator_lag"},  # a slower slide is a slower actuator of the same signal
}
# Where the rig puts an effect, as words that must all stand in the name of the catalogue's site. Sensor effects: the
# output. Effects not listed may be named anywhere.
SITES = {
    "internal_leakage": ("cap", "annulus"),
    "turbulent_leakage": ("cap", "annulus"),
    "external_leakage": ("cap",),
    "line_compliance": ("cap",),
    "area_error": ("cap_area",),
}
# (rig effect, option) -> (parameter of the catalogue's effect, what the rig's value is there).
PARAMETERS = {
    ("coulomb_friction", "force"): ("force", float),
    ("internal_leakage", "conductance"): ("conductance", float),
    ("dead_time", "seconds"): ("time|dead_time", float),
    ("actuator_lag", "time_constant"): ("time_constant", float),
    ("rate_limit", "rate"): ("rate", float),
    ("command_saturation", "limit"): ("limit", float),
    ("command_deadband", "width"): ("width", float),
    ("null_bias", "value"): ("offset", float),
    ("motor_droop", "resistance"): ("slope", float),
    ("drift", "rate"): ("rate", float),
    ("sensor_delay", "seconds"): ("time|delay", float),
    ("sensor_lag", "time_constant"): ("time_constant", float),
    ("sensor_bias", "value"): ("offset|bias|value", float),
}


@dataclass(frozen=True)
class Named:
    """One named effect: its class as (effect, site), itself first, and its parameters as (name, value, low, high)."""

    effect: str
    site: str
    members: tuple[tuple[str, str], ...]
    probability: float
    parameters: tuple[tuple[str, float, float, float], ...] = ()


@dataclass(frozen=True)
class Answer:
    """What a method says of a case. rmse_*: over the held-out recordings, by output, SI; None: predicts nothing."""

    verdict: str
    named: tuple[Named, ...]
    rmse_before: Mapping[str, float]
    rmse_after: Mapping[str, float] | None
    seconds: float
    notes: Mapping = field(default_factory=dict)


def answer_of(discovery) -> Answer:
    """A `Discovery` as an Answer; an effect that is named together with another counts as named beside it."""
    named = []
    for step in discovery.steps:
        parameters = tuple((p.name, p.value, p.low, p.high) for p in step.parameters)
        named.append(Named(step.effect, step.site, step.members, step.probability, parameters))
        named += [Named(e, s, ((e, s),), step.probability, parameters) for e, s in step.together]
    judged = {o.output: o for o in discovery.outputs["validate"]}
    return Answer(
        discovery.verdict,
        tuple(named),
        {name: o.rmse_before for name, o in judged.items()},
        {name: o.rmse_after for name, o in judged.items()},
        discovery.seconds,
        {"timings": dict(discovery.timings)},
    )


def is_it(made: Made, hidden: int, effect: str, site: str) -> bool:
    """Whether a name at a site is the hidden effect of that number."""
    name, options = made.hidden[hidden]
    if effect != name and effect not in SAME.get((made.case.machine, name), ()):
        return False
    words = (options["output"],) if "output" in options else SITES.get(name, ())
    return all(word in site for word in words) or effect != name


def times_noise(rmse: Mapping[str, float], noise: Mapping[str, float]) -> float:
    """Root of the mean over outputs of (RMSE/noise)^2."""
    return float(np.sqrt(np.mean([(rmse[name] / sigma) ** 2 for name, sigma in noise.items()])))


def row_of(made: Made, answer: Answer, *, method: str, oracle: Mapping[str, float] | None = None) -> dict:
    """The row, ready for JSON. ``oracle``: held-out RMSE by output of the true structure refitted."""
    case, named = made.case, answer.named
    count = len(made.hidden) if case.kind in ("single", "pairs") else 0
    exact = [any(is_it(made, h, n.effect, n.site) for n in named) for h in range(count)]
    inside = [any(is_it(made, h, *m) for n in named for m in _members(n)) for h in range(count)]
    right = [any(is_it(made, h, *m) for h in range(count) for m in _members(n)) for n in named]
    wrong = [n for n, ok in zip(named, right, strict=True) if not ok]
    wrongly_sure = any(n.probability > SURE and len({e for e, _ in _members(n)}) == 1 for n in wrong)
    return _plain(
        {
            "case": case.name,
            "method": method,
            "machine": case.machine,
            "kind": case.kind,
            "severity": case.severity,
            "sensors": case.sensors,
            "excitation": case.excitation,
            "seed": case.seed,
            "hidden": [[name, dict(options)] for name, options in made.hidden],
            "gap": made.gap,
            "visible": made.visible,
            "seen": bool(max(made.visible, _left(made, answer)) >= VISIBLE),
            "verdict": answer.verdict,
            "named": [[n.effect, n.site, n.probability, [list(m) for m in n.members]] for n in named],
            "exact": exact,
            "in_class": inside,
            "wrong_place": _wrong_place(made, named, inside),
            "extra": len(wrong),
            "false_alarm": bool(named) if case.kind == "none" else None,
            "confidently_wrong": wrongly_sure,
            "abstained": answer.verdict in ("unknown", "none") and not named,
            **_predictions(made, answer, oracle),
            "parameters": _parameters(made, named),
            "brier": _brier(made, named),
            "seconds": answer.seconds,
            "notes": dict(answer.notes),
        }
    )


def _left(made: Made, answer: Answer) -> float:
    """Gap over the noise that the refitted base model shows on the held-out recordings."""
    return float(np.sqrt(max(times_noise(answer.rmse_before, made.noise) ** 2 - 1, 0.0)))


def _members(n: Named):
    return n.members or ((n.effect, n.site),)


def _wrong_place(made, named, inside) -> bool:
    """The right effect, but only at a site where it is not."""
    said = {e for n in named for e, _ in _members(n)}
    return any(name in said and not found for (name, _), found in zip(made.hidden, inside, strict=False))


def _predictions(made: Made, answer: Answer, oracle) -> dict:
    before = times_noise(answer.rmse_before, made.noise)
    if answer.rmse_after is None:
        return {"before": before, "after": None, "gap_closed": None, "oracle": None, "over_oracle": None}
    after = times_noise(answer.rmse_after, made.noise)
    best = times_noise(oracle, made.noise) if oracle else None
    return {
        "before": before,
        "after": after,
        "gap_closed": 1 - (after**2 - 1) / (before**2 - 1) if before**2 > 1.02 else None,
        "oracle": best,
        "over_oracle": after / best if best else None,
    }


def _parameters(made: Made, named: Sequence[Named]) -> list[dict]:
    """Errors of parameters that mean the same in truth and catalogue, where the effect was named at its place."""
    rows = []
    for h, (effect, options) in enumerate(made.hidden):
        for n in named:
            if n.effect == effect and is_it(made, h, n.effect, n.site):
                rows += [_compared(effect, option, value, n) for option, value in options.items()]
    return [r for r in rows if r]


def _compared(effect, option, value, n: Named) -> dict | None:
    if (effect, option) not in PARAMETERS:
        return None
    wanted, convert = PARAMETERS[effect, option]
    for name, found, low, high in n.parameters:
        if re.fullmatch(wanted, name.rpartition(".")[2]):
            true = convert(value)
            return {
                "parameter": f"{effect}.{option}",
                "true": true,
                "found": found,
                "error": abs(found - true) / abs(true) if true else None,
                "covered": low <= true <= high,
            }
    return None


def _brier(made: Made, named: Sequence[Named]) -> float | None:
    """Mean squared difference of stated probability and truth, over the named effects; None when nothing was named."""
    hits = [any(is_it(made, h, n.effect, n.site) for h in range(len(made.hidden))) for n in named]
    if made.case.kind == "out_of_library":
        hits = [False] * len(hits)
    scores = [(n.probability - hit) ** 2 for n, hit in zip(named, hits, strict=True) if math.isfinite(n.probability)]
    return float(np.mean(scores)) if scores else None


def _plain(value):
    """Values that JSON knows; not-a-number becomes null."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value
