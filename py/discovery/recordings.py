"""Which recordings are learned from and which judge, and whether they can show anything at all.

The split is by recording: a sample's neighbours know too much about it. One lone recording is cut in time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from hydrotwin.identification.noise import output_noise, quanta
from hydrotwin.identification.problem import Recording, delays_filled, recordings, unbroken_for
from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.records import cuts, distinct, require_unseen

from .evidence.deciding import DECIDING

SHORTEST = 200  # samples of a recording that can tell effects apart
PIECES = 12  # of a lone recording of something that integrates
FIT_SHARE = 0.6  # of a lone recording of something that settles


@dataclass(frozen=True, eq=False)
class Split:
    """Recordings by role: ``train`` find the effect, ``report`` shows it."""

    train: tuple[Recording, ...]
    report: tuple[Recording, ...]
    noise: np.ndarray
    outputs: tuple[str, ...]
    findings: tuple[str, ...]

    def without(self, masks: Mapping[str, np.ndarray]) -> Split:
        """The same as if these samples, (n, ny) by name of the recording, had not been measured."""

        def cleaned(runs: tuple[Recording, ...]) -> tuple[Recording, ...]:
            unknown = {r.name: np.where(masks[r.name], np.nan, r.y) for r in runs if r.name in masks}
            return tuple(dataclasses.replace(r, y=unknown[r.name]) if r.name in unknown else r for r in runs)

        roles = {role: cleaned(getattr(self, role)) for role in ("train", "report")}
        return dataclasses.replace(self, **roles)


def split(
    flat: FlatModel,
    records: Sequence,
    validate: Sequence,
    outputs: Sequence[str] | None = None,
    noise: Mapping[str, float] | None = None,
) -> Split:
    """Sort recordings into roles.

    All are fitted to but those that validate, cut at their holes; a lone one is cut into pieces. Where one begins in
    motion, all start states are estimated.

    Raises
    ------
    DataError : nothing to fit to, one that judges what it taught, too few samples, an input that never moves, outputs
    that never move.
    """
    if not len(records):
        raise DataError(f"gap: no recording of {flat.name}. Give at least one, better three, and one to validate.")
    require_unseen(records, validate, [s.name for s in flat.outputs])
    lone = records[0].name if len(records) == 1 else None
    records, validate = (unbroken_for(flat, some) for some in distinct(records, validate))
    findings = [f"gap: {sentence}" for sentence in cuts([*records, *validate])]
    wanted, constant = _moving(flat, records, outputs)
    findings += [
        f"gap: output '{name}' is constant in every recording and says nothing. It is left out; record it in motion."
        for name in constant
    ]
    whole = recordings(flat, records, wanted, "record")
    _require_motion(flat, whole)
    train = whole if lone is None else _in_pieces(flat, lone, whole)
    report = recordings(flat, validate, wanted, "validation record") if len(validate) else ()
    if not report:
        findings.append(
            "gap: no validation recording: nothing here was kept from the search. Record another run with other "
            "commands and give it as --validate."
        )
    floor = output_noise(flat, train, noise)
    steps = quanta(train)
    findings += [
        f"gap: {o.name} is recorded in steps of {q:.3g} {o.unit} (quantisation of the sensor, or the digits of the "
        "file). They make most of its noise, and no effect is looked for below them."
        for o, q, s in zip(flat.outputs, steps, floor, strict=True)
        if q > DECIDING.coarse * s
    ]
    return Split(train, report, floor, tuple(wanted), tuple(findings))


def _in_pieces(flat: FlatModel, name: str, parts: tuple[Recording, ...]) -> tuple[Recording, ...]:
    """A lone recording, or its parts between holes, as several, each from its own start.

    What integrates drifts away in a free run, and a drift is worth a handful of samples: then the pieces are short.
    What settles by itself shows slow effects only in long runs: then they are two.
    """
    shares = [np.linspace(0, 1, 2)] * len(parts)
    if _integrates(flat, max(parts, key=lambda r: len(r.time))):
        samples = sum(len(r.time) for r in parts)
        shares = [np.linspace(0, 1, max(1, round(PIECES * len(r.time) / samples)) + 1) for r in parts]
    elif len(parts) == 1:
        shares = [np.array([0, FIT_SHARE, 1])]
    cuts_of = [(share * len(r.time)).astype(int) for r, share in zip(parts, shares, strict=True)]
    pieces = [(r, slice(a, b)) for r, edges in zip(parts, cuts_of, strict=True) for a, b in pairwise(edges)]
    cut = [_piece(r, at, f"{name} (part {k + 1})") for k, (r, at) in enumerate(pieces)]
    return tuple(delays_filled(flat, piece) for piece in cut)


def _integrates(flat: FlatModel, recording: Recording) -> bool:
    """Whether some mode of the model, linear around its start, does not settle within the recording."""
    t, x, u, p = (ca.SX.sym(n, flat.ode.size1_in(i)) for i, n in enumerate("txup"))
    slope = ca.Function("slope", [t, x, u, p], [ca.jacobian(flat.ode(t, x, u, p)[0], x)])
    values = flat.parameter_vector()
    start = flat.start_given()(recording.u[0], values, [])
    matrix = slope(0, start, recording.u[0], values).full()
    if not np.isfinite(matrix).all():
        return False
    return bool(np.any(np.abs(np.linalg.eigvals(matrix)) * (recording.time[-1] - recording.time[0]) < 1))


def _piece(recording: Recording, at: slice, name: str) -> Recording:
    return dataclasses.replace(
        recording,
        name=name,
        time=recording.time[at],
        u=recording.u[at],
        y=recording.y[at],
        in_motion=recording.in_motion or at.start > 0,
    )


def _moving(flat: FlatModel, records: Sequence, outputs: Sequence[str] | None) -> tuple[list[str], list[str]]:
    """Outputs that are recorded and move, and those that are recorded and do not."""
    known = [s.name for s in flat.outputs]
    for name in outputs or ():
        if name not in known:
            raise DeclarationError(f"{flat.name}: no output '{name}'. {nearest(name, known)}")
    wanted = [n for n in known if outputs is None or n in outputs]
    recorded = [n for n in wanted if any(n in r.signals and np.isfinite(r[n]).any() for r in records)]
    if not recorded:
        return wanted, []  # `recordings` says what is missing
    still = [n for n in recorded if not any(n in r.signals and _moves(r[n]) for r in records)]
    if len(still) == len(recorded):
        raise DataError(
            f"gap: every recorded output of {flat.name} is constant ({', '.join(still)}). Nothing moves. "
            "Record motion in both directions, at several speeds."
        )
    return [n for n in recorded if n not in still], still


def _moves(values: np.ndarray) -> bool:
    known = values[np.isfinite(values)]
    return bool(len(known) and np.ptp(known) > 0)


def _require_motion(flat: FlatModel, train: Sequence[Recording]) -> None:
    longest = max(train, key=lambda r: len(r.time))
    if sum(len(r.time) for r in train) < SHORTEST:
        raise DataError(
            f"gap: {longest.name} has {len(longest.time)} samples, the longest of all. Effects cannot be told apart "
            f"with less than {SHORTEST}. Record tens of seconds of motion in both directions."
        )
    if flat.inputs and all(np.ptp(r.u, axis=0).max() == 0 for r in train):
        raise DataError(
            f"gap: no input of {flat.name} ever moves ({', '.join(s.name for s in flat.inputs)}). "
            "Record commands in both directions, slow and fast, with pauses."
        )
