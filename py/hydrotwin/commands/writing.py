"""What `gap` leaves in its folder: the answer, the best so far while it is looked for, or why there is none.

Nothing that is there is lost before something whole takes its place: an answer of an earlier run is put aside when the
best so far is written, and stays where it is when a run fails.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from hydrotwin import __version__
from hydrotwin.models.language.errors import HydrotwinError
from hydrotwin.models.language.model_file import write_model_file
from hydrotwin.models.language.writing import json_values, write_whole
from hydrotwin.records import Record

from ..loading import sha256_of
from .shared import err, mark

DATA, FAILURE = "gap.json", "failure.json"
ANSWER = (DATA, "report.html", "report.md", "model.toml", "model.mo")
EARLIER = "earlier_answer"  # folder of the answer of an earlier run, there while DATA says SO_FAR
SO_FAR = "so far"  # true in DATA, and in the provenance of the model file, while the search goes on


@dataclass(frozen=True)
class Made:
    """What a model file of gap says about its making, and the evidence for its block [credibility]."""

    provenance: dict
    evidence: object

    @classmethod
    def of(cls, found, train: list[Record], judged: list[Record]) -> Made:
        """Of a discovery from recordings to learn from and to judge by."""
        from hydrotwin.discovery.answer.evidence import evidence_of_gap

        return cls(gap_provenance(found, train, judged), evidence_of_gap(found, train, judged))


def write_discovery(found, origin_of_model: str, folder: Path, made: Made, so_far: bool = False) -> None:
    """The report, the model with its effects as model.toml and as model.mo; ``so_far``: marked as not final.

    The mark is the first that is written and the last that goes.
    """
    from hydrotwin.models.language.modelica import modelica_text
    from hydrotwin.report.gap import gap_page
    from hydrotwin.report.page import as_json, write_page

    page, provenance = gap_page(found), made.provenance
    if so_far:
        page, provenance = _marked(page), {SO_FAR: True, **provenance}
        put_aside(folder)
        write_whole(folder / DATA, as_json(page))
    values = getattr(found.fit_after, "flat", None) or found.model.flat
    additions = found.model.additions
    write_model_file(folder / "model.toml", origin_of_model, values, provenance, additions, made.evidence)
    write_whole(folder / "model.mo", modelica_text(getattr(found.model, "opened", found.model)))
    write_page(page, folder, data_name=DATA)
    (folder / FAILURE).unlink(missing_ok=True)
    if not so_far:
        forget_earlier(folder)


def _marked(page):
    """A page whose first sentence and data say that the search goes on."""
    from hydrotwin.discovery.answer.words import lowered

    sentence = f"So far: {lowered(page.answer)}"
    return dataclasses.replace(page, answer=sentence, data={**page.data, SO_FAR: True, "answer": sentence})


def gap_provenance(found, train: list[Record], judged: list[Record]) -> dict:
    """What the model file says about its making."""
    from hydrotwin.identification.bands import Spread
    from hydrotwin.identification.evidence import names_of
    from hydrotwin.models.language.credibility import recording_rows
    from hydrotwin.models.language.equations import equations_digest
    from hydrotwin.models.language.provenance import EQUATIONS, SPREAD, TRAIN, of_earlier_fits
    from hydrotwin.records import row_of

    names = names_of(found.model.flat)
    fitted = getattr(found.fit_after, "covariance", None) is not None
    steps = [{"effect": s.effect, "site": s.site, "probability": float(s.probability)} for s in found.steps]
    return {
        "made_by": f"hydrotwin {__version__}",
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "recordings": [
            *(row_of(r, names, TRAIN) for r in train),
            *recording_rows(judged, "validate"),
            *of_earlier_fits(found.model.provenance),
        ],
        **({"fmu": {"sha256": sha256_of(Path(found.model.fmu.path))}} if hasattr(found.model, "fmu") else {}),
        "verdict": found.verdict,
        "effects": steps,
        "noise": dict(found.noise),
        "rmse": {role: {o.output: o.rmse_after for o in rows} for role, rows in found.outputs.items()},
        "findings": [str(f) for f in found.findings],
        EQUATIONS: equations_digest(found.model.flat),
        **({SPREAD: Spread.of(found.fit_after).told()} if fitted else {}),
    }


@dataclass
class BestSoFar:
    """Writes each answer so far, and says on the screen what is new in it.

    A folder that cannot be written to now does not end the search.
    """

    folder: Path
    write: Callable[..., None]
    silent: bool = False
    said: str = ""

    def __call__(self, found) -> None:
        try:
            self.write(found, so_far=True)
        except (HydrotwinError, OSError) as error:
            mark(err, "note", f"the best so far could not be written: {error}")
            return
        if found.answer != self.said and not self.silent:
            err.print(f"so far ({found.seconds:.0f} s): {found.answer} See {self.folder / 'report.html'}", style="dim")
        self.said = found.answer

    @property
    def left(self) -> str:
        """What an interrupted run has left, in a sentence or two."""
        aside = self.folder / EARLIER
        told = [f"The best so far is in {self.folder}."] if so_far_in(self.folder) else []
        return " ".join([*told, *([f"The answer of an earlier run is in {aside}."] if aside.is_dir() else [])])


def write_failure(name: str, sentence: str, folder: Path, seconds: float) -> str:
    """A gap.json that says why there is no answer; where the folder has any but of a failure, failure.json says it.

    Returns a sentence on what was kept, empty where there was nothing.
    """
    empty = {"steps": [], "noise": {}, "train": {}, "validate": {}, "separating_experiment": None}
    content = {"model": name, "failed": True, "verdict": "unknown", "answer": sentence, **empty, "seconds": seconds}
    content |= {"candidates": [], "not_testable": [], "probabilities": {}, "untried": [], "findings": [sentence]}
    kept = worth_keeping(folder / DATA)
    file = folder / (FAILURE if kept else DATA)
    write_whole(file, json.dumps(json_values(content), indent=2, ensure_ascii=False) + "\n")
    if not kept:
        return ""
    what = "holds the best so far" if so_far_in(folder) else "is that of an earlier run"
    return f"{folder / DATA} {what}; why this run failed is in {file}"


def worth_keeping(file: Path) -> bool:
    """Whether a gap.json is there and does not itself say that a run failed; one that cannot be read is kept."""
    content = _content(file)
    return file.exists() and not (isinstance(content, dict) and content.get("failed"))


def so_far_in(folder: Path) -> bool:
    """Whether the folder holds the best so far of a search that has not come to its end."""
    content = _content(folder / DATA)
    return isinstance(content, dict) and bool(content.get(SO_FAR))


def _content(file: Path):
    """What is in a JSON file, None where there is none that can be read."""
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def put_aside(folder: Path) -> None:
    """Copy a final answer that stands in the folder to one of its own, whole or not at all."""
    if not worth_keeping(folder / DATA) or so_far_in(folder):
        return
    forget_earlier(folder)
    beside = folder / f".{EARLIER}"
    shutil.rmtree(beside, ignore_errors=True)
    beside.mkdir()
    for name in ANSWER:
        with contextlib.suppress(FileNotFoundError):
            shutil.copy2(folder / name, beside / name)
    beside.rename(folder / EARLIER)


def forget_earlier(folder: Path) -> None:
    """Remove what was put aside, and nothing that somebody else has put there."""
    for name in ANSWER:
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            (folder / EARLIER / name).unlink()
    with contextlib.suppress(OSError):
        (folder / EARLIER).rmdir()
