"""The record that an FMU carries along: where its model was fitted and judged, and of which state of it."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from hydrotwin.models.language.credibility import KEY, Credibility, from_data
from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import SD
from hydrotwin.models.language.provenance import MARKED, SINCE

from .archive import file_names
from .related import FOLDER, content_of

RECORD_FILE = f"{FOLDER}/credibility.toml"
MADE_OF = ("modelDescription.xml", "sources/", "binaries/")
RECORD_FORMAT = "hydrotwin-credibility/1"  # its number goes up where keys change their meaning or go


@dataclass(frozen=True)
class Inside:
    """The record that an FMU carries along.

    contents : hash of the parameter values that it is of. files : those beside it, by hash. made_of : the same of the
    description, the sources and the binaries; older records do not have it.
    """

    made_by: str
    model: str
    contents: str
    credibility: Credibility
    files: Mapping[str, str]
    made_of: Mapping[str, str] = field(default_factory=dict)


def record_of(path: Path) -> Inside:
    """The record inside an FMU. Raises DataError where it is missing, damaged, changed or of a newer version."""
    try:
        told = tomllib.loads(content_of(path, RECORD_FILE).decode())
        if told["format"] != RECORD_FORMAT:
            raise DataError(
                f"{RECORD_FILE}: of another version ('{told['format']}', this one reads '{RECORD_FORMAT}'). Update "
                "hydrotwin, or export the FMU again."
            )
        own = (str(told["made_by"]), str(told["model"]), str(told["parameters_sha256"]))
        made_of = dict(told.get("made_of", {}))
        return Inside(*own, from_data(told.get(KEY), RECORD_FILE), dict(told["files"]), made_of)
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"{RECORD_FILE}: damaged ({type(error).__name__}: {error}). Export the FMU again.") from None


def changed_files(path: Path, inside: Inside) -> list[str]:
    """Files of the record that are no longer what it was made with, or gone.

    Sources and binaries may be gone, for who passes an FMU on may leave them out.
    """
    here = set(file_names(path))
    asked = {**inside.files, **{name: digest for name, digest in inside.made_of.items() if name in here}}
    return [n for n, digest in asked.items() if n not in here or sha256_of(content_of(path, n)) != digest]


def added_files(path: Path, inside: Inside) -> list[str]:
    """Sources and binaries that came later: a binary for another system computes what nobody judged."""
    return [n for n in made_of(path) if n not in inside.made_of] if inside.made_of else []


def made_of(path: Path) -> list[str]:
    """Names of what an FMU computes with and says of itself: units, start values, equations."""
    return [n for n in file_names(path) if n.startswith(MADE_OF) and not n.endswith("/")]


def made_from_inside(path: Path, outputs: Sequence[str]) -> dict:
    """Of which recordings the values of an FMU follow, as its record says, and that it tells no bands: a provenance.

    Empty without a record, or with one that cannot be read, which `check` tells.
    """
    try:
        known = record_of(path).credibility if RECORD_FILE in file_names(path) else Credibility()
    except DataError:
        return {}
    rows = [row for row in known.fitted_on if row["sha256"] or MARKED in row]
    if not rows:
        return {}
    told = [one.facts.get(SINCE) for one in known.evidence]
    since = [str(word) for words in told if isinstance(words, list | tuple) for word in words]
    seen = {(row["sha256"], str(row.get(MARKED))): row for row in rows}
    own_band = any(name.endswith(SD) for name in outputs)
    return {"trained_on": [*seen.values()], SINCE: since if own_band else [*since, "an FMU, which holds no covariance"]}


def sha256_of(content: str | bytes) -> str:
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()
