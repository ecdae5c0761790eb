"""What sensors do to the truth before it is recorded: delay, lag, play, ripple, scale, bias, drift, noise, steps."""

from __future__ import annotations

import numpy as np

FINE = 2e-4  # spacing at which lag and play follow an output [s]

DEFAULTS = {
    "sensor_delay": {"output": None, "seconds": 0.02},
    "sensor_lag": {"output": None, "time_constant": 0.02},
    "sensor_hysteresis": {"output": None, "width": 0.0},
    "sensor_ripple": {"output": None, "amplitude": 0.0, "period": 1.0},
    "sensor_scale": {"output": None, "factor": 1.02},
    "sensor_bias": {"output": None, "value": 0.0},
    "sensor_drift": {"output": None, "rate": 0.0},
    "quantisation": {"output": None, "step": 0.0},
}


def lagged(times, values, time_constant):
    """First-order lag of a signal that is linear between its samples; exact for such a signal."""
    answer = np.empty_like(values)
    answer[0] = y = values[0]
    steps = np.diff(times)
    decay = np.exp(-steps / time_constant)
    slopes = np.diff(values) / steps
    for i, (a, k, h) in enumerate(zip(decay, slopes, steps, strict=True)):
        shift = k * time_constant
        y = (y - values[i] + shift) * a + values[i] + k * h - shift
        answer[i + 1] = y
    return answer


def play(values, width):
    """Play of full width ``width``, at first in its middle."""
    answer, y, half = np.empty_like(values), values[0], width / 2
    for i, v in enumerate(values):
        y = min(max(y, v - half), v + half)
        answer[i] = y
    return answer


def extra_times(effects, time):
    """Instants at which the truth is needed besides the sample times."""
    wanted = []
    for name, options in effects:
        if name == "sensor_delay":
            wanted.append(np.maximum(time - options["seconds"], time[0]))
        if name in ("sensor_lag", "sensor_hysteresis"):
            wanted.append(np.arange(time[0], time[-1], FINE))
    return wanted


def measured(output, trace_times, trace, time, effects):
    """One output as its sensor reports it at ``time``, before noise."""
    delay = 0.0
    mine = [(name, o) for name, o in effects if name in DEFAULTS and o["output"] == output]
    for name, o in mine:
        if name == "sensor_lag":
            trace = lagged(trace_times, trace, o["time_constant"])
        elif name == "sensor_hysteresis":
            trace = play(trace, o["width"])
        elif name == "sensor_delay":
            delay += o["seconds"]
    values = trace[_index(trace_times, np.maximum(time - delay, time[0]))]
    for name, o in mine:
        if name == "sensor_ripple":
            values = values + o["amplitude"] * np.sin(2 * np.pi * values / o["period"])
        elif name == "sensor_scale":
            values = values * o["factor"]
        elif name == "sensor_bias":
            values = values + o["value"]
        elif name == "sensor_drift":
            values = values + o["rate"] * (time - time[0])
    return values


def _index(trace_times, wanted):
    """Positions of ``wanted`` among the trace times, which hold them within 1e-10 s."""
    after = np.clip(np.searchsorted(trace_times, wanted), 1, len(trace_times) - 1)
    nearer = np.abs(trace_times[after - 1] - wanted) <= np.abs(trace_times[after] - wanted)
    return after - nearer


def quantised(values, step):
    return step * np.round(values / step) if step else values
