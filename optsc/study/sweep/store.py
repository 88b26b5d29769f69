"""Row store: result rows on disk that survive a process killed at any moment.

The rows of each job are one file, a chunk, which appears whole or not at all. Rows are known by their key: a row
that is there is never computed again, and one that should turn up twice is kept once.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from optsc.errors import InvalidValue
from optsc.study.fingerprint import fingerprint
from optsc.study.outcomes import Row
from optsc.study.results_folder import read_table, write_table

SUFFIX = ".parquet"


class RowStore:
    """The rows in ``directory``, one Parquet file for each chunk; made if it is missing."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        directory.mkdir(parents=True, exist_ok=True)
        self._keys = {row["key"] for path in self._chunks() for row in read_table(path, ["key"])}

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
        new: dict[str, Row] = {}
        for row in rows:
            if row["key"] not in self._keys:
                new.setdefault(row["key"], row)
        if new:
            write_table(list(new.values()), self.directory / f"{fingerprint(sorted(new))}{SUFFIX}")
            self._keys.update(new)
        return len(new)

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
