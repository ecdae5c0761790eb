"""The scoreboard is one page of several programs: each writes its own part and leaves the others."""

from __future__ import annotations

from benchmarks.learned.page import put_first, put_section

OTHERS = "# Title\n\nfirst\n\n## Later\n\nkept\n"


def test_a_section_is_written_anew_and_all_else_stays(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(OTHERS, encoding="utf-8")
    put_section(page, "Physics", "| a |\n")
    put_section(page, "Physics", "| b |")
    assert page.read_text(encoding="utf-8") == f"{OTHERS}\n## Physics\n\n| b |\n"
    put_first(page, "# Title\n\nanother\n")
    assert page.read_text(encoding="utf-8") == OTHERS.replace("first", "another") + "\n## Physics\n\n| b |\n"


def test_a_page_that_is_not_there_is_begun(tmp_path):
    put_section(tmp_path / "a.md", "Physics", "| a |")
    put_first(tmp_path / "b.md", "# Title")
    assert (tmp_path / "a.md").read_text(encoding="utf-8") == "## Physics\n\n| a |\n"
    assert (tmp_path / "b.md").read_text(encoding="utf-8") == "# Title\n"
