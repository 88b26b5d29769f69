"""The same episodes in a simulated world: every distinct target in a run of its own, from the start.

A physics engine cannot be set back to the hand-over to the last bit; but it gives the same bytes after every reset, so
a run that repeats the operator's part arrives at the same hand-over.
"""

from __future__ import annotations

import numpy as np

from optsc.control.modes import Mode
from optsc.metrics import is_lifted
from optsc.session import run
from optsc.study.conditions import Condition, OperatorSpec
from optsc.study.episode_setup import EpisodeSetup
from optsc.study.leading import ending
from optsc.study.tracks import Track

LONGEST_MOTION = 30.0
"""Time that the robot has from the last moment at which it may take over [s]."""


def execute_physically(
    stage: EpisodeSetup, person: OperatorSpec, condition: Condition
) -> tuple[Track, str, bool]:
    """Return the track up to the end of the first automatic motion, how that ended, and whether the goal was lifted."""
    with stage.follower() as follower:
        whole = run(
            stage.controller(condition, stage.tables),
            operator=person.operator(stage.scene.goal, stage.scene.objects),
            follower=follower,
            candidates=stage.candidates,
            clear=stage.clear,
            rate=stage.settings.rate,
            duration=stage.settings.longest + LONGEST_MOTION,
        )
    track, ended = Track(stage.robot, stage.settings.rate), "time is up"
    began = False
    for tick in whole:
        track.add(tick.step, tick.sample)
        began = began or tick.mode is Mode.APPROACH
        if began and (found := ending(tick.step, False)):
            ended = found
            break
    heights = np.array([tick.objects[stage.scene.goal].translation[2] for tick in whole])
    return track, ended, is_lifted(heights, whole.rate)
