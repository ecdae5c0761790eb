"""The page of a linear model: poles, damping, the oil spring's frequency, and the Bode figure."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

import control
import numpy as np

from hydrotwin.models.language.linearisation import Mode, Modes

from .figure import PALETTE, Figure, FigureGroup, layout, line
from .format import pretty_unit
from .page import Page, Section, write_page
from .provenance import command_line, made_table
from .tables import Table, numbers, texts

FREQUENCIES = 600  # of the Bode figure
DECADES = 1.5  # below the slowest and above the fastest mode


def write_linearisation(
    system: control.StateSpace,
    found: Modes,
    folder: str | Path,
    *,
    units: Mapping[str, str],
    point: Mapping[str, float],
) -> dict[str, Path]:
    """Write linearisation.html, .md and .json of a linear model; the paths by "html", "markdown", "json".

    units : SI unit of every signal. point : the inputs and states (SI) it was linearised at.
    """
    place = ", ".join(f"{name} = {value:.4g} {units.get(name, '')}".rstrip() for name, value in point.items() if value)
    date = datetime.now().astimezone()
    page = Page(
        title=f"{system.name}: linear model",
        eyebrow=f"{system.nstates} states · {date:%-d %B %Y}",
        answer=answer(found),
        facts=(f"Linearised at {place or 'zero'}{'; all else is zero' if place else ''}.",),
        headline=mode_table(found),
        sections=(
            Section("bode", "Frequency response", (bode_group(system, found, units),)),
            Section("provenance", "Provenance", (made_table(command_line(), date),)),
        ),
        data={name: getattr(system, name) for name in "ABCD"}
        | {"inputs": system.input_labels, "outputs": system.output_labels, "states": system.state_labels}
        | {"modes": [_mode(m) for m in found.modes], "point": dict(point), "units": dict(units)},
    )
    return write_page(page, folder, stem="linearisation", data_name="linearisation.json")


def _mode(mode: Mode) -> dict:
    pole = {"real": mode.pole.real, "imaginary": mode.pole.imag}
    shares = dict(mode.participation)
    return {"pole": pole, "frequency": mode.frequency, "damping": mode.damping, "participation": shares}


def answer(found: Modes) -> str:
    """The oil spring in one sentence."""
    mode = found.hydraulic
    if mode is None:
        return "No oscillating mode takes part in the pressures: there is no oil spring to meet."
    return (
        f"The oil spring rings at {mode.frequency:.3g} Hz with a damping ratio of {mode.damping:.2g}"
        f"{': lightly damped, controllers must keep away from it' if mode.damping < 0.2 else ''}."
    )


def mode_table(found: Modes) -> Table:
    """One row a mode, slowest first."""
    rows = found.modes
    mostly = [", ".join(f"{n} {share:.0%}" for n, share in _most(m.participation)) for m in rows]
    return Table(
        "modes",
        "",
        (
            texts("states", "Mostly", mostly),
            numbers("frequency", "Natural frequency", [m.frequency for m in rows], "Hz", "Hz"),
            numbers("damping", "Damping ratio", [m.damping for m in rows]),
            numbers("real", "Pole, real part", [m.pole.real for m in rows], "rad/s", "rad/s"),
            numbers("imaginary", "Imaginary part", [m.pole.imag for m in rows], "rad/s", "rad/s"),
        ),
        note="An oscillating pair is one row. The share of each state is its participation.",
    )


def _most(participation: Mapping[str, float]):
    ordered = sorted(participation.items(), key=lambda pair: -pair[1])
    return [pair for pair in ordered if pair[1] > 0.15][:3]


def bode_group(system: control.StateSpace, found: Modes, units: Mapping[str, str]) -> FigureGroup:
    """Magnitude and phase from every input to every output, one tab each."""
    fast = [abs(m.pole) for m in found.modes if abs(m.pole) > 1e-6]
    low, high = (min(fast), max(fast)) if fast else (1.0, 100.0)
    omega = np.geomspace(low / 10**DECADES, high * 10**DECADES, FREQUENCIES)
    omega = np.unique(
        np.concatenate([omega, *(abs(m.pole) * np.linspace(0.9, 1.1, 41) for m in found.modes if m.oscillates)])
    )
    response = np.reshape(system(1j * omega, squeeze=False), (system.noutputs, system.ninputs, len(omega)))
    figures = []
    for i, source in enumerate(system.input_labels):
        for o, output in enumerate(system.output_labels):
            gain = pretty_unit(f"{units[output]}") + (
                f" per {pretty_unit(units[source])}" if units[source] != "1" else ""
            )
            figures.append(_bode(f"{output}-{source}", output, source, omega / (2 * np.pi), response[o, i], gain))
    return FigureGroup("bode-plots", "Bode", tuple(figures), "Hover for values, drag to zoom.")


def _bode(id: str, output: str, source: str, frequency, response, gain: str) -> Figure:
    magnitude = np.abs(response)
    phase = np.rad2deg(np.unwrap(np.angle(response)))
    count = len(frequency)
    upper = line(frequency, magnitude, "magnitude", PALETTE[0], points=count, legend=False)
    lower = line(frequency, phase, "phase", PALETTE[1], points=count, row=2, legend=False)
    look = layout("frequency [Hz]", [f"magnitude [{gain}]", "phase [°]"], height=520)
    look["xaxis"] |= {"type": "log"}
    look["yaxis"] |= {"type": "log", "exponentformat": "power"}
    return Figure(f"bode-{id}", output, {"data": [upper, lower], "layout": look}, row=f"from {source}")
