"""Reading a recording of which every column is needed."""

from __future__ import annotations

from hydrotwin.models.language.errors import DataError
from hydrotwin.records import read_record


def whole(path, **said):
    """The recording; a column that cannot be used is raised, as it is for whoever needs it."""
    record = read_record(path, **said)
    for name, why in record.refused.items():
        try:
            record[name]
        except DataError as error:
            assert str(error) == why
            raise
    return record
