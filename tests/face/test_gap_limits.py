"""gap on the command line: effort and time limit, the best so far, and that no run destroys an answer."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from types import SimpleNamespace
from unittest import mock

import pytest

import hydrotwin as ht
from hydrotwin.commands import discovering, writing
from hydrotwin.discovery.answer import so_far
from hydrotwin.discovery.discover import discover
from hydrotwin.models.language.errors import DataError, SolveError
from hydrotwin.records import write_record
from tests.discovery.slides import Inline, records, slide
from tests.face.command_line import ROOT, contents, hydrotwin

EFFECTS = ("coulomb_friction", "dead_time")
TRY = tuple(word for effect in EFFECTS for word in ("--effects", effect))
GAP = ("gap", "slide.py:slide", "a.csv", "b.csv", "--validate", "v.csv", *TRY, "--out", "gap")
THREADS = ("--executor", "here")
RUBBING = {"dry": 60.0, "seconds": 5.0}  # N, s: the friction is seen at once
FILES = {"gap.json", "report.html", "report.md", "model.toml", "model.mo"}
OF_THE_RUN = ("seconds", "created", "command", "timings", "tables")  # differ from run to run, or say the others again


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A folder with a slide that has dry friction, recorded three times."""
    folder = tmp_path_factory.mktemp("slide")
    for name, record in zip("abv", records(3, **RUBBING), strict=True):
        write_record(record, folder / f"{name}.csv")
    (folder / "slide.py").write_text("from tests.discovery.slides import slide\n\n__all__ = ['slide']\n")
    return folder


@pytest.fixture
def here(recorded, tmp_path, monkeypatch):
    """A folder of its own with the same."""
    for path in recorded.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def at_once(monkeypatch):
    """The best so far is told between all batches."""
    for name in ("AFTER", "EVERY"):
        monkeypatch.setattr(so_far, name, 0.0)
    monkeypatch.setattr(so_far, "COSTS", 1.0)


@pytest.fixture
def asked(monkeypatch):
    """`discover` in its place; the test says what it does."""
    replaced = mock.Mock(side_effect=SolveError("slide: stop here."))
    monkeypatch.setattr(sys.modules["hydrotwin.discovery.discover"], "discover", replaced)
    return replaced


def answer_of(folder) -> dict:
    """gap.json without what differs from run to run."""
    content = json.loads((folder / "gap.json").read_text(encoding="utf-8"))
    return {key: value for key, value in content.items() if key not in OF_THE_RUN}


def breaking(monkeypatch, error, after: int = 1) -> list[dict]:
    """Every best so far as gap.json holds it; ``error`` is raised behind the last of so many."""
    seen, write = [], writing.write_discovery

    def written(found, origin, folder, provenance, so_far=False):
        write(found, origin, folder, provenance, so_far)
        if so_far:
            seen.append(json.loads((folder / "gap.json").read_text(encoding="utf-8")))
            if len(seen) == after:
                raise error

    monkeypatch.setattr(discovering, "write_discovery", written)
    return seen


# -- effort and time limit ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("text", "seconds"),
    [("90", 90), ("90s", 90), ("5min", 300), ("5 min", 300), ("5m", 300), ("1.5h", 5400), ("1h30min", 5400),
     ("1H 30Min 5s", 5405), ("0.5", 0.5)],
)  # fmt: skip
def test_a_time_limit_is_a_duration(here, asked, text, seconds):
    hydrotwin(*GAP, "--time-limit", text)
    assert asked.call_args.kwargs["time_limit"] == seconds


@pytest.mark.parametrize(
    "text", ["", "soon", "0", "0s", "-5", "inf", "nan", "1h30", "5min 5min", "3 km", "min", "30s1h"]
)
def test_what_is_no_duration_is_told_before_anything_runs_or_is_written(here, asked, text):
    before = contents(here)
    answer = hydrotwin(*GAP, f"--time-limit={text}")
    assert answer.code == 2 and "no duration. Write for example 90s, 5min" in answer.said
    assert not asked.called and contents(here) == before


def test_effort_is_handed_on_and_there_is_no_limit_unless_one_is_given(here, asked):
    for words, effort in (((), "normal"), (("--effort", "quick"), "quick"), (("--effort", "thorough"), "thorough")):
        hydrotwin(*GAP, *words)
        assert (asked.call_args.kwargs["effort"], asked.call_args.kwargs["time_limit"]) == (effort, None)


def test_an_unknown_effort_is_told_before_anything_runs_or_is_written(here, asked):
    before = contents(here)
    answer = hydrotwin(*GAP, "--effort", "through")
    assert answer.code == 2 and "Did you mean 'thorough'" in answer.said
    assert not asked.called and contents(here) == before


def test_what_a_short_limit_ends_is_an_answer_that_says_so(here):
    answer = hydrotwin(*GAP, *THREADS, "--effort", "quick", "--time-limit", "0.001s")
    assert answer.code == 0, answer.err
    found = answer_of(here / "gap")
    assert "so far" not in found and any("the time limit ended the search" in f for f in found["findings"])


# -- the best so far ---------------------------------------------------------------------------------------------------
def test_an_answer_so_far_is_told_when_it_is_due_and_changes_nothing(at_once, monkeypatch):
    told = []
    words = {"effects": EFFECTS, "executor": Inline(), "step": 5e-3, "validate": records(1, first=7, **RUBBING)}
    plain = discover(slide(), records(2, **RUBBING), **words)
    found = discover(slide(), records(2, **RUBBING), so_far=told.append, **words)
    assert found.answer == plain.answer and found.probabilities == plain.probabilities
    assert [p.value for s in found.steps for p in s.parameters] == [p.value for s in plain.steps for p in s.parameters]
    assert (found.screened, found.fitted) == (plain.screened, plain.fitted)
    first, last = told[0], told[-1]
    assert first.verdict == "unknown" and "nothing that was fitted explains it yet: 0 of 2 candidates" in first.answer
    assert last.findings[0].startswith("gap: the search goes on") and last.given == {"train": 2, "validate": 1}
    assert [t.seconds for t in told] == sorted(t.seconds for t in told) and found.findings == plain.findings
    told.clear()
    monkeypatch.setattr(so_far, "AFTER", 1e6)
    discover(slide(), records(2, **RUBBING), so_far=told.append, **words)
    assert not told, "not before it is due"


def test_what_an_answer_so_far_looks_at_the_search_does_not_see(at_once, monkeypatch):
    made, sizes = so_far.answer, []

    def curious(search, *words):
        assert search.pause is None and search.jobs.further(search.table.entry()).iterations == 1
        search.table.entry(search.table.candidates)
        return made(search, *words)

    def last(search, *words):
        sizes.append(max(len(key) for key in search.table.entries))
        return plain(search, *words)

    plain = sys.modules["hydrotwin.discovery.discover"].answer
    monkeypatch.setattr(so_far, "answer", curious)
    monkeypatch.setattr(sys.modules["hydrotwin.discovery.discover"], "answer", last)
    told, words = [], {"effects": EFFECTS, "executor": Inline(), "step": 5e-3}
    found = discover(slide(), records(2, **RUBBING), so_far=told.append, **words)
    assert found.verdict == "named" and told and sizes == [1]


def test_answers_so_far_take_little_of_the_time(monkeypatch):
    clock, told = SimpleNamespace(now=1000.0, takes=1.0), []

    def made(*_):
        clock.now += clock.takes
        return SimpleNamespace(steps=())

    monkeypatch.setattr(so_far.time, "monotonic", lambda: clock.now)
    monkeypatch.setattr(so_far, "as_it_stands", made)
    pause = so_far.SoFar(told.append, lambda found: found).of(None, None)
    for now, takes, known in ((1044, 1, 0), (1046, 1, 1), (1106, 1, 1), (1108, 20, 2), (1300, 1, 2), (1309, 1, 3)):
        clock.now, clock.takes = now, takes
        pause(at_base(fitted=True))
        assert len(told) == known, now
    clock.now = 9999.0
    pause(at_base(fitted=False))
    assert len(told) == 3, "without a fitted base there is nothing to tell"


def at_base(fitted: bool):
    """As much of a search as is looked at before an answer is made."""
    return SimpleNamespace(table=SimpleNamespace(entries={(): SimpleNamespace(fitted=fitted)}))


def test_an_answer_so_far_that_cannot_be_made_costs_itself_only(at_once, monkeypatch):
    def failing(*_):
        raise SolveError("slide: no last fit.")

    monkeypatch.setattr(so_far, "as_it_stands", failing)
    found = discover(
        slide(), records(2, **RUBBING), effects=EFFECTS[:1], executor=Inline(), step=5e-3, so_far=pytest.fail
    )
    assert found.verdict == "named"


def test_page_json_and_model_say_that_they_are_so_far_and_cease_to(here, at_once, monkeypatch):
    seen = breaking(monkeypatch, KeyboardInterrupt, after=2)
    stopped = hydrotwin(*GAP, *THREADS)
    assert stopped.code == 130
    assert "The best so far is in gap." in stopped.said and "so far (" in stopped.err
    assert [s["so far"] for s in seen] == [True, True]
    assert {p.name for p in (here / "gap").iterdir()} == {*FILES, ".unfinished"}, "whole files, and the finished fits"
    assert seen[-1]["answer"].startswith("So far: ")
    first = (here / "gap/report.md").read_text(encoding="utf-8").split("**")[1]
    assert first == seen[-1]["answer"] and first in (here / "gap/report.html").read_text(encoding="utf-8")
    assert tomllib.loads((here / "gap/model.toml").read_text(encoding="utf-8"))["provenance"]["so far"] is True
    assert ht.load("slide.py:slide@gap/model.toml")
    monkeypatch.undo()
    monkeypatch.chdir(here)
    answer = hydrotwin(*GAP, *THREADS)
    assert answer.code == 0, answer.err
    assert {p.name for p in (here / "gap").iterdir()} == FILES
    for name in ("gap.json", "report.md", "model.toml"):
        assert "so far" not in (here / "gap" / name).read_text(encoding="utf-8").lower(), name


def test_what_was_interrupted_goes_on_to_the_same_answer(here, at_once, monkeypatch):
    with monkeypatch.context() as quiet:
        quiet.setattr(so_far, "AFTER", 1e6)
        assert hydrotwin(*GAP[:-1], "whole", *THREADS).code == 0
    breaking(monkeypatch, KeyboardInterrupt, after=3)
    assert hydrotwin(*GAP, *THREADS).code == 130
    answer = hydrotwin(*GAP, *THREADS)
    assert answer.code == 0 and "going on:" in answer.err
    assert answer_of(here / "gap") == answer_of(here / "whole")


def test_a_folder_that_takes_no_answer_so_far_does_not_end_the_search(here, at_once, monkeypatch):
    breaking(monkeypatch, DataError("gap/model.mo: cannot be written (No space left)."))
    answer = hydrotwin(*GAP, *THREADS)
    assert answer.code == 0, answer.err
    assert "the best so far could not be written: gap/model.mo" in answer.said


def test_ctrl_c_in_a_terminal_leaves_the_best_so_far(here):
    begin = (
        "import time\nfrom hydrotwin import cli\nfrom hydrotwin.commands import discovering\n"
        "from hydrotwin.discovery.answer import so_far\nso_far.AFTER, write = 0.0, discovering.write_discovery\n"
        "def written(*words):\n    write(*words)\n    open('ready', 'w').close()\n    time.sleep(60)\n"
        "discovering.write_discovery = written\ncli.main()\n"
    )
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    run = subprocess.Popen(
        [sys.executable, "-c", begin, *GAP], env={**os.environ, "PYTHONPATH": path}, stderr=subprocess.PIPE, text=True
    )
    try:
        until = time.monotonic() + 60
        while not (here / "ready").exists() and run.poll() is None and time.monotonic() < until:
            time.sleep(0.02)
        run.send_signal(signal.SIGINT)
        said = run.communicate(timeout=20)[1]
    finally:
        run.kill()
    assert run.returncode == 130, said
    assert "The best so far is in gap." in said and answer_of(here / "gap")["so far"] is True


# -- what was there before ---------------------------------------------------------------------------------------------
@pytest.fixture
def answered(here):
    """A folder with an answer."""
    assert hydrotwin(*GAP, *THREADS).code == 0
    return here


def test_a_run_that_fails_where_there_is_no_answer_says_so_in_gap_json(here, asked):
    (here / "gap").mkdir()
    (here / "gap/model.toml").write_text("mine")
    for sentence in ("first.", "second."):
        asked.side_effect = SolveError(sentence)
        assert hydrotwin(*GAP).code == 1
        assert answer_of(here / "gap")["findings"] == [sentence]
    assert {p.name for p in (here / "gap").iterdir()} == {"gap.json", "model.toml"}
    assert (here / "gap/model.toml").read_text() == "mine", "what somebody else has put there stays"


def test_an_answer_is_put_aside_for_the_best_so_far_and_goes_when_the_next_is_there(answered, at_once, monkeypatch):
    before = contents(answered / "gap")
    with monkeypatch.context() as patch:
        breaking(patch, KeyboardInterrupt, after=2)
        stopped = hydrotwin(*GAP, *THREADS)
        assert stopped.code == 130 and "The answer of an earlier run is in gap/earlier_answer." in stopped.said
    assert contents(answered / "gap/earlier_answer") == before
    with monkeypatch.context() as patch:
        breaking(patch, KeyboardInterrupt)
        assert hydrotwin(*GAP, *THREADS).code == 130
    assert contents(answered / "gap/earlier_answer") == before, "what is not final takes nobody's place"
    assert hydrotwin(*GAP, *THREADS).code == 0
    assert {p.name for p in (answered / "gap").iterdir()} == FILES


def test_what_failed_is_forgotten_with_the_next_answer(answered, asked, monkeypatch):
    asked.side_effect = SolveError("it diverges.")
    assert hydrotwin(*GAP).code == 1 and (answered / "gap/failure.json").exists()
    monkeypatch.undo()
    monkeypatch.chdir(answered)
    assert hydrotwin(*GAP, *THREADS).code == 0
    assert {p.name for p in (answered / "gap").iterdir()} == FILES


def test_a_search_that_begins_anew_puts_nothing_less_in_the_place_of_what_was_told(monkeypatch):
    answers = {"first": ("a leak",), "anew": ()}
    monkeypatch.setattr(so_far, "as_it_stands", lambda search, data, model: SimpleNamespace(steps=answers[search.name]))
    for name in ("EVERY", "COSTS"):
        monkeypatch.setattr(so_far, name, 1e-9)
    told, table = [], SimpleNamespace(entries={(): SimpleNamespace(fitted=True)})
    first, anew = (SimpleNamespace(name=name, table=table) for name in answers)
    teller = so_far.SoFar(lambda found: told.append(found.steps), lambda found: found)
    for search, steps in ((first, ("a leak",)), (anew, ()), (first, ()), (anew, ()), (anew, ("a lag",)), (anew, ())):
        answers[search.name], teller.due = steps, 0.0
        teller.of(None, None)(search)
    assert told == [("a leak",), (), ("a lag",), ()], "it changes its own mind, and no other does until it found more"
