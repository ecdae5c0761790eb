"""documentation/licenses/license.txt: under which terms the parts of an FMU come."""

from __future__ import annotations

from collections.abc import Sequence

PARTS = (
    ("equations and parameter values", "{own}"),
    ("runtime (sources/*.c, *.h not named below), documentation", "MIT, the hydrotwin authors"),
    ("FMI headers (sources/fmi*Functions.h, *FunctionTypes.h, *Platform*.h)", "BSD-2-Clause, Modelica Association"),
    ("helper functions in sources/functions.c, written by CasADi", "MIT-0, the CasADi authors"),
)
_MIT = """\
Permission is hereby granted, free of charge, to any person obtaining a copy
of this software and associated documentation files (the "Software"), to deal
in the Software without restriction, including without limitation the rights
to use, copy, modify, merge, publish, distribute, sublicense, and/or sell
copies of the Software, and to permit persons to whom the Software is
furnished to do so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all
copies or substantial portions of the Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER
LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM,
OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE
SOFTWARE.
"""
COPYRIGHT = "Copyright (c) 2026 the hydrotwin authors"


def licences_of(own: str) -> Sequence[tuple[str, str]]:
    """What is inside, and its licence; ``own`` is that of the model."""
    return [(part, licence.format(own=own or "not given by who exported it")) for part, licence in PARTS]


def licence_text(own: str) -> str:
    """The file as text."""
    rows = "\n".join(f"- {part}: {licence}" for part, licence in licences_of(own))
    head = f"What is inside, and its licence:\n\n{rows}\n\nThe FMI headers carry theirs in full."
    return f"{head}\n\nMIT License\n\n{COPYRIGHT}\n\n{_MIT}"
