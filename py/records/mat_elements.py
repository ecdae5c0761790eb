"""The data elements of MAT files of version 5 to 7 (MAT-file format, 1-9): scipy ends the process at a wrong one."""

from __future__ import annotations

import struct

_NUMBERS = {*range(1, 8), 9, 12, 13, 16, 17, 18}  # and texts
_MATRIX, _COMPRESSED = 14, 15
_HOLDERS = {1, 2, 3, 16, 17}  # classes of arrays that hold arrays: cell, struct, object, function, opaque
_COMPLEX = 0x800
_HEADER = 128  # bytes


def check_elements(content: bytes) -> None:
    """Raises ValueError where an element is of a type that cannot stand there, or reaches beyond what holds it."""
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order and content[124:126] in (b"\x00\x01", b"\x01\x00"):
        _check(content, (_HEADER, len(content)), order, {_MATRIX, _COMPRESSED})


def _check(content: bytes, inside: tuple[int, int], order: str, known: set[int]) -> int:
    """The number of elements."""
    start, end = inside
    count = 0
    while start + 8 <= end:
        kind, size = struct.unpack_from(f"{order}II", content, start)
        is_small = kind >> 16 > 0  # its size stands in the upper half of the type, its data in the tag
        if is_small:
            kind, size = kind & 0xFFFF, kind >> 16
        fits = size <= 4 if is_small else start + 8 + size <= end
        if kind not in (known - {_MATRIX} if is_small else known) or not fits:
            raise ValueError(f"no known element at byte {start}")
        if kind == _MATRIX and size:
            _check_matrix(content, (start + 8, start + 8 + size), order)
        start += 8 if is_small else 8 + size + (0 if kind == _COMPRESSED else -size % 8)
        count += 1
    return count


def _check_matrix(content: bytes, inside: tuple[int, int], order: str) -> None:
    """The elements of an array: flags, dimensions, name and data; the flags say what the data are."""
    if inside[1] - inside[0] < 16:
        raise ValueError(f"no known element at byte {inside[0]}")
    kind, size, flags = struct.unpack_from(f"{order}III", content, inside[0])
    holds_arrays, is_complex = flags & 0xFF in _HOLDERS, bool(flags & _COMPLEX)
    count = _check(content, inside, order, _NUMBERS | ({_MATRIX} if holds_arrays else set()))
    if (kind, size) != (6, 8) or (not holds_arrays and count < 4 + is_complex):
        raise ValueError(f"no whole array at byte {inside[0]}")
