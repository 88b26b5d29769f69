"""What a command leaves in its folder: tables, a summary for machines, the versions that made them."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from optsc.study.outcomes import Row
from optsc.study.strict_json import strict_json
from optsc.study.sweep.store import write_csv, write_table

PACKAGES = ("numpy", "scipy", "pin", "casadi", "daqp", "ruckig", "pybullet")
"""Packages whose versions a summary names."""


def save_rows(rows: Sequence[Row], directory: Path, name: str = "table") -> None:
    """Write ``rows`` as ``name.parquet`` and ``name.csv``."""
    directory.mkdir(parents=True, exist_ok=True)
    write_table(rows, directory / f"{name}.parquet")
    write_csv(rows, directory / f"{name}.csv")


def save_summary(content: dict[str, Any], directory: Path) -> dict[str, Any]:
    """Write ``summary.json`` with ``content`` and the machine's facts; return what was written.

    What is no number becomes null: JSON has no other word for it.
    """
    import optsc

    facts = {"optsc": optsc.__version__, "python": platform.python_version(), "machine": platform.platform()}
    summary = {**content, "versions": {**facts, **_versions()}}
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "summary.json").write_text(strict_json(summary), encoding="utf-8")
    return summary


def _versions() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "missing"
    return found
