"""The page of a characteristic turned round: steady points, what was learnt, the inverse, the compensated machine."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import numpy as np

from hydrotwin.learned import Characteristic, LearnedBlock
from hydrotwin.learned.report_card import card_of
from hydrotwin.models.language.flat import Signal
from hydrotwin.simulation.block import Block

from .figure import MEASURED, PALETTE, Figure, layout, line, packed
from .format import number_text, pretty_unit, shown_unit, to_shown
from .page import Page, Section, write_page
from .provenance import command_line, made_table
from .tables import Table, numbers, texts

POINTS = 801  # of a curve
WIDTH = 1.96  # standard deviations of a 95 % band


def write_characteristic(
    forward: Characteristic,
    folder: str | Path,
    *,
    inverse: LearnedBlock | None = None,
    compensator: LearnedBlock | None = None,
    desired: Callable[[np.ndarray], np.ndarray] | None = None,
    machine: object = None,
) -> dict[str, Path]:
    """Write characteristic.html, .md and .json; the paths by "html", "markdown", "json".

    inverse : wanted rate -> command. compensator, desired : command -> command, and the rates (n,) [SI] it aims at.
    machine : where ``forward`` comes from; a Gaussian process of the rate is shown with its 95 % band.
    """
    figures, rows = [_forward_figure(forward, machine)], []
    if inverse is not None:
        wanted = np.linspace(inverse.domain.lower[0], inverse.domain.upper[0], POINTS)
        commands = _answers(inverse, wanted)[:, 0]
        figures.append(_inverse_figure(forward, wanted, commands))
        rows.append(("inverse", *_missed(forward, commands, wanted)))
    if compensator is not None:
        asked = np.linspace(compensator.domain.lower[0], compensator.domain.upper[0], POINTS)
        commands = _answers(compensator, asked)[:, 0]
        figures.append(_compensated_figure(forward, asked, commands, desired(asked)))
        rows.append(("compensator", *_missed(forward, commands, desired(asked))))
    points = "points" if "moving_points" in forward.source else "steady points"
    said = [*_cards(inverse, compensator), _told(rows, forward)]
    date, shown = datetime.now().astimezone(), _Shown(forward.rate, forward.rates)
    low, high = (number_text(float(v)) for v in shown.values(np.array(forward.reach)))
    page = Page(
        title=f"{_words(forward.rate)}: characteristic",
        eyebrow=f"{len(forward.commands)} {points} · {date:%-d %B %Y}",
        answer=said[0],
        facts=(f"Its {_words(forward.rate)} goes from {low} to {high} {shown.unit}.", *said[1:]),
        headline=_table(rows, forward.rate.unit, shown),
        sections=(
            Section("curves", "Curves", tuple(figures)),
            Section("provenance", "Provenance", (made_table(command_line(), date),)),
        ),
        data={"commands": forward.commands, "rates": forward.rates},
    )
    return write_page(page, folder, stem="characteristic", data_name="characteristic.json")


def _cards(*blocks: LearnedBlock | None) -> list[str]:
    """What the blocks' cards say of points that were left out."""
    return [card["says"] for block in blocks if block is not None and (card := card_of(block))]


class _Shown:
    """How a signal is shown: its unit and its values in it."""

    def __init__(self, signal: Signal, values: np.ndarray):
        self._from, self.plain = signal.unit, shown_unit(signal.unit, peak=float(np.abs(values).max()))
        self.unit = pretty_unit(self.plain)
        self.title = f"{_words(signal)} [{self.unit}]" if self.unit else _words(signal)

    def values(self, values: np.ndarray) -> np.ndarray:
        return to_shown(values, self._from, self.plain)


def _words(signal: Signal) -> str:
    """``wanted_position_rate`` as it is read."""
    return signal.name.removeprefix("wanted_").replace("_", " ")


def _answers(block: Block, inputs: np.ndarray) -> np.ndarray:
    """Outputs (n, ny) of a block whose only input is held at each of (n,) values from the start."""
    p, zero = block.parameter_vector(), np.zeros(len(block.outputs))
    return np.array([block.step(block.start([u], zero, p), [u], p)[1].full().ravel() for u in inputs])


def _points(x: np.ndarray, y: np.ndarray, name: str) -> dict:
    style = {"color": MEASURED, "size": 5, "opacity": 0.6}
    return {"type": "scatter", "mode": "markers", "name": name, "x": packed(x), "y": packed(y), "marker": style}


def _forward_figure(forward: Characteristic, machine) -> Figure:
    """Fig. 5 of the dual-GP paper: steady points, and what a process says of them."""
    command, rate = _Shown(forward.input, forward.commands), _Shown(forward.rate, forward.rates)
    data = [_points(command.values(forward.commands), rate.values(forward.rates), "steady points")]
    band = _band(forward, machine)
    caption = "The steady answer to held commands."
    if band is not None:
        at, mean, deviation = band
        x, low, high = command.values(at), rate.values(mean - WIDTH * deviation), rate.values(mean + WIDTH * deviation)
        edge = {"type": "scatter", "mode": "lines", "x": packed(x), "hoverinfo": "skip", "line": {"width": 0}}
        fill = {"fill": "tonexty", "fillcolor": "rgba(0,114,178,0.2)", "name": "95 %"}
        data += [edge | {"y": packed(low), "showlegend": False}, edge | {"y": packed(high)} | fill]
        data.append(line(x, rate.values(mean), "mean of the process", PALETTE[0], points=POINTS))
        caption = "Mean and 95 % band of the process where its only input is held, and the steady points taken from it."
    look = layout(command.title, [rate.title]) | {"hovermode": "closest"}
    return Figure("forward", "characteristic", {"data": data, "layout": look}, caption)


def _band(forward: Characteristic, machine) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Commands, mean rate and its standard deviation (n,) of a process of one input; None for anything else."""
    names = [s.name for s in machine.outputs] if isinstance(machine, Block) and len(machine.inputs) == 1 else []
    rate = next((n for n in names if n.endswith(".slope") and f"{n}.sd" in names), None)
    if rate is None:
        return None
    at = np.linspace(forward.commands[0], forward.commands[-1], POINTS)
    answers = _answers(machine, at)
    return at, answers[:, names.index(rate)], answers[:, names.index(f"{rate}.sd")]


def _inverse_figure(forward: Characteristic, wanted: np.ndarray, commands: np.ndarray) -> Figure:
    """Fig. 6: the command for a wanted rate, over the steady points with their axes changed."""
    command, rate = _Shown(forward.input, forward.commands), _Shown(forward.rate, forward.rates)
    data = [
        _points(rate.values(forward.rates), command.values(forward.commands), "steady points"),
        line(rate.values(wanted), command.values(commands), "inverse", PALETTE[1], points=POINTS),
    ]
    look = layout(f"wanted {rate.title}", [command.title]) | {"hovermode": "closest"}
    return Figure("inverse", "inverse", {"data": data, "layout": look}, "It never falls: checked on 20,001 points.")


def _compensated_figure(forward: Characteristic, asked: np.ndarray, commands: np.ndarray, aim: np.ndarray) -> Figure:
    """Fig. 7: the machine's own curve, the one that was designed, and the machine behind the compensator."""
    command, rate = _Shown(forward.input, forward.commands), _Shown(forward.rate, forward.rates)
    x = command.values(asked)
    data = [
        _points(command.values(forward.commands), rate.values(forward.rates), "machine alone"),
        line(x, rate.values(aim), "designed", PALETTE[2], points=POINTS, dash="dash", width=2.4),
        line(x, rate.values(_rates(forward, commands)), "with compensator", PALETTE[1], points=POINTS),
    ]
    look = layout(command.title, [rate.title]) | {"hovermode": "closest"}
    return Figure("compensator", "compensator", {"data": data, "layout": look}, "From the steady points, not driven.")


def _rates(forward: Characteristic, commands: np.ndarray) -> np.ndarray:
    """Steady rates (n,) at commands (n,): between the points, the mean of those at one command."""
    at, index = np.unique(forward.commands, return_inverse=True)
    mean = np.bincount(index, forward.rates) / np.bincount(index)
    return np.interp(commands, at, mean)


def _missed(forward: Characteristic, commands: np.ndarray, wanted: np.ndarray) -> tuple[float, float]:
    """RMS and largest difference [SI] between the rates of commands (n,) and those wanted (n,)."""
    error = _rates(forward, commands) - wanted
    return float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())


def _told(rows, forward: Characteristic) -> str:
    shares = [(what, rms / np.ptp(forward.rates)) for what, rms, _ in rows]
    errors = [f"behind the {what} it misses what is wanted by {100 * share:.2g} % of it" for what, share in shares]
    return (
        f"By the points it was learnt from, over the whole range, {'; '.join(errors)} (RMS)."
        if errors
        else "The steady answer to held commands."
    )


def _table(rows, unit: str, shown: _Shown) -> Table:
    columns = (
        texts("what", "Behind the", [row[0] for row in rows]),
        numbers("rms", "RMS error", [row[1] for row in rows], unit, shown.plain),
        numbers("largest", "Largest error", [row[2] for row in rows], unit, shown.plain),
    )
    return Table("errors", "", columns, note="Of the rate, over the whole domain, by the points it was learnt from.")
