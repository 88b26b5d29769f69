"""Rows on disk: chunks that appear whole or not at all, and the table that they add up to.

A chunk is written under another name and renamed when it is complete, so that a process that is killed at any moment
leaves whole chunks and at most one stray file, which is ignored. Rows are known by their key; a row that is there is
never computed again, and a key that should turn up twice is kept once.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any
from uuid import uuid4

from optsc.errors import DamagedFile, InvalidValue
from optsc.study.keys import key
from optsc.study.outcomes import Row

SUFFIX = ".parquet"


class RowStore:
    """The rows in ``directory``, one Parquet file for each chunk; made if it is missing."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        directory.mkdir(parents=True, exist_ok=True)
        self._keys: set[str] = set()
        for path in self._chunks():
            self._keys.update(_read(path, ["key"])["key"])

    @property
    def keys(self) -> frozenset[str]:
        """Keys of all rows that are there."""
        return frozenset(self._keys)

    def __contains__(self, row_key: str) -> bool:
        return row_key in self._keys

    def __len__(self) -> int:
        return len(self._keys)

    def add(self, rows: Sequence[Row]) -> int:
        """Keep those of ``rows`` that are new, in one chunk, and return how many they were."""
        fresh: dict[str, Row] = {}
        for row in rows:
            if row["key"] not in self._keys:
                fresh.setdefault(row["key"], row)
        if not fresh:
            return 0
        path = self.directory / f"{key(sorted(fresh))}{SUFFIX}"
        write_table(list(fresh.values()), path)
        self._keys.update(fresh)
        return len(fresh)

    def rows(self, order: Iterable[str] | None = None) -> list[Row]:
        """Return the rows in the ``order`` of these keys, by default sorted; raise `InvalidValue` if one is missing."""
        found: dict[str, Row] = {}
        for path in self._chunks():
            for row in read_table(path):
                found.setdefault(row["key"], row)
        wanted = sorted(found) if order is None else list(order)
        missing = [name for name in wanted if name not in found]
        if missing:
            raise InvalidValue("missing rows", f"{len(missing)}, first {missing[0]}", "none")
        return [found[name] for name in wanted]

    def _chunks(self) -> list[Path]:
        return sorted(self.directory.glob(f"*{SUFFIX}"))


def write_table(rows: Sequence[Row], path: Path) -> None:
    """Write ``rows`` to a Parquet file that appears whole or not at all; columns are those of all rows together."""
    import pyarrow
    import pyarrow.parquet

    columns = list(dict.fromkeys(name for row in rows for name in row))
    table = pyarrow.table({name: _column([row.get(name) for row in rows]) for name in columns})
    part = path.with_name(f".{path.name}.{uuid4().hex}.part")
    try:
        pyarrow.parquet.write_table(table, part)
        with open(part, "rb") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def _column(values: list[Any]) -> list[Any]:
    """Return values of one type: numbers as floats where any is one."""
    if any(isinstance(value, float) for value in values):
        return [None if value is None else float(value) for value in values]
    return values


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """Write ``rows`` as CSV: numbers with all their digits, an empty cell for what is missing or no number."""
    import csv

    columns = list(dict.fromkeys(name for row in rows for name in row))
    part = path.with_name(f".{path.name}.part")
    with open(part, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for row in rows:
            cells = [row.get(name) for name in columns]
            writer.writerow(["" if cell is None or cell != cell else cell for cell in cells])
    os.replace(part, path)


def read_table(path: Path) -> list[Row]:
    """Return the rows of a Parquet file; raise `DamagedFile`."""
    columns = _read(path, None)
    names = list(columns)
    return [dict(zip(names, values, strict=True)) for values in zip(*columns.values(), strict=True)]


def _read(path: Path, names: list[str] | None) -> dict[str, list[Any]]:
    import pyarrow
    import pyarrow.parquet

    try:
        return pyarrow.parquet.read_table(path, columns=names).to_pydict()
    except (pyarrow.ArrowException, OSError) as error:
        raise DamagedFile(path, f"is no table of rows ({error})") from None
