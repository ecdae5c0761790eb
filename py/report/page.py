"""A page from composable pieces: sections of tables, figures and notes, written as HTML, Markdown and JSON."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import jinja2
from markupsafe import Markup

from hydrotwin.models.language.writing import json_values, write_whole

from .figure import Figure, FigureGroup
from .tables import Table, markdown_text
from .thumbnail import thumbnail

TEMPLATES = Path(__file__).parent / "templates"


@dataclass(frozen=True)
class Note:
    """Paragraphs between tables and figures; ``tone`` is "" or "warning"."""

    paragraphs: tuple[str, ...]
    tone: str = ""


@dataclass(frozen=True)
class Section:
    """A titled part of the page; ``lead`` says in a sentence or two how to read it."""

    id: str
    title: str
    parts: tuple[Table | Figure | FigureGroup | Note, ...]
    lead: str = ""


@dataclass(frozen=True)
class Page:
    """A report: what the first screen says, the sections below, and ``data`` for the JSON beside the tables.

    eyebrow : small line above the title.  answer : the result in one sentence.  picture : the figure right below it.
    results : what it says in numbers, set off.  facts : the sentences below it.
    headline : the table of the first screen.  notices : what went wrong and must not be missed.
    """

    title: str
    eyebrow: str
    answer: str
    headline: Table
    sections: tuple[Section, ...]
    results: tuple[str, ...] = ()
    facts: tuple[str, ...] = ()
    notices: tuple[str, ...] = ()
    data: dict | None = None
    picture: Figure | None = None

    @property
    def tables(self) -> Iterator[Table]:
        """All tables, the headline first."""
        yield self.headline
        for section in self.sections:
            yield from (part for part in section.parts if isinstance(part, Table))


def write_page(
    page: Page, folder: str | Path, *, stem: str = "report", data_name: str = "report.json"
) -> dict[str, Path]:
    """Write ``stem``.html, ``stem``.md and ``data_name`` into ``folder``; the paths by "html", "markdown", "json"."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = {"html": folder / f"{stem}.html", "markdown": folder / f"{stem}.md", "json": folder / data_name}
    write_whole(paths["html"], as_html(page))
    write_whole(paths["markdown"], as_markdown(page))
    write_whole(paths["json"], as_json(page))
    return paths


def as_html(page: Page) -> str:
    """The page as one HTML file that needs nothing else: style, script and Plotly (packed) are inside."""
    return _environment().get_template("page.html.j2").render(page=page, plotly=_plotly(), licence=_licence())


def as_markdown(page: Page) -> str:
    """The page as Markdown: the same sentences and tables, without the figures."""
    text = markdown_text
    lines = [f"# {text(page.title)}", "", text(page.eyebrow), "", f"**{text(page.answer)}**", ""]
    lines += [line for fact in (*page.results, *page.facts) for line in (text(fact), "")]
    lines += [line for notice in page.notices for line in (f"> {text(notice)}", "")]
    lines += _table_lines(page.headline)
    for section in page.sections:
        lines += [f"## {text(section.title)}", ""]
        lines += [text(section.lead), ""] if section.lead else []
        for part in section.parts:
            if isinstance(part, Table):
                lines += _table_lines(part)
            elif isinstance(part, Note):
                lines += [line for paragraph in part.paragraphs for line in (text(paragraph), "")]
    return "\n".join(lines).rstrip() + "\n"


def as_json(page: Page) -> str:
    """The page's data and every table, SI values beside the texts shown; numbers that do not exist are null."""
    content = {"title": page.title, "answer": page.answer, "facts": (*page.results, *page.facts)}
    content["notices"] = page.notices
    content |= page.data or {}
    content["tables"] = {t.id: t.as_json() for t in page.tables}
    return json.dumps(json_values(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _table_lines(table: Table) -> list[str]:
    title = [f"### {markdown_text(table.title)}", ""] if table.title else []
    note = [markdown_text(table.note), ""] if table.note else []
    return [*title, table.as_markdown(), "", *note]


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["packed"] = _spec_data
    environment.filters["thumbnail"] = thumbnail
    environment.tests["table"] = lambda part: isinstance(part, Table)
    environment.tests["figure"] = lambda part: isinstance(part, Figure)
    environment.tests["group"] = lambda part: isinstance(part, FigureGroup)
    environment.globals["text_of"] = lambda name: Markup((TEMPLATES / name).read_text(encoding="utf-8"))
    return environment


def _spec_data(spec: dict) -> Markup:
    """A specification of Plotly as a packed script."""
    return _packed("spec", json.dumps(json_values(spec), separators=(",", ":"), ensure_ascii=False, allow_nan=False))


def _packed(name: str, text: str) -> Markup:
    """A script element of this class that holds text packed: base64 of raw deflate, unpacked by inflate.js."""
    whole = text.encode("utf-8")
    packing = zlib.compressobj(9, wbits=-zlib.MAX_WBITS)
    packed = base64.b64encode(packing.compress(whole) + packing.flush()).decode("ascii")
    return Markup(f'<script type="text/plain" class="{name}" data-size="{len(whole)}">{packed}</script>')


@cache
def _plotly() -> Markup:
    from plotly.offline import get_plotlyjs

    return _packed("library", get_plotlyjs())


@cache
def _licence() -> str:
    """What plotly.js says of itself in its first comment."""
    from plotly.offline import get_plotlyjs

    comment = get_plotlyjs().partition("*/")[0]
    return "\n".join(line.strip(" /*") for line in comment.splitlines() if line.strip(" /*"))
