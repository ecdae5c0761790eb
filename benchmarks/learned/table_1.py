"""Table I of the dual-GP paper on recordings of the rig: what each model makes of the same ten minutes of steps.

Mean squares of the rate over the variance of the raw training rates (the paper's z-score), as medians over data sets:
on the raw training rates, on ramps against their Savitzky-Golay rate (window 51, order 11, the paper's yardstick), and
on the same ramps against the rate of the noiseless position.
``python benchmarks/learned/table_1.py [SEEDS] [MODEL...]``: 3 data sets and all models unless said.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from examples.table_1.make_recordings import record
from hydrotwin.learned.grey_box.block import Dynamics
from hydrotwin.learned.grey_box.data import run_of
from hydrotwin.learned.grey_box.fit import Problem, bent_knots, evaluate, opening, responses
from hydrotwin.learned.grey_box.learn import learn_grey_box
from hydrotwin.learned.piecewise.learn import learn_piecewise
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record, savitzky_golay
from hydrotwin.simulation import simulate

LAGS, STARTS, LEARNING_RATE = 5, 10, 1e-2
UNITS = {"current": "1", "position": "m", "spool": "1", "true_position": "m"}
CURRENT, POSITION = Signal("current", "1"), Signal("position", "m")
Predict = Callable[[Record], np.ndarray]  # rate over every interval that has a whole delay line, m/s


@dataclass(frozen=True)
class Row:
    """One model on one data set."""

    model: str
    training: float
    validation: float
    truth: float
    parameters: str
    seconds: float


def slopes(r: Record, column: str = "position") -> np.ndarray:
    """Raw rates over the intervals that have a whole delay line."""
    return (np.diff(r[column]) / np.diff(r.time))[LAGS - 1 :]


def lines(r: Record) -> np.ndarray:
    """Delay lines (n, LAGS), the newest sample first; the interval they belong to begins with it."""
    u = r["current"]
    return np.column_stack([u[LAGS - 1 - i : len(u) - 1 - i] for i in range(LAGS)])


def free_run(block, r: Record) -> np.ndarray:
    """The rate of a block's free run between the samples of the recording."""
    return slopes(r.with_signals({"position": simulate(block, r)["position"]}))


def line_by_line(block, r: Record) -> np.ndarray:
    """The rate that a Gaussian process gives for each delay line by itself."""
    held = len(block.states) - (LAGS - 1)
    at = [s.name for s in block.outputs].index("position.slope")
    rows = lines(r)
    x = np.hstack([np.zeros((len(rows), held)), rows[:, 1:]])
    return block.step.map(len(rows))(x.T, rows[:, :1].T, np.zeros((0, len(rows))))[1].full()[at]


def networks(train: Record, iterations: int) -> list[Predict]:
    """STARTS networks 5-16-16-1 with ReLU, Adam on all samples, in the order of their final loss."""
    import torch

    X, y = lines(train), slopes(train)
    centre, spread = X.mean(axis=0), X.std(axis=0)
    mean, scale = y.mean(), y.std()
    data = torch.tensor((X - centre) / spread, dtype=torch.float32)
    target = torch.tensor((y - mean) / scale, dtype=torch.float32)
    torch.manual_seed(0)
    weights = []
    for first, second in ((LAGS, 16), (16, 16), (16, 1)):  # PyTorch's own start of a linear layer
        for shape in ((STARTS, first, second), (STARTS, 1, second)):
            weights.append(((2 * torch.rand(shape) - 1) / first**0.5).requires_grad_())

    def forward(inputs):
        h = torch.relu(torch.baddbmm(weights[1], inputs.expand(STARTS, -1, -1), weights[0]))
        h = torch.relu(torch.baddbmm(weights[3], h, weights[2]))
        return torch.baddbmm(weights[5], h, weights[4])[:, :, 0]

    adam = torch.optim.Adam(weights, lr=LEARNING_RATE)
    for _ in range(iterations):
        adam.zero_grad()
        losses = (forward(data) - target).square().mean(dim=1)
        losses.sum().backward()
        adam.step()
    order = torch.argsort(losses).tolist()

    def predict(k, r):
        with torch.no_grad():
            rows = torch.tensor((lines(r) - centre) / spread, dtype=torch.float32)
            return mean + scale * forward(rows)[k].numpy().astype(float)

    return [partial(predict, k) for k in order]


def oracle(train: Record) -> Predict:
    """The grey box with the true play and dynamics of the rig: only the map is fitted."""
    h = 0.01
    run, ratio = run_of(train, h, CURRENT, POSITION), 0.3
    known = Dynamics(0.08 - h / 2, 120.0, 0.8, 0.04, 0.003)
    problem = Problem([run], h, True, ratio, 1.0)
    fitted = evaluate(problem, known, np.linspace(*problem.span, 25))
    for _ in range(2):
        fitted = evaluate(problem, known, bent_knots(fitted.knots, fitted.values))

    def predict(r):
        other = run_of(r, h, CURRENT, POSITION)
        rows = responses(opening(other, known, h), fitted.knots, known.lag, h, True)
        return slopes(r.with_signals({"position": other.sampled(rows @ fitted.values)}))

    return predict


def gaussian_process(train: Record, fit: str, dual: bool) -> Predict:
    """A (dual) Gaussian process on raw rates; "paper": 100 Adam steps, "default": to the end."""
    if dual:
        from hydrotwin.learned.gaussian.dual import learn_dual_gp as learn
    else:
        from hydrotwin.learned.gaussian.single import learn_gaussian_process

        learn = partial(learn_gaussian_process, rate=True)
    return partial(line_by_line, learn([train], [CURRENT], [POSITION], fit=fit, lags=LAGS, period=0.1))


def models() -> dict[str, tuple[str, Callable[[Record], Predict | Sequence[Predict]]]]:
    """Name -> (number of parameters, learn)."""
    return {
        "GP, 100 Adam steps": ("-", partial(gaussian_process, fit="paper", dual=False)),
        "GP, converged": ("-", partial(gaussian_process, fit="default", dual=False)),
        "dual GP, 100 Adam steps": ("-", partial(gaussian_process, fit="paper", dual=True)),
        "dual GP, converged": ("-", partial(gaussian_process, fit="default", dual=True)),
        "NN 5-16-16-1, 100 Adam steps": ("385", partial(networks, iterations=100)),
        "NN 5-16-16-1, 1000 Adam steps": ("385", partial(networks, iterations=1000)),
        "piecewise, no dead time": ("6", lambda r: _block(learn_piecewise, r, dead_time=0.0)),
        "piecewise, dead time": ("7", lambda r: _block(learn_piecewise, r)),
        "grey box": ("30", lambda r: _block(learn_grey_box, r)),
        "oracle: grey box, true dynamics": ("25", oracle),
    }


def _block(learn, r: Record, **options) -> Predict:
    return partial(free_run, learn([r], [CURRENT], [POSITION], **options))


def data(seed: int) -> tuple[Record, Record]:
    """Training and validation recordings."""
    kinds = [(kind, record(kind, seed)) for kind in ("train", "validate")]
    return tuple(Record(c["time"], {n: c[n] for n in UNITS}, UNITS, f"{kind}_{seed}") for kind, c in kinds)


def score(predict: Predict, train: Record, judge: Record) -> tuple[float, float, float]:
    """Mean squares over the variance of the training rates: training, Savitzky-Golay of the ramps, their truth."""
    raw, variance = slopes(train), np.var(slopes(train))
    smooth = savitzky_golay(judge, ["position"], derivative=1)
    middle = ((judge.time[1:] + judge.time[:-1]) / 2)[LAGS - 1 :]
    inside = (middle >= smooth.time[0]) & (middle <= smooth.time[-1])
    found = predict(judge)
    reference = np.interp(middle, smooth.time, smooth["position.rate"])
    misses = predict(train) - raw, (found - reference)[inside], (found - slopes(judge, "true_position"))[inside]
    return tuple(float(np.mean(m**2) / variance) for m in misses)


def rows_of(seed: int, wanted: Sequence[str]) -> list[Row]:
    """Every model on one data set; of several starts the one with the best training loss."""
    train, judge = data(seed)
    answer = []
    for name, (count, learn) in models().items():
        if wanted and not any(w in name for w in wanted):
            continue
        began = time.process_time()
        try:
            found = learn(train)
        except ImportError as missing:
            print(f"{name}: left out ({missing})")
            continue
        seconds = time.process_time() - began
        starts = found if isinstance(found, list) else [found]
        scores = [score(predict, train, judge) for predict in starts]
        answer.append(Row(name, *scores[0], count, seconds))
        if len(scores) > 1:
            spread = [s[1] for s in scores]
            print(
                f"   {name}, seed {seed}: validation over {len(spread)} starts {min(spread):.2e} to {max(spread):.2e}"
            )
        print(f"   {name}, seed {seed}: " + "  ".join(f"{s:.2e}" for s in scores[0]) + f"  {seconds:.1f} s", flush=True)
    return answer


def main(seeds: int, wanted: Sequence[str]) -> None:
    by_model: dict[str, list[Row]] = {}
    for seed in range(seeds):
        for row in rows_of(seed, wanted):
            by_model.setdefault(row.model, []).append(row)
    print(f"\nmedians over {seeds} data sets; mean squares over the variance of the training rates")
    print(f"{'model':32s} {'training':>10s} {'ramps':>10s} {'true ramps':>10s} {'parameters':>10s} {'CPU-s':>7s}")
    for name, rows in by_model.items():
        medians = [float(np.median([getattr(r, key) for r in rows])) for key in ("training", "validation", "truth")]
        seconds = float(np.median([r.seconds for r in rows]))
        print(f"{name:32s} " + " ".join(f"{m:10.2e}" for m in medians) + f" {rows[0].parameters:>10s} {seconds:7.1f}")


if __name__ == "__main__":
    numbers = [a for a in sys.argv[1:] if a.isdigit()]
    main(int(numbers[0]) if numbers else 3, [a for a in sys.argv[1:] if not a.isdigit()])
