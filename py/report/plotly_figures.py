"""The figures of a page as Plotly figures, to look at in a notebook or to save otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from hydrotwin.comparison import Comparison, Matrix
from hydrotwin.discovery.answer.discovery import Discovery
from hydrotwin.identification import Fit, Profiles, Sensitivity
from hydrotwin.models.language.errors import DeclarationError

from .figure import Figure, FigureGroup, unpacked
from .fit import fit_section
from .gap import gap_page
from .matrix import matrix_page
from .page import Section
from .sensitivity import sensitivity_page
from .sensitivity_figures import profile_group
from .write import comparison_page

if TYPE_CHECKING:
    import plotly.graph_objects


def figures(
    found: Comparison | Matrix | Discovery | Fit | Sensitivity | Profiles,
) -> dict[str, plotly.graph_objects.Figure]:
    """The figures that the report of ``found`` shows, by their names on the page, in the units it shows.

    Curves are those of the page: at most a few thousand points, 32-bit where that tells them apart, every peak kept.
    Raises DeclarationError for an object without figures.
    """
    import plotly.graph_objects as go

    return {figure.id: go.Figure(_unpacked(figure.spec)) for figure in _drawn(_sections(found))}


def _sections(found: Comparison | Matrix | Discovery | Fit | Sensitivity | Profiles) -> tuple[Section, ...]:
    if isinstance(found, Matrix):
        return matrix_page(found, command="").sections
    if isinstance(found, Comparison):
        return comparison_page(found, command="").sections
    if isinstance(found, Discovery):
        page = gap_page(found, command="")
        return (Section("answer", page.title, (page.picture,) if page.picture else ()), *page.sections)
    if isinstance(found, Fit):
        return (fit_section(found),)
    if isinstance(found, Sensitivity):
        return sensitivity_page(found, command="").sections
    if isinstance(found, Profiles):
        return (Section("profiles", "Profiles", (profile_group(found),)),)
    raise DeclarationError(
        f"figures: a {type(found).__name__} has none. Give what compare, discover, identify, sensitivity or "
        "profile answered."
    )


def _drawn(sections: tuple[Section, ...]) -> Iterator[Figure]:
    for part in (part for section in sections for part in section.parts):
        if isinstance(part, FigureGroup):
            yield from part.figures
        elif isinstance(part, Figure):
            yield part


def _unpacked(spec):
    """The specification with numpy arrays where the page has base64, see `figure.packed`."""
    if isinstance(spec, dict) and "bdata" in spec:
        return unpacked(spec)
    if isinstance(spec, dict):
        return {key: _unpacked(value) for key, value in spec.items()}
    return [_unpacked(value) for value in spec] if isinstance(spec, list) else spec
