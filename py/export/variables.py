"""The variables of an FMU and what depends on what: one table from which C, XML and documentation are written.

The place in the table is the value reference; the C runtime keeps its values in the same order.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca

from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.units import DELTA, display_units, is_difference, si_unit

from .lower import Lowered

_STRUCTURED = re.compile(r"[A-Za-z_]\w*(\[\d+\])?(\.[A-Za-z_]\w*(\[\d+\])?)*", re.ASCII)


@dataclass(frozen=True)
class Variable:
    """One row: all FMU variables of hydrotwin are real numbers in SI.

    kind : input, parameter, start, output, state, derivative or time.
    depends : value references of the inputs, states and time it follows from while running; None: not an unknown.
    starts_from : value references of the inputs and parameters it follows from at the start.
    of : value reference of the state whose derivative this is.
    measured_by, restarts_from : of a start parameter, see ``output`` and ``measured`` of `StartParameter`.
    written_in : the unit in which the model declares it; "" for SI.
    """

    name: str
    kind: str
    unit: str
    description: str = ""
    start: float | None = None
    nominal: float | None = None
    bounds: tuple[float, float] = (-math.inf, math.inf)
    depends: tuple[int, ...] | None = None
    starts_from: tuple[int, ...] | None = None
    of: int | None = None
    measured_by: str | None = None
    restarts_from: str | None = None
    written_in: str = ""

    @property
    def shown(self) -> str:
        """The unit in which to show it. A ratio may be no share, and of kelvins nobody knows whether they are from a
        zero or a difference, unless it is declared so."""
        return self.written_in.removeprefix(DELTA) or (
            self.unit if self.unit in ("1", "K") else display_units(self.unit)[0]
        )

    @property
    def difference(self) -> bool:
        """Whether it is declared as a difference, delta_degC, so that the zero of the unit it is shown in is none."""
        return is_difference(self.written_in)

    @property
    def structured(self) -> bool:
        """Whether the name follows the structured naming convention."""
        inner = self.name[4:-1] if self.kind == "derivative" else self.name
        return _STRUCTURED.fullmatch(inner) is not None


def variables_of(lowered: Lowered, *, always_time: bool = False) -> tuple[Variable, ...]:
    """The table, in the order of the value references. Raises DeclarationError when two would have one name.

    always_time : list the time even where the equations do not read it (FMI 3 demands it).
    """
    names = _state_names(lowered)
    sizes = [len(lowered.inputs), len(lowered.parameters), len(lowered.starts), len(lowered.outputs)]
    first_state = sum(sizes)
    depends = _Dependencies(lowered, first_state)
    rows = [
        *(
            Variable(s.name, "input", s.unit, s.description, s.default, s.nominal, written_in=s.written_in)
            for s in lowered.inputs
        ),
        *(
            Variable(
                p.name, "parameter", p.unit, _parameter_text(p), p.value, p.nominal, p.bounds, written_in=p.written_in
            )
            for p in lowered.parameters
        ),
        *(
            Variable(
                s.name,
                "start",
                s.unit,
                s.description,
                s.value,
                s.nominal,
                s.bounds,
                measured_by=s.output,
                restarts_from=s.measured,
                written_in=s.written_in,
            )
            for s in lowered.starts
        ),
        *(
            Variable(
                s.name,
                "output",
                s.unit,
                s.description,
                nominal=s.nominal,
                written_in=s.written_in,
                **depends.of_output(k),
            )
            for k, s in enumerate(lowered.outputs)
        ),
        *(
            Variable(
                n, "state", s.unit, s.description, nominal=s.nominal, written_in=s.written_in, **depends.of_state(k)
            )
            for k, (n, s) in enumerate(zip(names, lowered.states, strict=True))
        ),
    ]
    if not lowered.sampled:
        rows += [
            Variable(
                f"der({n})", "derivative", si_unit(f"{_factor(s.unit)}/s"), f"rate of {n}",
                of=first_state + k, **depends.of_rate(k),
            )
            for k, (n, s) in enumerate(zip(names, lowered.states, strict=True))
        ]  # fmt: skip
    if depends.on_time or always_time:
        rows.append(Variable("time", "time", "s", "simulation time"))
    _check_names(lowered.name, rows)
    return tuple(rows)


def _state_names(lowered: Lowered) -> list[str]:
    """Names of the states; ``state.`` in front where an output or input has taken the name."""
    taken = {s.name for s in (*lowered.inputs, *lowered.outputs)}
    return [f"state.{s.name}" if s.name in taken else s.name for s in lowered.states]


def _factor(unit: str) -> str:
    """A unit that can stand before ``/s``: ``m/s`` becomes ``m/s``'s product form."""
    return "1" if unit == "%" else f"({unit})" if "/" in unit else unit


def _parameter_text(p) -> str:
    known = [p.description or p.name]
    if p.sigma is not None:
        known.append(f"sigma {p.sigma:.3g} {p.unit}")
    if p.source:
        known.append(f"source: {p.source}")
    return "; ".join(known)


def _check_names(model: str, rows: Iterable[Variable]):
    seen: dict[str, str] = {}
    for row in rows:
        if row.name in seen:
            raise DeclarationError(
                f"{model}: two variables of the FMU would be called '{row.name}' ({seen[row.name]} and {row.kind}). "
                "Names must be unique. Rename one of them in the model."
            )
        seen[row.name] = row.kind


class _Dependencies:
    """Reads the sparsity of the lowered functions."""

    def __init__(self, lowered: Lowered, first_state: int):
        self.lowered, self.first_state = lowered, first_state
        self.time = first_state + len(lowered.states) * (1 if lowered.sampled else 2)
        output = lowered.functions["output"]
        y = output.index_out("y")
        self.rows = {"y": {n: _rows(output, y, n) for n in output.name_in()}}
        if not lowered.sampled:
            self.rows["xdot"] = {n: _rows(output, output.index_out("xdot"), n) for n in output.name_in()}
        start = lowered.functions["start"]
        self.start = {n: _rows(start, 0, n) for n in start.name_in()}

    @property
    def on_time(self) -> bool:
        """Whether the equations read the time; only then it must be a variable of the FMU."""
        return any(rows["t"] for rows in self.rows.values())

    def of_output(self, k: int) -> dict:
        """``depends`` and ``starts_from`` of output k."""
        return {"depends": self._running("y", k), "starts_from": self._starting("y", k)}

    def of_rate(self, k: int) -> dict:
        """``depends`` and ``starts_from`` of the derivative of state k."""
        return {"depends": self._running("xdot", k), "starts_from": self._starting("xdot", k)}

    def of_state(self, k: int) -> dict:
        """``starts_from`` of state k."""
        return {"starts_from": tuple(sorted(self._state_start(k)))}

    def _running(self, what: str, k: int) -> tuple[int, ...]:
        found = {j for j in self.rows[what]["u"].get(k, ()) if not self._always_late(j)}
        if not self.lowered.sampled:
            found |= {self.first_state + j for j in self.rows[what]["x"].get(k, ())}
        return tuple(sorted(found | self._by_time(what, k)))

    def _starting(self, what: str, k: int) -> tuple[int, ...]:
        nu = len(self.lowered.inputs)
        found = set(self.rows[what]["u"].get(k, ())) | {nu + j for j in self.rows[what]["p"].get(k, ())}
        for j in self.rows[what]["x"].get(k, ()):
            found |= self._state_start(j)
        return tuple(sorted(found | self._by_time(what, k)))

    def _state_start(self, k: int) -> set[int]:
        nu, np_ = len(self.lowered.inputs), len(self.lowered.parameters)
        return (
            set(self.start["u"].get(k, ()))
            | {nu + j for j in self.start["p"].get(k, ())}
            | {nu + np_ + j for j in self.start["z"].get(k, ())}
        )

    def _by_time(self, what: str, k: int) -> set[int]:
        return {self.time} if self.rows[what]["t"].get(k) else set()

    def _always_late(self, j: int) -> bool:
        """Whether input j acts only after a dead time that cannot be zero."""
        place = self.lowered.dead_times[j]
        return place >= 0 and self.lowered.parameters[place].bounds[0] > 0


def _rows(f: ca.Function, result: int, argument: str) -> dict[int, list[int]]:
    """Per row of a result the entries of an argument it depends on."""
    found: dict[int, list[int]] = {}
    for row, column in zip(*f.jac_sparsity(result, f.index_in(argument)).get_triplet(), strict=True):
        found.setdefault(int(row), []).append(int(column))
    return found
