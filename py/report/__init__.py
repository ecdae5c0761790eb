"""Report: what was found, as one page that needs nothing else, as Markdown and as JSON."""

from hydrotwin.comparison.notices import notices, notices_of_variants, remarks, starts_told, twins

from .answer import answer
from .figure import Figure, FigureGroup, Style, decimate, error_bars, layout, line, styles
from .fit import ParameterRow, fit_section, parameter_rows
from .format import number_text, pretty_unit, shown_unit
from .gap import gap_page, write_gap_report
from .gap_data import gap_data
from .matrix import matrix_page, write_matrix, write_variant
from .page import Note, Page, Section, as_html, as_json, as_markdown, write_page
from .plotly_figures import figures
from .schema import compare_schema
from .sensitivity import sensitivity_page, write_sensitivity
from .tables import Cell, Column, Table, counts, numbers, table, texts, warned
from .write import comparison_page, display_units, write_report

__all__ = [
    "Cell",
    "Column",
    "Figure",
    "FigureGroup",
    "Note",
    "Page",
    "ParameterRow",
    "Section",
    "Style",
    "Table",
    "answer",
    "as_html",
    "as_json",
    "as_markdown",
    "compare_schema",
    "comparison_page",
    "counts",
    "decimate",
    "display_units",
    "error_bars",
    "figures",
    "fit_section",
    "gap_data",
    "gap_page",
    "layout",
    "line",
    "matrix_page",
    "notices",
    "notices_of_variants",
    "number_text",
    "numbers",
    "parameter_rows",
    "pretty_unit",
    "remarks",
    "sensitivity_page",
    "shown_unit",
    "starts_told",
    "styles",
    "table",
    "texts",
    "twins",
    "warned",
    "write_gap_report",
    "write_matrix",
    "write_page",
    "write_report",
    "write_sensitivity",
    "write_variant",
]
