"""The report of a comparison: report.html, report.md and compare.json from one set of rows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path

from hydrotwin.comparison import FORMAT, FREE_RUN, Acceptance, Comparison
from hydrotwin.comparison.as_read import as_read
from hydrotwin.comparison.notices import notices, starts_told
from hydrotwin.models.language.writing import printable
from hydrotwin.records.between import between

from .acceptance import acceptance_data, acceptance_sections, verdict
from .answer import answer, facts, winners
from .comparison_figures import error_bar_groups, overlay_groups, peak, plan
from .comparison_tables import (
    band_table,
    domain_table,
    explained_table,
    failure_table,
    headline,
    residual_tables,
    run_times,
    score_tables,
    start_table,
    unscored_table,
)
from .conditions import conditions_section
from .copies import copies
from .field_tables import field_section
from .figure import styles
from .fit import fit_section, fit_warning, parameter_rows
from .format import number_text, shown_unit
from .page import Note, Page, Section, write_page
from .provenance import command_line, provenance_section, used, versions
from .written import forget_others


def write_report(
    comparison: Comparison,
    out_dir: str | Path,
    *,
    fits: Iterable = (),
    sections: Iterable[Section] = (),
    accepted: Acceptance | None = None,
    says: Sequence[str] = (),
    command: str | None = None,
    date: datetime | None = None,
) -> dict[str, Path]:
    """Write report.html, report.md and compare.json into ``out_dir``; the paths by "html", "markdown", "json".

    fits : Fit objects whose parameters and residuals get a section each.
    sections : further sections, put before the provenance.
    accepted : whether it is good enough, said first. says : sentences in place of which model is best.
    command : as printed under provenance; by default the running command.
    Pages of variants that an earlier run left below the folder are removed.
    """
    page = comparison_page(
        comparison, fits=fits, sections=sections, accepted=accepted, says=says, command=command, date=date
    )
    paths = write_page(page, out_dir, data_name="compare.json")
    forget_others(Path(out_dir))
    return paths


def comparison_page(
    comparison: Comparison,
    *,
    fits: Iterable = (),
    sections: Iterable[Section] = (),
    accepted: Acceptance | None = None,
    says: Sequence[str] = (),
    command: str | None = None,
    date: datetime | None = None,
) -> Page:
    """The page of a comparison, not yet written."""
    fits = list(fits)
    date = date or datetime.now().astimezone()
    command = command_line() if command is None else command
    shown, look = display_units(comparison), styles(comparison.models)
    made = (
        *(acceptance_sections(accepted, shown) if accepted else ()),
        conditions_section(comparison, shown, look),
        _plots(comparison, shown, look),
        _error_bars(comparison, shown, look),
        *(_scores(comparison, shown, look, mode) for mode in comparison.modes),
        _starts(comparison, look),
        field_section(comparison, shown, look),
        _bands(comparison, look),
        _left(comparison, look),
        *(fit_section(f, id="fit" if k == 0 else f"fit-{k + 1}") for k, f in enumerate(fits)),
        Section("run-time", "Run time", (run_times(comparison, look),)),
        _domain(comparison, look),
        _missing(comparison, look),
        *sections,
        provenance_section(comparison, command, date),
    )
    return Page(
        title=comparison.title,
        eyebrow=_eyebrow(comparison, date),
        answer=" ".join([*(verdict(accepted) if accepted else ()), *(says or [answer(comparison, shown)])]),
        facts=facts(comparison, shown),
        notices=notices(comparison) + tuple(w for w in map(fit_warning, fits) if w),
        headline=headline(comparison, shown, look),
        sections=tuple(s for s in made if s.parts),
        data=comparison_data(comparison, fits, command, date) | acceptance_data(accepted),
    )


def display_units(comparison: Comparison) -> dict[str, str]:
    """The unit each output is shown in: that of the recordings' files, else what engineers read."""
    found = {}
    for signal in comparison.outputs:
        files = (r.display_units.get(signal.name) for r in comparison.records)
        preferred = next((u for u in files if u and u != signal.unit), None)
        found[signal.name] = shown_unit(signal.unit, preferred=preferred, peak=peak(comparison, signal))
    return found


def comparison_data(comparison: Comparison, fits: Iterable, command: str, date: datetime) -> dict:
    """What compare.json holds besides the tables, see `schema`: every number in SI at full precision."""
    return {
        "format": FORMAT,
        "created": date.isoformat(timespec="seconds"),
        "command": command,
        "versions": versions(),
        "modes": comparison.modes,
        "best": [asdict(w) for w in winners(comparison)],
        "models": [_entrant(e) for e in comparison.entrants],
        "recordings": [_recording(r, role) for r, role in used(comparison.records, comparison.train_records)],
        "scores": [asdict(s) for s in comparison.scores],
        "means": [asdict(s) for s in comparison.means],
        "run_time": [asdict(t) for t in comparison.timings],
        "failures": [asdict(f) for f in comparison.failures],
        "unscored": [asdict(u) for u in comparison.unscored],
        "domain": [asdict(d) for d in comparison.domains],
        "residuals": [asdict(r) for r in comparison.residuals],
        "starts": [{"model": s.model, **asdict(s.estimate)} for s in comparison.starts],
        "fits": [_fit(f) for f in fits],
    }


def _plots(comparison: Comparison, shown: Mapping[str, str], look) -> Section:
    plotted = plan(comparison)[1]
    lead = (
        "The error below each plot is model minus measurement; errors over ten times the smallest may leave its axis. "
        "Drag to zoom, double-click to reset, click a name to hide it. All numbers come from the full recordings, and "
        "the curves keep every peak."
    )
    if any(t.deviation for t in comparison.trajectories):
        lead += " Pale: the 95\u00a0% band of a model, about its curve and about its error."
    if copies(comparison):
        lead += " An FMU that gives what its model gives lies on it: click its name to see it."
    if len(plotted) < len(comparison.records):
        lead += f" The first {len(plotted)} of {len(comparison.records)} recordings are drawn."
    return Section("plots", "Measured and predicted", tuple(overlay_groups(comparison, shown, look)), lead)


def _error_bars(comparison: Comparison, shown: Mapping[str, str], look) -> Section:
    lead = "Dot: mean error. Thick bar: plus and minus one standard deviation. Thin line: smallest and largest error. "
    lead += "Models with errors over ten times the smallest may leave the axis: double-click to see all."
    return Section("error-bars", "Error bars", tuple(error_bar_groups(comparison, shown, look)), lead)


def _scores(comparison: Comparison, shown: Mapping[str, str], look, mode: str) -> Section:
    how = "inputs and the start only" if mode == FREE_RUN else "each sample predicted from the measurement one before"
    lead = f"{mode.capitalize()}: {how}."
    if len(comparison.records) > 1:
        lead += f" Means over the {len(comparison.records)} recordings (the maximum is the largest of all), best first."
    lead += " MAE is what Eq. 18 of the C-EHA paper calls RMSE. Fit is 100 (1 − ‖e‖ / ‖y − mean y‖)\u00a0%."
    tables = tuple(score_tables(comparison, shown, look, mode))
    return Section(f"scores-{mode.replace(' ', '-')}", f"Scores, {mode}", tables, lead)


def _starts(comparison: Comparison, look) -> Section:
    found = start_table(comparison, look)
    lead = (
        "Start states of physical models, estimated from the first part of each recording and from nothing after it. "
        "The first part is among the scored samples. ± is one standard deviation, as far as nothing is missing in a "
        "model. One step ahead the runs start there, too."
    )
    others = tuple(starts_told([s for s in comparison.starts if not s.estimate.states]))
    parts = (*((found,) if found else ()), *((Note(others),) if others else ()))
    return Section("starts", "Where the runs start", parts, lead)


def _bands(comparison: Comparison, look) -> Section:
    found = band_table(comparison, look)
    lead = (
        "What the 95\u00a0% bands of the free runs are made of. Sensitivities: the covariance of identified parameters "
        "through each run, sensors and what the fit left. Own: a deviation that the model gives itself. Conformal: one "
        "width, from the misses on what was held out of the training. A band is trusted where it held there, or where "
        "a fit left only noise; of a band that was never judged the page says so."
    )
    return Section("bands", "The bands", (found,) if found else (), lead)


def _left(comparison: Comparison, look) -> Section:
    lead = (
        "Free run. Explained is the share of the measured variance. White noise has about 95\u00a0% of its first "
        "lags inside the noise band: nothing is left to model. Else the tables name what the error follows."
    )
    summary = explained_table(comparison, look)
    parts = (summary, *residual_tables(comparison, look)) if summary else ()
    return Section("residuals", "What is left unexplained", parts, lead)


def _domain(comparison: Comparison, look) -> Section:
    found = domain_table(comparison, look)
    lead = (
        "Share of the samples that lie in the box of values seen in training. Outside it a learned model extrapolates."
    )
    return Section("domain", "Training domain", (found,) if found else (), lead)


def _missing(comparison: Comparison, look) -> Section:
    parts = tuple(t for t in (failure_table(comparison, look), unscored_table(comparison, look)) if t)
    return Section("missing", "Not in the scores", parts)


def _eyebrow(comparison: Comparison, date: datetime) -> str:
    seconds = sum(r.duration for r in comparison.records)
    models, records = len(comparison.models), len(comparison.records)
    return (
        f"{models} model{'s' * (models != 1)} · {records} recording{'s' * (records != 1)} · "
        f"{number_text(seconds, 3)} s · {date:%-d %B %Y}"
    )


def _entrant(entrant) -> dict:
    return {
        "name": entrant.name,
        "kind": entrant.kind,
        "inputs": {s.name: s.unit for s in entrant.inputs},
        "outputs": {s.name: s.unit for s in entrant.outputs},
        "between_samples": between(entrant.inputs),
        "parameters": {p.name: {"value": p.value, "unit": p.unit, "sigma": p.sigma} for p in entrant.parameters},
        "provenance": dict(entrant.provenance),
        "bands": {b.output: _band(b) for b in entrant.bands},
    }


def _band(band) -> dict:
    return {k: v for k, v in asdict(band).items() if k != "output"}


def _recording(record, role: str) -> dict:
    return {
        "name": record.name,
        "role": role,
        "tags": dict(record.tags),
        "file": printable(Path(str(record.source)).name) if record.source else None,
        "sha256": record.digest,
        "seconds": record.duration,
        "samples": len(record.time),
        "period": record.period,
        "signals": as_read(record),
    }


def _fit(fit) -> dict:
    return {
        "name": fit.name,
        "parameters": [asdict(r) for r in parameter_rows(fit)],
        "noise": dict(fit.noise),
        "cost": fit.cost,
        "chi2": fit.chi2,
        "chi2_per_dof": getattr(fit, "chi2_per_dof", None),
        "accuracy": fit.accuracy.as_data() if getattr(fit, "accuracy", None) else None,
        "residuals": [_residual(r) for r in getattr(fit, "residuals", ())],
        "recordings": [{"name": r.name, "role": r.role} for r in getattr(fit, "records", ())],
        "findings": [str(f) for f in fit.findings],
        "seconds": fit.seconds,
    }


def _residual(residual) -> dict:
    names = ("output", "record", "role", "rmse", "noise", "unit", "samples", "chi2_per_sample", "lag_one", "white")
    return {name: getattr(residual, name) for name in names}
