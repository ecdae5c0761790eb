"""The text of a file: unpacked, in whatever encoding it was written, with one kind of line end."""

from __future__ import annotations

import codecs
import zlib
from pathlib import Path

from hydrotwin.models.language.errors import DataError

LARGEST = 8 * 2**30  # bytes that a packed file may hold: more is taken for a trap
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_OLD = ["cp1252", "cp1250", "cp1251", "cp1253", "cp1254", "cp932", "gb18030", "big5", "cp949", "cp850", "mac_roman"]
_SEEN = 20_000  # bytes beyond ASCII that are shown to the detector, with their surroundings


def text_of(content: bytes, path: Path, encoding: str | None = None) -> tuple[str, str]:
    """The text of a file, line ends as ``\\n``, and the name of its encoding. Raises `DataError` where it is none."""
    if content[:2] == b"\x1f\x8b":
        content = _unpacked(content, path)
    encoding = encoding or _encoding_of(content)
    try:
        text = content.decode(encoding)
    except (UnicodeDecodeError, LookupError) as error:
        raise DataError(
            f"{path}: row 1: not a text file in {encoding} ({error}). State its encoding (--encoding cp1252), or name "
            "the file by its own format."
        ) from None
    text = text.removeprefix("\ufeff").rstrip("\x00")  # room that was reserved and never filled
    if not text.strip():
        raise DataError(f"{path}: row 1: the file is empty. It needs a header 'time [s],name [unit],...' and rows.")
    if "\x00" in text[:4096]:
        raise DataError(f"{path}: row 1: not a text file (it has zero bytes). Name the file by its own format.")
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    return text, encoding.removesuffix("-sig")


def _unpacked(content: bytes, path: Path) -> bytes:
    inflater = zlib.decompressobj(wbits=31)
    found, rest = [], content
    try:
        while rest:
            found.append(inflater.decompress(rest, LARGEST))
            if inflater.unconsumed_tail:
                raise DataError(f"{path}: it unpacks to more than {LARGEST >> 30} GiB. Unpack it, and take a part.")
            if not inflater.eof:
                raise DataError(f"{path}: the packed file ends too early. It was cut off: copy it again.")
            rest, inflater = inflater.unused_data.lstrip(b"\x00"), zlib.decompressobj(wbits=31)
    except zlib.error as error:
        raise DataError(f"{path}: cannot be unpacked ({error}). Copy it again.") from None
    return b"".join(found)


def _encoding_of(content: bytes) -> str:
    for mark, name in _MARKS:
        if content.startswith(mark):
            return name
    head = content[:4096].rstrip(b"\x00")
    if head.count(b"\x00") > len(head) // 4:  # every second byte of digits and separators is zero
        return "utf-16-be" if head[:2].startswith(b"\x00") else "utf-16-le"
    try:
        content.decode("utf-8")
        return "utf-8"
    except UnicodeDecodeError:
        return _detected(content)


def _detected(content: bytes) -> str:
    """The encoding of text in one of the old code pages; Windows' own where nothing tells."""
    import charset_normalizer

    lines = [line for line in content[: 50 * _SEEN].splitlines() if not line.isascii()]
    found = charset_normalizer.from_bytes(b"\n".join(lines)[:_SEEN], cp_isolation=_OLD).best()
    western = b"\n".join(lines)[:_SEEN].decode("cp1252", errors="replace")
    unusual = sum(c not in _USUAL for c in western if not c.isascii())
    return found.encoding if found and unusual else "cp1252"


_USUAL = set("äöüÄÖÜßéèêëàâçùûîïôñáíóúåæøÅÆØ°²³µ±·×÷–—’‘“”„§½¼¾ìòÉÈÀÇ€")  # of Western texts in Windows' code page
