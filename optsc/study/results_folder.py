"""Result files of a command: tables of rows as Parquet and CSV, a summary as strict JSON with the versions used."""

from __future__ import annotations

import csv
import io
import json
import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from optsc.cache import write_atomically
from optsc.errors import DamagedFile
from optsc.study.fingerprint import plain
from optsc.study.outcomes import Row

PACKAGES = ("numpy", "scipy", "pin", "casadi", "daqp", "ruckig", "pybullet")
"""Packages whose versions a summary names."""


def save_rows(rows: Sequence[Row], directory: Path, name: str = "table") -> None:
    """Write ``rows`` as ``name.parquet`` and ``name.csv``."""
    directory.mkdir(parents=True, exist_ok=True)
    write_table(rows, directory / f"{name}.parquet")
    write_csv(rows, directory / f"{name}.csv")


def write_table(rows: Sequence[Row], path: Path) -> None:
    """Write ``rows`` to a Parquet file that appears whole or not at all; columns are those of all rows together."""
    import pyarrow
    import pyarrow.parquet

    table = pyarrow.table({name: _column([row.get(name) for row in rows]) for name in _columns(rows)})
    buffer = io.BytesIO()
    pyarrow.parquet.write_table(table, buffer)
    write_atomically(path, buffer.getvalue())


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """Write ``rows`` as CSV: numbers with all their digits, an empty cell for what is missing or no number."""
    columns, text = _columns(rows), io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        cells = [row.get(name) for name in columns]
        writer.writerow(["" if cell is None or cell != cell else cell for cell in cells])
    write_atomically(path, text.getvalue())


def read_table(path: Path, columns: Sequence[str] | None = None) -> list[Row]:
    """Return the rows of a Parquet file, with all or some ``columns``; raise `DamagedFile`."""
    import pyarrow
    import pyarrow.parquet

    try:
        return pyarrow.parquet.read_table(path, columns=columns and list(columns)).to_pylist()
    except (pyarrow.ArrowException, OSError) as error:
        raise DamagedFile(path, f"is no table of rows ({error})") from None


def _columns(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(name for row in rows for name in row))


def _column(values: list[Any]) -> list[Any]:
    """Return values of one type: all numbers as floats where any of them is a float."""
    if any(isinstance(value, float) for value in values):
        return [None if value is None else float(value) for value in values]
    return values


def save_summary(content: dict[str, Any], directory: Path) -> dict[str, Any]:
    """Write ``summary.json`` with ``content`` and facts about the machine, and return what was written."""
    import optsc

    facts = {"optsc": optsc.__version__, "python": platform.python_version(), "machine": platform.platform()}
    summary = {**content, "versions": {**facts, **{name: _version(name) for name in PACKAGES}}}
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "summary.json").write_text(strict_json(summary), encoding="utf-8")
    return summary


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"


def strict_json(content: Any) -> str:
    """Return the text of ``content`` as JSON, with null for NaN and infinity, which JSON does not have.

    Raises `InvalidValue` for what `optsc.study.fingerprint.plain` has no form for.
    """
    return json.dumps(_finite(plain(content)), indent=2, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not abs(value) < float("inf") else value
