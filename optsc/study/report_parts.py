"""Report parts that studies share: intervals as text, and pictures of the tool's path."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from optsc.geometry import Pose
from optsc.metrics import Motion
from optsc.study.conditions import Condition, OperatorSpec
from optsc.study.engine import Engine
from optsc.study.episode_setup import EpisodeSettings
from optsc.study.scenes import Scene
from optsc.study.statistics import Interval
from optsc.viewers.report import Picture
from optsc.viewers.report_motion import ToolPath, trajectories

APPROACH_PATHS = "The tool's path, coloured by mode; a circle marks the hand-over, a fork the chosen grasp."
MODES_TO_THE_GRASP = "Control modes over time, from the first sample to the grasp."


def bounds(interval: Interval) -> str:
    """Return both ends of ``interval`` as text."""
    return f"{interval.low:.3g} to {interval.high:.3g}"


def estimate(interval: Interval) -> str | None:
    """Return the value and ``interval`` as text; None where there is no value."""
    return f"{interval.value:.3g} ({bounds(interval)})" if np.isfinite(interval.value) else None


def percentage(interval: Interval) -> str:
    """Return a share and its ``interval`` as text."""
    value, low, high = (100.0 * x for x in interval)
    return f"{value:.1f} % ({low:.1f} to {high:.1f})"


def tool_path(label: str, motion: Motion, X_WG: Pose | None) -> ToolPath:
    """Return the tool's path in ``motion``, which leads to the grasp ``X_WG``."""
    return ToolPath(label, motion.X_WT.translation, motion.modes, motion.rate, X_WG)


def approach_paths(
    scene: Scene, person: OperatorSpec, conditions: Sequence[Condition], settings: EpisodeSettings
) -> list[ToolPath]:
    """Return the tool's path to the grasp under each condition that chooses one, named as the condition is."""
    engine, found = Engine(scene, person, settings), []
    for condition, choice in zip(conditions, engine.choices(conditions), strict=True):
        if choice is not None:
            motion = engine.motion(condition, choice).motion.motion()
            found.append(tool_path(condition.name, motion, choice.target.X_WG))
    return found


def path_picture(name: str, scene: Scene, paths: Sequence[ToolPath], title: str, words: str) -> Picture:
    """Return the picture of ``paths`` among the objects of ``scene``."""
    figure = trajectories(scene.world().placed_parts, paths, title, scene.goal)
    return Picture(name, figure, f"{title}{words}")
