"""The metrics that a criterion may name: what each is measured in, what it can be, and when it is not defined."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

OF_OUTPUT, SHARE, TIME, PLAIN = "output", "share", "time", "number"  # what a metric is measured in
AGAIN = 1e-4  # relative: numbers of the same runs on another processor or compiler differ by less
_STILL = "{output} does not move there"
_NO_BAND = "the model has no band of {output} there"


@dataclass(frozen=True)
class Metric:
    """One metric, as a criterion judges it.

    of : what it is measured in. field : of a `Score`; "" where it is made from one. least, most : what it can be, in SI
    or as a share of 1. best : the larger the better. sized : judged by its size, whatever its sign. of_band : a model
    without a band has none. at_times : over recordings it is the mean of those in which it is defined: not all rest.
    from_zero : it holds errors against the size of the measurement, from the zero of its SI unit on. by_range : it
    counts by the range of the measurement, or by what rests within it. of_shift : by the shift that fits best.
    percent : people read this share in percent. undefined : why a recording has no number of it, with ``{output}``.
    """

    of: str
    field: str
    undefined: str = ""
    least: float = 0.0
    most: float = math.inf
    best: bool = False
    sized: bool = False
    of_band: bool = False
    at_times: bool = False
    from_zero: bool = False
    by_range: bool = False
    of_shift: bool = False
    percent: bool = False

    @property
    def span(self) -> str:
        """What it can be, in words."""
        if math.isinf(self.most):
            return "never negative"
        most = f"{self.most:g} ({100 * self.most:g} %)"
        return f"at most {most}" if math.isinf(self.least) else f"{self.least:g} to {most}"


METRICS: Mapping[str, Metric] = {
    "rmse": Metric(OF_OUTPUT, "rmse"),
    "mae": Metric(OF_OUTPUT, "mae"),
    "max": Metric(OF_OUTPUT, "maximum"),
    "bias": Metric(OF_OUTPUT, "bias", sized=True),
    "nrmse": Metric(SHARE, "", _STILL, percent=True, by_range=True),  # of the range of the measurement
    "fit": Metric(SHARE, "fit_percent", _STILL, -math.inf, 1.0, best=True, percent=True),  # the NRMSE fit
    "coverage": Metric(SHARE, "coverage", _NO_BAND, most=1.0, best=True, of_band=True, percent=True),  # of a 95 % band
    "r2": Metric(SHARE, "r2", _STILL, -math.inf, 1.0, best=True),  # the coefficient of determination
    "theil": Metric(SHARE, "theil", _STILL, most=1.0, from_zero=True),  # Theil's inequality coefficient
    "iso18571": Metric(  # the overall rating of ISO/TS 18571
        SHARE, "iso18571", "{output} or its prediction does not move, is too short, or the mode is not free run",
        most=1.0, best=True, from_zero=True, of_shift=True,
    ),
    "lag": Metric(  # how late or early the prediction is
        TIME, "lag",
        "{output} or its prediction does not move, or they do not correlate best within a fifth of the recording",
        sized=True, of_shift=True,
    ),
    "settling": Metric(  # how much longer or shorter it takes to settle
        TIME, "settling", "{output} never comes to rest after the inputs moved, and rest, or lacks samples there",
        sized=True, at_times=True, by_range=True,
    ),
    "steady": Metric(  # the mean error of every rest of inputs and measurement, in size
        OF_OUTPUT, "steady", "the inputs and {output} never rest together, or it lacks samples where they do",
        sized=True, at_times=True, by_range=True,
    ),
    "vv20": Metric(PLAIN, "vv20", _NO_BAND, of_band=True),  # RMSE over the validation uncertainty of ASME V&V 20
}  # fmt: skip
SCORED: Mapping[str, str] = {name: one.field for name, one in METRICS.items() if one.field}  # -> field of a `Score`
AT_TIMES = tuple(one.field for one in METRICS.values() if one.at_times)  # not defined in every recording
ERRORS = tuple(name for name, one in METRICS.items() if not one.best)  # the smaller the better
ALSO: Mapping[str, str] = {  # what else people call them, for who does not find one
    **dict.fromkeys(("rms", "rmsd", "rms error", "root mean square error"), "rmse"),
    **dict.fromkeys(("mean absolute error",), "mae"),
    **dict.fromkeys(("maximum", "max error", "maximum error", "peak", "peak error"), "max"),
    **dict.fromkeys(("mean error", "offset"), "bias"),
    **dict.fromkeys(("nrms", "normalised rmse", "normalized rmse"), "nrmse"),
    **dict.fromkeys(("nrmse fit", "fit percent"), "fit"),
    **dict.fromkeys(("r²", "r^2", "r squared"), "r2"),
    **dict.fromkeys(("theil's u", "tic", "u"), "theil"),
    **dict.fromkeys(("rating", "iso", "iso 18571", "iso/ts 18571"), "iso18571"),
    **dict.fromkeys(("phase", "phase lag", "time lag", "delay", "dead time"), "lag"),
    **dict.fromkeys(("settling time",), "settling"),
    **dict.fromkeys(("steady state", "steady state error"), "steady"),
    **dict.fromkeys(("v&v 20", "asme v&v 20", "e/u val"), "vv20"),
}
