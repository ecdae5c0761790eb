"""gap.json: everything a gap report says, in SI, for machines."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict

from hydrotwin.discovery.answer.discovery import Discovery, EffectParameter, Experiment, OutputGap, Ranked, Step
from hydrotwin.models.language.writing import json_values
from hydrotwin.records.between import between
from hydrotwin.simulation.control import Accuracy

from .fit import parameter_rows


def gap_data(discovery: Discovery) -> dict:
    """The content of gap.json, only what JSON knows: numbers that do not exist are null.

    The keys model, verdict, steps, noise, train, validate, separating_experiment and seconds are a contract.
    """
    content = {
        "model": discovery.name,
        "verdict": discovery.verdict,
        "answer": discovery.answer,
        "inputs": between(discovery.model.flat.inputs),
        "assumptions": list(discovery.assumptions),
        "steps": [_step(s) for s in discovery.steps],
        "noise": dict(discovery.noise),
        "train": _outputs(discovery.outputs.get("train", ())),
        "validate": _outputs(discovery.outputs.get("validate", ())),
        "separating_experiment": _experiment(discovery.experiment),
        "probabilities": dict(discovery.probabilities),
        "untried": list(discovery.untried),
        "screened": discovery.screened,
        "fitted": discovery.fitted,
        "given": dict(discovery.given),
        "seconds": discovery.seconds,
        "candidates": [
            *(_candidate(r, k) for k, s in enumerate(discovery.steps, 1) for r in s.ranked),
            *(_candidate(r, len(discovery.steps) + 1) for r in discovery.last_ranked),
        ],
        "not_testable": [_ranked(r) for r in discovery.not_testable],
        "recordings": [
            {"record": r.record, "role": r.role, "outputs": _outputs(r.outputs)} for r in discovery.recordings
        ],
        "locations": [_location(place) for place in discovery.locations],
        "regions": [asdict(r) for r in discovery.regions],
        "shifts": [asdict(s) for s in discovery.shifts],
        "parameters": [asdict(r) for r in parameter_rows(discovery.fit_after)] if discovery.fit_after else [],
        "fit_records": [_fitted_to(r) for r in getattr(discovery.fit_after, "records", ())],
        "accuracy": {name: reached.as_data() for name, reached in accuracy(discovery).items()},
        "waterfall": [asdict(r) for r in discovery.waterfall],
        "unknown": [asdict(u) for u in discovery.unknown],
        "findings": [str(f) for f in discovery.findings],
        "provenance": dict(discovery.provenance),
    }
    return json_values(content)


def accuracy(discovery: Discovery) -> dict[str, Accuracy]:
    """Of the runs "before" and "after", as far as it is known: an FMU runs itself."""
    fits = {"before": discovery.fit_before, "after": discovery.fit_after}
    return {name: fit.accuracy for name, fit in fits.items() if getattr(fit, "accuracy", None)}


def _step(step: Step) -> dict:
    effects = dict.fromkeys([step.effect, *(effect for effect, _ in step.members)])
    if step.members:
        effects = dict.fromkeys(effect for effect, _ in step.members)
    return {
        "effect": step.effect,
        "site": step.site,
        "title": step.title,
        "equation": step.equation,
        "source": step.source,
        "class": list(effects),
        "members": _places(step.members),
        "together": _places(step.together),
        "beside": _places(step.beside),
        "probability": step.probability,
        "parameters": _parameters(step.parameters),
        "gap_closed": step.gap_closed,
        "sentence": step.sentence,
    }


def _fitted_to(record) -> dict:
    return {"record": record.name, "role": record.role, "samples": record.samples, "sha256": record.digest}


def _parameters(rows: Iterable[EffectParameter]) -> dict:
    return {p.name: {k: v for k, v in asdict(p).items() if k != "name"} for p in rows}


def _ranked(row: Ranked) -> dict:
    return asdict(row) | {"parameters": _parameters(row.parameters)}


def _candidate(row: Ranked, step: int) -> dict:
    return {"step": step} | _ranked(row)


def _outputs(rows: Iterable[OutputGap]) -> dict:
    return {o.output: {k: v for k, v in asdict(o).items() if k != "output"} for o in rows}


def _places(pairs: Iterable[tuple[str, str]]) -> list[dict]:
    return [{"effect": effect, "site": site} for effect, site in pairs]


def _location(place) -> dict:
    drivers = [{"name": n, "correlation": c, "lag": lag} for n, c, lag in place.drivers]
    return asdict(place) | {"drivers": drivers}


def _experiment(experiment: Experiment | None) -> dict | None:
    return None if experiment is None else asdict(experiment)
