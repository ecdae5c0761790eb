"""One Gaussian process from data to the arrays of a block: options, training, compression, provenance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from typing import TYPE_CHECKING

import numpy as np

from hydrotwin.models.language.errors import DeclarationError

from ..interruption import INTERRUPTED, CtrlC
from ..options import check_counts, check_known, check_positive
from ..training_data import named
from .delay_lines import FEWEST, Rows, normalised
from .integrated_band import leading
from .kernel_block import BYTES_OF_CONSTANT, KERNELS, LARGEST_C

if TYPE_CHECKING:
    from .compression import Posterior, SmallPosterior
    from .exact import TrainedProcess

FEWEST_POINTS = 100  # inducing points, before the bound asks for more
PART_POINTS = 150  # inducing points of a process that is judged on the rest of a recording
FITS = ("default", "paper")


@dataclass(frozen=True, eq=False)
class DeployedProcess:
    """A trained process, the arrays of its block, and the scale its targets were normalised with.

    on_grid : GPyTorch's mean and latent deviation where the certificate is taken, SI.
    """

    label: str
    trained: TrainedProcess
    small: SmallPosterior
    arrays: Mapping[str, np.ndarray]
    scales: Mapping[str, np.ndarray]
    on_grid: tuple[np.ndarray, np.ndarray]
    centre: float
    scale: float

    def exact_mean(self, features: np.ndarray) -> np.ndarray:
        """GPyTorch's mean at ``features`` (n, d), SI."""
        return self.centre + self.scale * self.trained.predict(normalised(features, self.scales), deviation=False)[0]

    def fast(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and deviation at ``features`` (n, d) from what `compression` kept, SI."""
        posterior = self.trained.posterior
        mean, sd = self.small.at(normalised(features, self.scales) / posterior.lengths, posterior.kernel)
        return self.centre + self.scale * mean, self.scale * sd

    def on_part(self, features: np.ndarray, targets: np.ndarray) -> DeployedProcess:
        """The process with the same hyper-parameters that saw only ``features`` (n, d), ``targets`` (n,), SI."""
        from .compression import compressed

        X, y = normalised(features, self.scales), (targets - self.centre) / self.scale
        posterior = replace(self.trained.posterior, features=X, targets=y, weights=np.zeros(len(y)))
        small = compressed(posterior, X[:1], (np.zeros(1), np.zeros(1)), min(PART_POINTS, len(X)), 1.0)
        arrays = process_arrays(posterior, small, self.centre, self.scale)
        return replace(self, trained=replace(self.trained, posterior=posterior), small=small, arrays=arrays)

    def directions(self, parts: Sequence[Rows], slopes: Sequence[np.ndarray] | None = None) -> np.ndarray:
        """Directions (points of the deviation, R), SI, that integrals of the process over recordings show most.

        slopes : what the process is multiplied with before it is integrated, (n,) for every part.
        """
        from .compression import correlation, uncertain

        posterior, points = self.trained.posterior, self.small.sd_points
        JJ = np.zeros((len(points), len(points)))
        for k, part in enumerate(parts):
            values = correlation(points, normalised(part.features, self.scales) / posterior.lengths, posterior.kernel)
            G = np.cumsum(values if slopes is None else values * slopes[k], axis=1)
            JJ += G @ G.T
        return self.scale * leading(uncertain(posterior, points), JJ)[0]

    def raw(self) -> np.ndarray:
        """The features of its rows, SI, of a process of one feature (n,)."""
        posterior = self.trained.posterior
        return self.scales["input_centre"][0] + self.scales["input_scale"][0] * posterior.features[:, 0]

    def largest_variance(self) -> float:
        """The largest variance of the latent function at the rows of the process, SI."""
        posterior = self.trained.posterior
        sd = self.small.at(posterior.features / posterior.lengths, posterior.kernel)[1]
        return float(self.scale * sd.max()) ** 2

    def told(self) -> dict:
        """Hyper-parameters for the provenance; noise in SI, lengths over the spread of their input."""
        posterior = self.trained.posterior
        return {
            "process": self.label,
            "average": self.centre + self.scale * posterior.constant,
            "lengths": posterior.lengths.tolist(),
            "prior_sd": self.scale * posterior.prior_variance**0.5,
            "noise_sd": self.scale * posterior.noise_variance**0.5,
            "loss": self.trained.loss,
            "iterations": self.trained.iterations,
            "seconds": round(self.trained.seconds, 2),
            "stopped": self.trained.stopped,
        }


def train_process(
    exact_gp, features, targets, scales, grid, *, kernel, fit, points, compress, bound, rng, label, progress,
    ctrl_c: CtrlC | None = None,
) -> DeployedProcess:  # fmt: skip
    """Normalise, train, condition and compress one process; ``grid`` (m, d) is where the compressed one is compared."""
    from .compression import compressed

    centre, scale = float(targets.mean()), float(targets.std()) or 1.0
    X, y, places = normalised(features, scales), (targets - centre) / scale, normalised(grid, scales)
    trained = exact_gp.train(
        X, y, kernel=kernel, fit=fit, points=points, rng=rng, process=label, progress=progress, ctrl_c=ctrl_c
    )
    exact = trained.predict(places)
    small = compressed(trained.posterior, places, exact, compress, bound)
    on_grid = (centre + scale * exact[0], scale * exact[1])
    arrays = process_arrays(trained.posterior, small, centre, scale)
    return DeployedProcess(label, trained, small, arrays, scales, on_grid, centre, scale)


def process_arrays(posterior: Posterior, small: SmallPosterior, centre: float, scale: float) -> dict:
    """The arrays of a block for one process, SI."""
    return {
        "lengths": posterior.lengths,
        "points": small.points,
        "weights": scale * small.weights,
        "sd_points": small.sd_points,
        "sd_factor": scale * small.sd_factor,
        "prior_variance": scale**2 * small.prior_variance,
        "output_centre": centre + scale * small.constant,
        "noise": scale * posterior.noise_variance**0.5,
    }


def stacked(parts: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """The arrays of several processes, one beside the other; those with fewer points get points of no weight."""
    arrays = [{key: np.asarray(value, dtype=float) for key, value in part.items()} for part in parts]
    largest = {key: np.max([part[key].shape for part in arrays], axis=0) for key in arrays[0]}

    def padded(key, value):
        return (
            np.pad(value, [(0, n - m) for n, m in zip(largest[key], value.shape, strict=True)]) if value.ndim else value
        )

    return {key: np.stack([padded(key, part[key]) for part in arrays]) for key in arrays[0]}


def counts(processes: Mapping[str, np.ndarray]) -> dict[str, int]:
    """The numbers of points for the header."""
    return {key: processes[key].shape[1] for key in ("points", "sd_points")} | {"rank": processes["sd_factor"].shape[1]}


def provenance(kind: str, records, seed: int, rows: Rows, trained: Sequence[DeployedProcess], options: Mapping) -> dict:
    """Where a block comes from; in the words of the other learned blocks."""
    stopped = {p.trained.stopped for p in trained}
    return {
        "kind": kind,
        "trained_on": named(records),
        "seed": seed,
        "rows": len(rows),
        **{key: "all" if value is None else value for key, value in options.items()},
        "processes": [p.told() for p in trained],
        "seconds": round(sum(p.trained.seconds for p in trained), 2),
        "stopped": INTERRUPTED if INTERRUPTED in stopped else "finished",
        "versions": {package: metadata.version(package) for package in ("torch", "gpytorch", "numpy", "casadi")},
    }


def apart(mean: np.ndarray, sd: np.ndarray, exact: tuple[np.ndarray, np.ndarray], scale: float) -> dict[str, float]:
    """How far mean and deviation (n,) are from the exact ones, over ``scale``; of the deviation, to either side."""
    off = (sd - exact[1]) / scale
    return {
        "mean": float(np.abs(mean - exact[0]).max() / scale),
        "sd_above": max(float(off.max()), 0.0),
        "sd_below": max(float(-off.min()), 0.0),
    }


def reference_name(above: float, below: float) -> str:
    """What the certificate compares with, and where; ``above``, ``below``: of the deviation, over the spread."""
    return (
        f"gpytorch {metadata.version('gpytorch')} float64: recorded rows, steady inputs, steps; "
        f"standard deviation at most {above:.1e} too large, {below:.1e} too small"
    )


def check_options(verb, kernel, lags, fit, points, samples, compress, bound, period) -> None:
    """Raise `DeclarationError` for options that make no sense."""
    check_known(verb, "kernel", kernel, KERNELS)
    check_known(verb, "fit", fit, FITS)
    least = {"lags": (lags, 1), "samples": (samples, FEWEST), "points": (points, FEWEST)}
    least |= {} if compress in (None, "auto") else {"compress": (compress, 5)}
    check_counts(verb, least)
    check_positive(verb, bound=bound, period=period)


def check_size(verb: str, rows: int, features: int, processes: int, compress: int | str | None) -> None:
    """Raise `DeclarationError` when the block would be more than 5 MB of C, were the fewest points enough."""
    deviation = min(FEWEST_POINTS if compress in (None, "auto") else compress, rows)
    points = rows if compress is None else deviation
    numbers = processes * (points * (features + 2) + deviation * (features + 1) + deviation * (deviation + 1) / 2)
    if numbers * BYTES_OF_CONSTANT > LARGEST_C:
        raise DeclarationError(
            f"{verb}: the block would be {numbers * BYTES_OF_CONSTANT / 1e6:.0f} MB of C (got {points} points of "
            f"{features} features, {processes} processes). At most {LARGEST_C / 1e6:.0f} MB run well in an FMU. "
            "Compress it: compress='auto' or fewer points."
        )
