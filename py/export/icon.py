"""The icon of an FMU, drawn here: the same bytes every time."""

from __future__ import annotations

import functools
import struct
import zlib

import numpy as np

SIZE, FINE = 128, 4  # pixels, and samples across each
PAPER, INK, FILL, ACCENT = (255, 255, 255), (27, 35, 48), (214, 228, 240), (31, 99, 160)


@functools.cache
def icon(sampled: bool) -> bytes:
    """A PNG of 128 x 128 pixels: a cylinder with its rod for a model, a held signal for a sampled block."""
    canvas = np.empty((SIZE * FINE, SIZE * FINE, 3), np.float64)
    canvas[:] = PAPER
    for x0, y0, x1, y1, colour in _staircase() if sampled else _cylinder():
        canvas[round(y0 * FINE) : round(y1 * FINE), round(x0 * FINE) : round(x1 * FINE)] = colour
    pixels = canvas.reshape(SIZE, FINE, SIZE, FINE, 3).mean((1, 3)).round().astype(np.uint8)
    return png(pixels)


def png(pixels: np.ndarray) -> bytes:
    """Pixels (height, width, 3) of 8 bits as a PNG file. Source: PNG specification, W3C 2003."""
    height, width, _ = pixels.shape
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(rows, 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )


def _cylinder() -> list[tuple]:
    """Barrel, oil on the cap side, piston, rod, two ports, and the load it moves."""
    return [
        (12, 40, 84, 88, INK), (16, 44, 80, 84, FILL),
        (16, 44, 44, 84, ACCENT), (44, 44, 52, 84, INK),
        (52, 60, 108, 68, INK), (54, 62, 108, 66, PAPER),
        (108, 44, 116, 84, INK),
        (20, 88, 28, 104, INK), (22.5, 84, 25.5, 104, ACCENT), (68, 88, 76, 104, INK), (70.5, 84, 73.5, 104, FILL),
    ]  # fmt: skip


def _staircase() -> list[tuple]:
    """Axes and a signal that is held between its samples."""
    heights = [88, 62, 38, 30, 42, 60]
    parts = [(16, 16, 19, 112, INK), (16, 109, 112, 112, INK)]
    for k, y in enumerate(heights):
        x = 22 + 14.5 * k
        parts.append((x, y, x + 14.5, y + 4, ACCENT))
        if k:
            top, bottom = sorted((heights[k - 1], y))
            parts.append((x - 1, top, x + 1, bottom + 4, FILL))
    return parts
