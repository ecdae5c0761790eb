"""What training needs and running does not: one sentence for a library that is not installed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from hydrotwin.models.language.errors import DeclarationError

LIBRARIES = {"torch": "PyTorch", "gpytorch": "GPyTorch", "pyoperon": "pyoperon", "sympy": "SymPy"}


@contextmanager
def needed_to_train(verb: str, otherwise: str = "") -> Iterator[None]:
    """Around the import of a file that trains; ``otherwise`` ends the sentence with another way, where there is one.

    Raises `DeclarationError` when one of `LIBRARIES` is missing. Any other missing module is a mistake of ours.
    """
    try:
        yield
    except ModuleNotFoundError as missing:
        library = LIBRARIES.get(missing.name or "")
        if library is None:
            raise
        raise DeclarationError(
            f"{verb}: {library} is not installed. Training needs it, running a trained block does not. "
            f"Install it with: pip install 'hydrotwin[learned]'{otherwise}."
        ) from None
