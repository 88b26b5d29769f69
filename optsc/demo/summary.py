"""What a demonstration leaves: its summary for machines, a table for people, the paper's picture, and every run."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from optsc.control.modes import Mode
from optsc.demo.demonstration import LABELS, Demo
from optsc.demo.episode import DemoEpisode
from optsc.demo.observation import perception_summary
from optsc.errors import InvalidValue
from optsc.metrics import limit_violations
from optsc.study.conditions import MANIPULABILITY_ONLY, PAPER, measure
from optsc.viewers.drawing import save_figure
from optsc.viewers.figure_approach import (
    BASELINE_COLOUR,
    PROPOSED_COLOUR,
    SelectedGrasps,
    StrategyPath,
    approach_figure,
)
from optsc.viewers.figure_scene_state import scene_state_figure

COLOURS = {PAPER.name: PROPOSED_COLOUR, MANIPULABILITY_ONLY.name: BASELINE_COLOUR}


def summary(demo: Demo) -> dict[str, Any]:
    """Return what the demonstration measured, for machines: JSON values only."""
    limits, rate = demo.setup.world.robot.limits, demo.setup.settings.rate
    runs = [episode.run for episode in demo.episodes.values()]
    kinds = ("position", "velocity", "acceleration", "jerk")
    found = [limit_violations(rate, run.q, run.v, run.a, **vars(limits)) for run in runs]
    elapsed = np.concatenate([[tick.elapsed for tick in run] for run in runs]) * 1e6
    conditions = {episode.condition.name: episode.condition for episode in demo.episodes.values()}
    perception = _perception(demo)
    return {
        "robot": demo.setup.world.robot.name,
        "seed": demo.setup.seed,
        "rate_hz": rate,
        "manipulability": str(measure(next(iter(conditions.values())).measure)),
        "objects": {
            name: {
                "candidates": _candidates(demo, name, perception),
                **{condition: demo.episodes[condition, name].measures() for condition in conditions},
            }
            for name in demo.object_names
        },
        "limit_violations": {kind: sum(getattr(one, kind) for one in found) for kind in kinds},
        "interventions": sum(_interventions(episode) for episode in demo.episodes.values()),
        "ticks": sum(len(run) for run in runs),
        "tick_p50_us": float(np.median(elapsed)),
        "tick_p99_us": float(np.percentile(elapsed, 99)),
        "commands_sha256": hashlib.sha256(b"".join(run.commands.tobytes() for run in runs)).hexdigest(),
        **({} if perception is None else {"perception": perception}),
    }


def _perception(demo: Demo) -> dict[str, Any] | None:
    if demo.setup.observation is None:
        return None
    during = [e.observation for e in demo.episodes.values() if e.observation is not None]
    return perception_summary(demo.setup.observation, during)


def _candidates(demo: Demo, name: str, perception: Mapping[str, Any] | None) -> int:
    """Return how many grasps of an object there were, also where the camera's images split it into several."""
    if perception is not None:
        return sum(found["candidates"] for found in perception["objects"][name])
    return len(demo.setup.library[name]) if name in demo.setup.library else 0


def _interventions(episode: DemoEpisode) -> int:
    modes = episode.run.modes
    return sum(modes[i] is Mode.MANUAL and modes[i - 1].automatic for i in episode.run.switches())


def table(demo: Demo) -> str:
    """Return the strategies side by side, for people."""
    columns = {
        "path_length_m": "path m",
        "rotation_rad": "turn rad",
        "duration_s": "time s",
        "sparc": "SPARC",
        "ldlj": "LDLJ",
    }
    rows: list[tuple[str, ...]] = [("object", "strategy", "lifted", *columns.values(), "speed step m/s")]
    for (condition, name), episode in sorted(demo.episodes.items(), key=lambda item: item[0][1]):
        measures = episode.measures()
        jump = measures["switch_jump"]
        numbers = [*(measures[key] for key in columns), None if jump is None else jump["velocity_step"]]
        cells = ["-" if x is None else f"{x:.3f}" for x in numbers]
        rows.append((name, condition, "yes" if episode.lifted else "no", *cells))
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)


def figure(demo: Demo) -> Any:
    """Return the matplotlib figure: the grasps selected at two poses of the hand, and the tool's paths."""
    world = demo.setup.world
    if world.robot.gripper is None:
        raise InvalidValue("robot.gripper", None, "a gripper")
    object_name = demo.intervened or demo.object_names[0]
    episodes = [episode for (_, name), episode in demo.episodes.items() if name == object_name]
    first = episodes[0]
    starts = [i for i in first.run.switches() if first.run.modes[i] is Mode.APPROACH]
    panels = [_panel(first, i, f"Selected grasps, hand pose {k}") for k, i in enumerate(starts[:2], 1)]
    return approach_figure(
        {name: (model.mesh, world.X_WO[name]) for name, model in world.objects.items()},
        world.robot.gripper.boxes(world.robot.gripper.max_opening),
        panels or [_panel(first, 0, "Start")],
        [_strategy_path(episode) for episode in episodes],
    )


def _panel(episode: DemoEpisode, index: int, title: str) -> SelectedGrasps:
    ranking = episode.run[index].ranking
    targets = [] if ranking is None else [ranking.target(name) for name in ranking.object_names]
    names = episode.true_names
    grasps = {names.get(t.object_name, t.object_name): t.X_WG for t in targets if t is not None}
    return SelectedGrasps(title, episode.tool[index], grasps)


def _strategy_path(episode: DemoEpisode) -> StrategyPath:
    end = episode.arrival or len(episode.run)
    automatic = np.array([mode.automatic for mode in episode.run.modes[:end]])
    target = None if episode.switch is None else episode.run[episode.switch].step.target
    name = episode.condition.name
    X_WG = None if target is None else target.X_WG
    return StrategyPath(LABELS[name], episode.tool.translation[:end], automatic, COLOURS[name], X_WG)


def save(demo: Demo, directory: Path) -> dict[str, Any]:
    """Write what was measured, the pictures and every run below ``directory``; return the summary.

    That is ``summary.json``, ``approach.png``, ``seen.png`` where a camera observed the scene, and ``runs``.
    """
    directory.mkdir(parents=True, exist_ok=True)
    facts = summary(demo)
    (directory / "summary.json").write_text(json.dumps(facts, indent=2) + "\n")
    save_figure(figure(demo), directory / "approach.png")
    observation = demo.setup.observation
    if observation is not None:
        save_figure(scene_state_figure(observation.first, observation.view.image), directory / "seen.png")
    runs = directory / "runs"
    runs.mkdir(exist_ok=True)
    for (condition, name), episode in demo.episodes.items():
        episode.run.save(runs / f"{condition}_{name}.npz")
    return facts
