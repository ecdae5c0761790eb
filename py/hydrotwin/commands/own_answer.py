"""That what lies where a run writes its answer is the answer of this run, or none.

A script reads the same file every night. So an answer of an earlier run is put aside, whole, as the next one begins; it
goes when that one has written its own, and stays where it was put when there is none: nothing is lost before something
whole takes its place, and nothing old is read as new. Files that take long to make and say of what they are (models,
recordings, archives) stay until they are replaced.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from pathlib import Path

from hydrotwin.models.language.errors import HydrotwinError

from .shared import check_file, check_folder

ANSWER = ("compare.json", "report.html", "report.md")


def answers(command: Callable) -> Callable:
    """The command, whose answer goes into the folder ``output`` and the file ``junit_file``, where one is named: both
    are its own from before its other options are looked at."""

    @functools.wraps(command)
    def own(**given):
        check_folder(given["output"])
        with _own_answer(given["output"], given["junit_file"]):
            return command(**given)

    return own


@contextlib.contextmanager
def _own_answer(folder: Path, file: Path | None) -> Iterator[None]:
    """While the answer of a run is made that goes into ``folder``, and into ``file``, which is removed.

    Where the run ends without one, says where that of an earlier run is.
    """
    from hydrotwin.report.written import forget_others

    aside = _put_aside(folder)
    try:
        if file is not None:
            check_file(file, ".xml").unlink(missing_ok=True)
        yield
    except HydrotwinError as error:
        if not (aside / ANSWER[0]).exists():
            raise
        raise type(error)(f"{error} The report of an earlier run is in {aside}.") from error
    finally:
        if (folder / ANSWER[0]).exists():
            forget_others(aside)
            with contextlib.suppress(OSError):  # there is more in it, or it is not there
                aside.rmdir()


def _put_aside(folder: Path) -> Path:
    """The folder with the answer of an earlier run: the last one that there was."""
    from hydrotwin.comparison import ASIDE
    from hydrotwin.report.written import forget_others, listed_files, note_written

    aside, found = folder / ASIDE, [folder / name for name in ANSWER if (folder / name).is_file()]
    if not found:
        return aside
    forget_others(aside)
    moved = []
    for file in [*found, *listed_files(folder)]:
        to = aside / file.relative_to(folder)
        to.parent.mkdir(parents=True, exist_ok=True)
        moved.append(file.replace(to))
        with contextlib.suppress(OSError):
            file.parent.rmdir()  # of a variant, where nothing else is in it
    note_written(aside, moved)
    return aside
