"""Where PyTorch trains: the one place that chooses the device, and the ways there and back.

Everything is float64, which of the GPUs that torch knows only those it calls CUDA (NVIDIA, and AMD by ROCm) compute.
Random numbers are drawn on the CPU, so that a seed starts the same training anywhere; after many iterations the last
digits may differ from device to device. ``CUDA_VISIBLE_DEVICES=""`` in the environment hides the GPU from torch.
"""

from __future__ import annotations

import numpy as np
import torch

REAL = torch.float64


def training_device() -> torch.device:
    """The GPU when torch sees one, else the CPU."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def tensor(values) -> torch.Tensor:
    """A copy of ``values`` (array, numbers or tensor on the CPU) where training takes place, float64."""
    return torch.tensor(np.asarray(values), dtype=REAL).to(training_device())


def array(values: torch.Tensor) -> np.ndarray:
    """A copy of ``values`` as a NumPy array, from wherever they are."""
    return values.detach().cpu().numpy().copy()
