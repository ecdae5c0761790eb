"""What an earlier run has left in the folder of a report: its own goes, a stranger's stays."""

from __future__ import annotations

import json

import pytest

from hydrotwin.report.written import MANIFEST, forget_others, note_written


def page(folder, variant):
    """The files of the page of a variant, listed."""
    (folder / variant).mkdir(parents=True, exist_ok=True)
    files = [folder / variant / name for name in ("report.html", "compare.json")]
    for file in files:
        file.write_text(f"{variant}: {file.name}", encoding="utf-8")
    note_written(folder, files)
    return files


def test_pages_of_variants_that_are_no_more_go_with_their_folder(tmp_path):
    kept, old = page(tmp_path, "cold"), page(tmp_path, "warm")
    assert sorted(forget_others(tmp_path, {"cold"})) == sorted(old)
    assert all(f.is_file() for f in kept) and not (tmp_path / "warm").exists()
    assert forget_others(tmp_path, {"cold"}) == []
    forget_others(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_what_is_not_its_own_stays(tmp_path):
    changed, own = page(tmp_path, "warm")
    changed.write_text("my notes", encoding="utf-8")
    (tmp_path / "warm" / "mine.txt").write_text("mine", encoding="utf-8")
    (tmp_path / "cold").mkdir()
    (tmp_path / "cold" / "report.html").write_text("of no list", encoding="utf-8")
    (tmp_path / "criteria.xml").write_text("old", encoding="utf-8")
    note_written(tmp_path, [tmp_path / "criteria.xml"])
    assert sorted(forget_others(tmp_path)) == sorted([own, tmp_path / "criteria.xml"])
    left = sorted(p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file())
    assert left == ["cold/report.html", "warm/mine.txt", "warm/report.html"]


@pytest.mark.parametrize("way", ["../other/report.html", "/etc/hostname", "a/b/c.html", "..", "C:/x", "a\\..\\b"])
def test_a_list_that_was_changed_leads_nowhere_else(tmp_path, way):
    folder = tmp_path / "report"
    own = page(folder, "warm")
    other = tmp_path / "other" / "report.html"
    other.parent.mkdir()
    other.write_bytes(own[0].read_bytes())
    told = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    told["files"] = {way: told["files"]["warm/report.html"]}
    (folder / MANIFEST).write_text(json.dumps(told), encoding="utf-8")
    assert forget_others(folder) == [] and other.is_file()
    (folder / MANIFEST).write_text("{", encoding="utf-8")
    assert forget_others(folder) == [] and own[0].is_file()


def test_a_link_is_not_followed(tmp_path):
    folder, elsewhere = tmp_path / "report", tmp_path / "elsewhere"
    files = page(folder, "warm")
    (folder / "warm").rename(elsewhere)
    (folder / "warm").symlink_to(elsewhere)
    assert forget_others(folder) == [] and all((elsewhere / f.name).is_file() for f in files)


def test_a_file_elsewhere_is_not_listed(tmp_path):
    (tmp_path / "criteria.xml").write_text("mine", encoding="utf-8")
    note_written(tmp_path / "report", [tmp_path / "criteria.xml"])
    assert not (tmp_path / "report").exists()
