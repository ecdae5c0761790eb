"""Every constant that decides a name, in one place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Deciding:
    """The constants that decide, each with its unit and where it comes from.

    law : share (1) of what an effect does by which a machine's law differs from the catalogue's; tuning seeds.
    beside : the same of a law that is seen beside something else which is missing (1); the real recordings of examples.
    rough, rarely : the same of a law that is only roughly the machine's (1), and the prior probability of that.
    known : share (1) by which the variance of a sensor's noise is uncertain, beside chance; benchmark, tuning seeds.
    chance : standard deviations (1) that noise may exceed its variance in one output and time scale; one in a thousand.
    coarse : step of a recorded signal in noises (1) from which on most of the noise is rounding, which is coloured.
    tempered : share (1) of the base's score that tells two structures apart by one nat, as no law is exact.
    something_else : prior probability (1) that what is missing stands in no catalogue; chosen below ``rarely``.
    in_class : probability (1) that a class holds; the usual 95 %.
    told : probability (1) from which on a structure is told as a member of a class.
    part, partly : share (1) of the gap from which on a structure that does not explain all of it is told as a part of
    what is missing, and the probability (1) of that; chosen, not measured yet.
    confirmed : share (1) of the gap that must close on recordings which took no part; less takes a name back.
    visible : nats that the base must leave in windows before these decide which candidates come first.
    """

    law: float = 0.02
    beside: float = 0.3
    rough: float = 0.1
    rarely: float = 0.04
    known: float = 0.05
    chance: float = 3.0
    coarse: float = 2.5
    tempered: float = 0.002
    something_else: float = 0.03
    in_class: float = 0.95
    told: float = 0.01
    part: float = 0.5
    partly: float = 0.8
    confirmed: float = 0.5
    visible: float = 300.0


DECIDING = Deciding()
