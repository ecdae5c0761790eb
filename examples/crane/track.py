"""Drive the tip of the crane around a circle without feedback: ``python examples/crane/track.py [--out FOLDER]``.

It records staircases on the plant, learns and identifies inverses from them, drives the circle with each, prints the
error of the tip and writes track.html. ``--forward boom=FILE --forward jib=FILE`` adds the inverses of learned blocks
(current -> velocity or stroke), such as a Gaussian process or a grey box.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from examples.crane import inverses, kinematics  # noqa: E402
from examples.crane.model import plant  # noqa: E402
from examples.crane.rehearsal import AXES, PERIOD, recordings, steady_points  # noqa: E402
from hydrotwin.learned import read_block  # noqa: E402
from hydrotwin.models.language.errors import HydrotwinError  # noqa: E402
from hydrotwin.records import Record  # noqa: E402
from hydrotwin.simulation import Block, simulate  # noqa: E402

CIRCLE = kinematics.Circle()
PAPER = 6.85  # cm, root mean square, on a real loader crane: IEEE RA-L 7 (2022), Fig. 8


@dataclass(frozen=True)
class Way:
    """One way to drive: inverses by axis, seconds of lead by axis, half widths of the play by axis."""

    name: str
    currents: Mapping[str, inverses.Currents]
    lead: Mapping[str, float]
    half_width: Mapping[str, float]


@dataclass(frozen=True)
class Track:
    """The path of the tip (n, 2) [m], and how far it is from the wanted place [m]."""

    way: str
    place: np.ndarray
    error: np.ndarray

    @property
    def mean(self) -> float:
        return float(self.error.mean())

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def largest(self) -> float:
        return float(self.error.max())


def instants(circle: kinematics.Circle = CIRCLE) -> np.ndarray:
    """Sample times [s]: the circle, with a second of rest before and after."""
    return PERIOD * np.arange(round((circle.duration + 2 * circle.before) / PERIOD) + 1)


def commands(way: Way, circle: kinematics.Circle = CIRCLE) -> np.ndarray:
    """Currents (n, 2) for the circle: the inverse of the wanted velocity, ``lead`` seconds ahead, play made good."""
    time, columns = instants(circle), []
    for k, axis in enumerate(AXES):
        ahead = time + way.lead[axis]
        v = kinematics.cylinder_velocities(circle, ahead)[:, k]
        strokes = kinematics.strokes(kinematics.joint_angles(circle.place(ahead)))
        u = np.where(v == 0, 0.0, way.currents[axis](v, strokes))
        columns.append(np.clip(u + way.half_width[axis] * _direction(u), -1, 1))
    return np.column_stack(columns)


def _direction(u: np.ndarray) -> np.ndarray:
    """+1 while a command rises, -1 while it falls, the last of these while it stays; 0 before it first moves."""
    step = np.sign(np.diff(u, append=u[-1]))
    moved = np.maximum.accumulate(np.where(step != 0, np.arange(len(u)), -1))
    return np.where(moved < 0, 0.0, step[moved])


def drive(machine, way: Way, circle: kinematics.Circle = CIRCLE) -> Track:
    """The tip of ``machine`` under the commands of a way, from the start of the circle."""
    time, first = instants(circle), kinematics.joint_angles(circle.place(np.zeros(1)))[0]
    names = [f"{axis}_current" for axis in AXES]
    record = Record(time, dict(zip(names, commands(way, circle).T, strict=True)), dict.fromkeys(names, "1"), way.name)
    run = simulate(machine, record, start={"links.boom_angle": first[0], "links.jib_angle": first[1]})
    place = kinematics.tip(run.array(["boom_angle", "jib_angle"]))
    return Track(way.name, place, np.linalg.norm(place - circle.place(time), axis=1))


def ways(machine, *, quick: bool = False, forward: Mapping[str, Block] | None = None, seed: int = 0) -> list[Way]:
    """Every way that the staircases on ``machine`` give, and one more for learned ``forward`` blocks by axis.

    quick : without what is trained (networks, processes, grey box, identified model). seed : of the staircases.
    """
    records = {axis: recordings(machine, axis, seed=seed) for axis in AXES}
    points = {axis: steady_points(records[axis], axis) for axis in AXES}
    curves = {axis: inverses.curve(points[axis], axis) for axis in AXES}
    late = {axis: inverses.lateness(records[axis], axis, curves[axis]) for axis in AXES}
    none = dict.fromkeys(AXES, 0.0)

    def of(make) -> dict[str, inverses.Currents]:
        return {axis: make(axis) for axis in AXES}

    both = {axis: inverses.loaded_valve(points[axis], axis) for axis in AXES}
    play = {axis: max(both[axis].half_width, 0.0) for axis in AXES}
    table = of(lambda axis: inverses.learned(curves[axis], axis))
    played = of(lambda axis: inverses.learned(inverses.curve(points[axis], axis, play[axis]), axis))
    loaded = {axis: inverses.loaded_valve(points[axis], axis, with_play=False) for axis in AXES}
    found = [
        Way("straight line", of(lambda axis: inverses.straight_line(points[axis])), none, none),
        Way("straight line, dead time", of(lambda axis: inverses.straight_line(points[axis])), late, none),
        Way("table", table, none, none),
        Way("table, dead time", table, late, none),
        Way("table, dead time, play", played, late, play),
    ]
    if not quick:
        found += [Way(f"{name}, dead time", currents, late, none) for name, currents in _slow(records, curves).items()]
    found += [
        Way("valve under load, dead time", of(lambda axis: loaded[axis].currents), late, none),
        Way("valve under load, dead time, play", of(lambda axis: both[axis].currents), late, play),
    ]
    if forward:
        given = of(lambda axis: inverses.learned_from_block(forward[axis], axis))
        found.append(Way("given blocks, dead time", given, late, none))
    return found


def _slow(records, curves) -> dict[str, dict[str, inverses.Currents]]:
    """The inverses that take seconds to train; those that need PyTorch or GPyTorch only where these are there."""
    dual = cache(lambda axis: inverses.dual_process(records[axis], axis))
    makers = {
        "grey box": lambda axis: inverses.learned_from_block(inverses.grey_box(records[axis], axis), axis),
        "identified model": lambda axis: inverses.identified(records[axis], axis)[1],
    }
    if find_spec("torch"):
        makers["network"] = lambda axis: inverses.learned(curves[axis], axis, method="network")
    if find_spec("torch") and find_spec("gpytorch"):
        makers["dual GP"] = lambda axis: inverses.learned_from_block(dual(axis), axis)
        makers["dual GP and network"] = lambda axis: inverses.learned_from_block(dual(axis), axis, method="network")
    return {name: {axis: make(axis) for axis in AXES} for name, make in makers.items()}


def figure(tracks: list[Track], circle: kinematics.Circle = CIRCLE) -> dict:
    """Paths of the tip over the wanted circle, and the errors over time, as a Plotly specification."""
    from hydrotwin.report.figure import MEASURED, layout, line, styles

    time, look = instants(circle), styles([t.way for t in tracks])
    wanted = circle.place(time)
    data = [line(time, np.zeros_like(time), "wanted", MEASURED, dash="dot")]
    for t in tracks:
        data.append(line(time, 100 * t.error, t.way, look[t.way].colour, dash=look[t.way].dash, hidden=t.rms > 0.3))
    plan = layout("time [s]", ["error of the tip [cm]"], height=760)
    plan["yaxis"]["domain"], plan["xaxis"]["domain"] = [0.0, 0.3], [0.0, 1.0]
    plan["xaxis2"] = {"title": {"text": "x [m]"}, "domain": [0.0, 1.0], "anchor": "y2"}
    plan["yaxis2"] = {"title": {"text": "y [m]"}, "domain": [0.4, 1.0], "anchor": "x2", "scaleanchor": "x2"}
    plan["hovermode"] = "closest"
    for name, place in [("wanted", wanted), *((t.way, t.place) for t in tracks)]:
        colour = look[name].colour if name in look else MEASURED
        data.append({
            "type": "scatter", "mode": "lines", "name": name, "legendgroup": name, "showlegend": False,
            "x": place[::5, 0].round(4).tolist(), "y": place[::5, 1].round(4).tolist(), "xaxis": "x2", "yaxis": "y2",
            "line": {"color": colour, "dash": "dot" if name == "wanted" else look[name].dash, "width": 1.6},
        })  # fmt: skip
    return {"data": data, "layout": plan}


def write_figure(tracks: list[Track], path: Path, circle: kinematics.Circle = CIRCLE) -> None:
    """The figure as a page that needs no network."""
    import plotly.graph_objects as go

    path.parent.mkdir(parents=True, exist_ok=True)
    go.Figure(figure(tracks, circle)).write_html(path, include_plotlyjs=True)


def told(tracks: list[Track]) -> str:
    """The table: error of the tip in cm."""
    rows = [f"{'way':36}{'mean':>8}{'rms':>8}{'max':>8}   cm"]
    rows += [f"{t.way:36}{100 * t.mean:8.2f}{100 * t.rms:8.2f}{100 * t.largest:8.2f}" for t in tracks]
    return "\n".join([*rows, f"{'the paper, on a real crane':36}{'':8}{PAPER:8.2f}"])


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/crane"), help="folder of track.html")
    parser.add_argument("--forward", action="append", default=[], metavar="AXIS=FILE", help="learned forward block")
    parser.add_argument("--quick", action="store_true", help="without what takes long to train")
    parser.add_argument("--seed", type=int, default=0, help="of the staircases: other levels, other noise")
    parser.add_argument("--payload", type=float, help="kg at the tip while it tracks; the rehearsal had 100")
    asked = parser.parse_args(arguments)
    files = dict(item.split("=", 1) for item in asked.forward)
    if files and set(files) != set(AXES):
        parser.error(f"--forward is needed for each of {', '.join(AXES)} (got {', '.join(files)})")
    try:
        report(asked, files)
    except HydrotwinError as error:
        parser.exit(1, f"{error}\n")


def report(asked: argparse.Namespace, files: Mapping[str, str]) -> None:
    """Learn, drive, print the table and write the figure."""
    blocks = {axis: read_block(path) for axis, path in files.items()}
    print("staircases, learning and identifying" + ("" if asked.quick else ": about a minute"), flush=True)
    found = ways(plant(), quick=asked.quick, forward=blocks, seed=asked.seed)
    tracks = [drive(plant(asked.payload), way) for way in found]
    print(told(tracks))
    write_figure(tracks, asked.out / "track.html")
    print(f"wrote {asked.out / 'track.html'}")


if __name__ == "__main__":
    main()
