"""The command line: one Typer app, one place where errors become sentences and exit codes.

Exit codes: 0 done, 1 failed honestly, 2 wrong usage or unusable input.
"""

from __future__ import annotations

import os
import sys
import warnings

import typer
from rich.console import Console

from hydrotwin import __version__
from hydrotwin.models.language.errors import HydrotwinError, SolveError

from .commands import (
    comparing,
    demonstrating,
    discovering,
    exporting,
    fitting,
    inspecting,
    inverting,
    learning,
    sensing,
    showing,
)

SEVERAL = ("--validate", "--train")  # options that take every file up to the next option

app = typer.Typer(
    name="hydrotwin",
    help="Identify, learn, compare and export models of hydraulic actuators, and find the physics they lack.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"hydrotwin {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="print the version"),
) -> None:
    """Identify, learn, compare and export models of hydraulic actuators."""


for room in (
    inspecting,
    showing,
    fitting,
    sensing,
    learning,
    inverting,
    discovering,
    comparing,
    exporting,
    demonstrating,
):
    room.register(app)


def _note(console: Console, message: Warning | str, kind: type[Warning]) -> None:
    """Tell a warning; those of NumPy on numbers that run away in a trial are words to who wrote it."""
    if not issubclass(kind, RuntimeWarning):
        console.print(f"[yellow]note[/] {_escaped(message)}")


def main() -> None:
    """Run the command line."""
    console = Console(stderr=True, soft_wrap=True, highlight=False, emoji=False)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("default", category=UserWarning)
            warnings.showwarning = lambda message, kind, *_, **__: _note(console, message, kind)
            app(args=spread(sys.argv[1:]))
    except SolveError as error:
        console.print(f"[bold red]failed[/] {_escaped(error)}")
        sys.exit(1)
    except HydrotwinError as error:
        console.print(f"[bold red]error[/] {_escaped(error)}")
        sys.exit(2)
    except KeyboardInterrupt:
        console.print("stopped")
        sys.exit(130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:
        file = error.filename2 or error.filename or "a file"
        reason = error.strerror or type(error).__name__
        next_step = "Check the path, its permissions and the free space."
        console.print(f"[bold red]error[/] {_escaped(f'{file}: {reason}. {next_step}')}")
        sys.exit(2)


def spread(arguments: list[str]) -> list[str]:
    """``--validate a.csv b.csv`` (what a shell makes of ``--validate *.csv``) with the option before each file.

    Everything up to the next option belongs to it, so recordings to fit to stand before.

    >>> spread(["identify", "cehA", "t.csv", "--validate", "a.csv", "b.csv", "--out", "m.toml"])[3:-2]
    ['--validate', 'a.csv', '--validate', 'b.csv']
    """
    answer: list[str] = []
    several = None
    for argument in arguments:
        if argument.startswith("-"):
            several = argument if argument in SEVERAL else None
            first = True
        elif several and not first:
            answer.append(several)
        else:
            first = False
        answer.append(argument)
    return answer


def _escaped(message: Exception | str) -> str:
    from rich.markup import escape

    return escape(str(message))
