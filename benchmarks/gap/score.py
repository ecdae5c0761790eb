"""One row per case and method: was the hidden effect named, at which price, and how well does the result predict?"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from tests import rig

from .cases import Made

SURE = 0.5  # probability above which a wrong name is confidently wrong
VISIBLE = 0.3  # times the noise, left by the base model refitted: below it that has swallowed the gap, `none` is right

# Names that are the same physics at that place, by (machine, rig effect). Everything else must match by id.
SAME = {
    ("spool_valve", "spool_lag"): {"actuator_lag"},  # a slower slide is a slower actuator of the same signal
    ("spool_valve", "line_friction"): {"flow_saturation"},  # a line behind every edge: its equation with n = 2
    ("spool_valve", "asymmetric_friction"): {"coulomb_friction"},  # the rest of it is the load force, which is free
}
# Where the rig puts an effect, as words that must all stand in the name of the catalogue's site. Sensor effects: the
# output. Effects not listed may be named anywhere. Of one machine: (machine, effect).
SITES = {
    "internal_leakage": ("cap", "annulus"),
    "turbulent_leakage": ("cap", "annulus"),
    "external_leakage": ("cap",),
    "line_compliance": ("cap",),
    "line_friction": ("lines",),
    "area_error": ("cap_area",),
    "linkage_error": ("pin_length",),
    "supply_droop": ("supply",),
    ("winch", "external_leakage"): ("hose_a",),
    ("winch", "payload_error"): ("load.mass",),
    ("lift_boom", "payload_error"): ("extra_mass",),
}


def _option(name: str, factor: float = 1.0):
    """The rig's option itself, in other units."""
    return lambda made, options: factor * options.get(name, math.nan)  # nan: not what this case sets


def _times_usual(made: Made, options) -> float:
    """The base parameter that the rig multiplies."""
    effect = next(name for name, own in made.hidden if own is options)
    path = rig.effect_of(made.case.machine, effect).fields[made.case.machine]
    return rig.machine_of(made.case.machine).parameters[path] * options["factor"]


# rig effect -> parameters of the catalogue's effect (last word of the path, a pattern) that mean the same, and what
# they are in truth. Effects whose two forms differ (ripples, knees, bristles) have none.
PARAMETERS = {
    "coulomb_friction": {"force": _option("force")},
    "stribeck_friction": {
        "force": _option("kinetic"),
        "excess": _option("extra"),
        "stribeck_velocity": _option("velocity"),
    },
    "asymmetric_friction": {
        "out": lambda made, o: o["force"] * (1 + ASYMMETRY),
        "back": lambda made, o: o["force"] * (1 - ASYMMETRY),
    },
    "internal_leakage": {"conductance": _option("conductance")},
    "turbulent_leakage": {"coefficient": _option("coefficient")},
    "external_leakage": {"conductance": _option("cap")},
    "pump_slip": {"conductance": _option("conductance")},
    "entrained_air": {"fraction": _option("fraction")},
    "line_compliance": {"compliance": _option("cap")},
    "line_friction": {"turbulent": _option("turbulent")},
    "cavitation": {"pressure": _option("pressure")},
    "area_error": {"cap_area": _times_usual},
    "displacement_error": {"displacement": _times_usual},
    "payload_error": {"extra_mass|mass": _times_usual},
    "linkage_error": {"pin_length": _times_usual},
    "end_stop": {"low": _option("low"), "high": _option("high")},
    "backlash": {"gap": _option("gap")},
    "structural_compliance": {"compliance": lambda made, o: 1 / o["stiffness"]},
    "valve_overlap": {"overlap": _option("share")},
    "asymmetric_overlap": {"positive": _option("pressure_a"), "negative": _option("pressure_b")},
    "spool_hysteresis": {"half_width": _option("width", 0.5)},
    "supply_droop": {"resistance": _option("resistance")},
    "null_bias": {"offset": _option("value")},
    "dead_time": {"time|dead_time": _option("seconds")},
    "actuator_lag": {"time_constant": _option("time_constant")},
    "command_deadband": {"width": _option("width")},
    "command_saturation": {"limit": _option("limit")},
    "rate_limit": {"rate": _option("rate")},
    "direction_asymmetry": {"asymmetry": lambda made, o: (1 - o["ratio"]) / (1 + o["ratio"])},  # beside a free gain
    "motor_droop": {"slope": _option("resistance")},
    "drift": {"rate": _option("rate")},
    "sensor_bias": {"offset": _option("value")},
    "sensor_drift": {"rate": _option("rate")},
    "sensor_scale": {"error": lambda made, o: o["factor"] - 1},
    "sensor_delay": {"time": _option("seconds")},
    "sensor_lag": {"time_constant": _option("time_constant")},
    "sensor_hysteresis": {"half_width": _option("width", 0.5)},
    "quantisation": {"step": _option("step")},
}
ASYMMETRY = rig.EFFECTS["asymmetric_friction"].defaults["asymmetry"]


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
    """What a method says of a case.

    rmse_* : over the held-out recordings, by output, SI; None: predicts nothing. probabilities : of "nothing", of
    structures ("effect at site + ...") and of "something else", where it states them.
    """

    verdict: str
    named: tuple[Named, ...]
    rmse_before: Mapping[str, float]
    rmse_after: Mapping[str, float] | None
    seconds: float
    notes: Mapping = field(default_factory=dict)
    probabilities: Mapping[str, float] = field(default_factory=dict)


def answer_of(discovery, settings: Mapping = MappingProxyType({})) -> Answer:
    """A `Discovery` as an Answer; settings: those of the search, to be noted."""
    named = []
    for step in discovery.steps:
        parameters = tuple((p.name, p.value, p.low, p.high) for p in step.parameters)
        named.append(Named(step.effect, step.site, step.members, step.probability, parameters))
    judged = {o.output: o for o in discovery.outputs["validate"]}
    ranked = discovery.steps[0].ranked if discovery.steps else discovery.last_ranked
    return Answer(
        discovery.verdict,
        tuple(named),
        {name: o.rmse_before for name, o in judged.items()},
        {name: o.rmse_after for name, o in judged.items()},
        discovery.seconds,
        {
            **settings,
            "reason": discovery.reason,
            "untried": list(discovery.untried),
            "screened": discovery.screened,
            "fitted": discovery.fitted,
            "rmse_fit": {o.output: o.rmse_after for o in discovery.outputs.get("train", ())},
            "candidates": [_looked_at(r) for r in ranked],
        },
        dict(discovery.probabilities),
    )


def _looked_at(r) -> dict:
    """What became of a candidate: the share that it promised to close, the nats that it left, its fate."""
    return {"label": r.label, "share": r.share, "left": r.left, "probability": r.probability, "fate": r.fate}


def is_it(made: Made, hidden: int, effect: str, site: str) -> bool:
    """Whether a name at a site is the hidden effect of that number."""
    name, options = made.hidden[hidden]
    if effect != name and effect not in SAME.get((made.case.machine, name), ()):
        return False
    words = SITES.get((made.case.machine, name), SITES.get(name, ()))
    words = (options["output"],) if "output" in options else words
    return all(word in site for word in words) or effect != name


def times_noise(rmse: Mapping[str, float], noise: Mapping[str, float]) -> float:
    """Root of the mean over outputs of (RMSE/noise)^2."""
    return float(np.sqrt(np.mean([(rmse[name] / sigma) ** 2 for name, sigma in noise.items()])))


def row_of(
    made: Made, answer: Answer, *, method: str, oracle: Mapping[str, float] | None = None, lacking: Sequence = ()
) -> dict:
    """The row, ready for JSON. ``oracle``: held-out RMSE by output of the true structure refitted.

    lacking : the same without one of the hidden effects, in turn; of pairs.
    """
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
            "length": case.seconds,
            "bits": case.bits,
            "hidden": [[name, dict(options)] for name, options in made.hidden],
            "gap": made.gap,
            "visible": made.visible,
            "seen": bool(_left(made, answer) >= VISIBLE),
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
            "lacking": [times_noise(rmse, made.noise) for rmse in lacking if rmse],
            "parameters": _parameters(made, named),
            "stated": _stated(made, named),
            "brier": brier(_stated(made, named)),
            "probabilities": dict(answer.probabilities),
            "of_truth": _of_truth(made, answer),
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
                same = PARAMETERS.get(effect, {})
                rows += [_compared(f"{effect}.{w}", w, true(made, options), n) for w, true in same.items()]
    return [r for r in rows if r]


def _compared(label: str, wanted: str, true: float, n: Named) -> dict | None:
    for name, found, low, high in n.parameters:
        if re.fullmatch(wanted, name.rpartition(".")[2]):
            error = abs(found - true) / abs(true) if true else None
            return {"parameter": label, "true": true, "found": found, "error": error, "covered": low <= true <= high}
    return None


def _stated(made: Made, named: Sequence[Named]) -> list[tuple[float, bool]]:
    """(stated probability, whether it is what is hidden) of every named effect that states one."""
    hits = [any(is_it(made, h, n.effect, n.site) for h in range(len(made.hidden))) for n in named]
    known = made.case.kind != "out_of_library"
    return [(n.probability, hit and known) for n, hit in zip(named, hits, strict=True) if math.isfinite(n.probability)]


def _of_truth(made: Made, answer: Answer) -> float | None:
    """Probability that a method gives to what is hidden, and to nothing where the base left no gap; None: states none.

    What no catalogue has is "something else". A label with another effect besides is not what is hidden.
    """
    if not answer.probabilities:
        return None
    known, quiet = made.case.kind != "out_of_library", _left(made, answer) < VISIBLE
    found = 0.0
    for label, probability in answer.probabilities.items():
        if label == "nothing":
            right = made.case.kind == "none" or quiet
        elif label == "something else":
            right = not known
        else:
            right = known and bool(made.hidden) and _all_hidden(made, label)
        found += probability * right
    return found


def _all_hidden(made: Made, label: str) -> bool:
    """Whether a structure, ``effect at site + ...``, is what is hidden, no more and no less."""
    parts = [tuple(part.partition(" at ")[::2]) for part in label.split(" + ")]
    return len(parts) == len(made.hidden) and all(
        any(is_it(made, h, *part) for part in parts) for h in range(len(made.hidden))
    )


def brier(said: Sequence[tuple[float, bool]]) -> float | None:
    """Mean squared difference of stated probability and truth; None where nothing was stated."""
    return float(np.mean([(p - hit) ** 2 for p, hit in said])) if said else None


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
