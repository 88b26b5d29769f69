import os
import subprocess
import sys

import numpy as np
import pytest

from optsc.errors import InvalidValue, UnknownName
from optsc.robot import load_robot
from optsc.sim import Tabletop, tabletop
from optsc.sim.follower import PyBulletFollower
from optsc.sim.settings import PhysicsSettings


@pytest.fixture(scope="module")
def panda():
    return load_robot("panda")


def sines(robot, t, rate=6.0, amplitude=0.25):
    """Return a motion of up to 1.5 rad/s that starts at home from rest."""
    sign = (-1.0) ** np.arange(robot.n)
    q = robot.home + sign * amplitude * 0.5 * (1 - np.cos(rate * t))
    return q, sign * amplitude * 0.5 * rate * np.sin(rate * t)


@pytest.mark.parametrize("name", ["ur5", "iiwa", "xarm7"])
@pytest.mark.parametrize("rate", [250.0, 1000.0])
def test_every_arm_tracks_within_a_fiftieth_of_a_milliradian_at_every_rate(name, rate):
    robot = load_robot(name)
    with PyBulletFollower(Tabletop(robot, {}, {})) as follower:
        for tick in range(1, int(0.4 * rate)):
            q, v = sines(robot, tick / rate)
            assert np.abs(follower.apply(q, v, 0.08, 1 / rate).q - q).max() < 2e-5


def test_a_period_that_is_no_whole_number_of_steps_is_refused_and_nothing_moves(panda):
    still = 0.0 * panda.home
    with PyBulletFollower(Tabletop(panda, {}, {})) as follower:
        for period in (1 / 300, 1 / 2000, 0.0015):
            with pytest.raises(InvalidValue, match="whole number"):
                follower.apply(panda.home + 0.1, still, 0.08, period)
        assert follower.state().time == 0.0
    settings = PhysicsSettings(time_step=1 / 600)
    with PyBulletFollower(Tabletop(panda, {}, {}), settings=settings) as follower:
        assert follower.apply(panda.home, still, 0.08, 1 / 300).time == pytest.approx(1 / 300)


def test_an_unheld_object_lies_on_the_table_and_an_unknown_one_is_refused(panda):
    with PyBulletFollower(tabletop(panda, ("bottle",))) as follower:
        for _ in range(20):
            follower.apply(panda.home, 0.0 * panda.home, 0.08, 0.002)
        assert follower.height("bottle") == pytest.approx(0.0, abs=2e-5)
        assert not follower.held("bottle")
        for ask in (follower.height, follower.held):
            with pytest.raises(UnknownName, match="bottle"):
                ask("teapot")


def test_an_arm_that_is_led_into_the_table_stops_there(panda):
    low = panda.home + np.array([0.0, 2.0, 0.0, 0.6, 0.0, 0.0, 0.0])
    assert panda.forward(low).translation[2] < -0.1
    with PyBulletFollower(Tabletop(panda, {}, {})) as follower:
        for s in np.linspace(0.0, 1.0, 500):
            state = follower.apply(panda.home + s * (low - panda.home), 0.0 * low, 0.08, 0.002)
        assert np.all(np.isfinite(state.q))
        assert panda.forward(state.q).translation[2] > -0.02


def test_an_arm_without_a_gripper_takes_any_opening(panda):
    from dataclasses import replace

    bare = replace(panda, gripper=None)
    with PyBulletFollower(Tabletop(bare, {}, {})) as follower:
        state = follower.apply(bare.home, 0.0 * bare.home, 0.5, 0.002)
        assert state.opening == 0.0
        with pytest.raises(InvalidValue, match="opening"):
            follower.apply(bare.home, 0.0 * bare.home, float("nan"), 0.002)


def test_the_same_commands_give_the_same_bytes_in_another_process(panda):
    code = (
        "import hashlib, numpy as np\n"
        "from optsc.sim.follower import PyBulletFollower\n"
        "from optsc.robot import load_robot\n"
        "from optsc.sim import tabletop\n"
        "robot = load_robot('panda')\n"
        "digest = hashlib.sha256()\n"
        "with PyBulletFollower(tabletop(robot, ('mug', 'can'), seed=4)) as follower:\n"
        "    for tick in range(150):\n"
        "        q = robot.home + [0.0, 0.004 * tick, 0.0, 0.0, 0.0, 0.0, 0.0]\n"
        "        state = follower.apply(q, 0.0 * q, 0.0, 0.002)\n"
        "        digest.update(state.q.tobytes() + state.v.tobytes())\n"
        "    for X in follower.objects().values():\n"
        "        digest.update(X.translation.tobytes() + X.quaternion.tobytes())\n"
        "print(digest.hexdigest())\n"
    )
    outputs = {
        subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "PYTHONHASHSEED": seed},
        ).stdout
        for seed in ("1", "2")
    }
    assert len(outputs) == 1
