"""What a table of timings has to say about the machine that it was measured on."""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
from pathlib import Path
from typing import Any

PACKAGES = (
    "optsc",
    "numpy",
    "pin",
    "casadi",
    "daqp",
    "ruckig",
    "qpsolvers",
    "pin-pink",
    "mink",
    "mujoco",
    "pytracik",
    "small_gicp",
)


def processor() -> str:
    """Return the processor's name, as far as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def versions() -> dict[str, str]:
    """Return the versions of what is measured, of those packages that are installed."""
    import optsc

    found = {"python": platform.python_version(), "optsc": optsc.__version__}
    for package in PACKAGES[1:]:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def machine() -> dict[str, Any]:
    """Return processor, cores, load and versions."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.release()}",
        "load": load,
        "versions": versions(),
    }


def markdown_table(header: list[str], rows: list[list[str]]) -> str:
    """Return a markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def save(directory: Path | None, name: str, facts: dict[str, Any], text: str, command: str) -> None:
    """Print ``text``, and write it beside the numbers to ``directory`` if there is one."""
    about = machine()
    used = ", ".join(f"{k} {v}" for k, v in about["versions"].items())
    foot = f"`{command}`\n\n{about['processor']}, {about['cores']} cores, load {about['load']:.1f}; {used}."
    print(f"{text}\n\n{foot}")
    if directory is not None:
        directory.mkdir(parents=True, exist_ok=True)
        numbers = json.dumps({**facts, "machine": about, "command": command}, indent=1)
        (directory / f"{name}.json").write_text(numbers + "\n", encoding="utf-8")
        (directory / f"{name}.md").write_text(f"{text}\n\n{foot}\n", encoding="utf-8")
