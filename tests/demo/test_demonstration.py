"""The demonstration: what it writes, that a scene repeats to the byte, and that it survives a failed lift."""

import json
from dataclasses import replace

import numpy as np
import pytest

from optsc.control.modes import Mode
from optsc.demo.demonstration import Demo, load_or_build, plans, run_demo
from optsc.demo.episode import DemoSetup, run_episode
from optsc.demo.summary import save, summary, table
from optsc.metrics.paths import LIFT_HEIGHT
from optsc.people.parameters import Intention
from optsc.robot import load_robot
from optsc.sim import tabletop
from optsc.sim.follower import PyBulletFollower
from optsc.study.approach import STRATEGIES
from optsc.study.conditions import PAPER


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    world = tabletop(load_robot("panda"), objects=("can", "box"), seed=2)
    return DemoSetup(world, load_or_build(world, tmp_path_factory.mktemp("grasps"), lambda text: None), seed=2)


@pytest.fixture(scope="module")
def demo(setup):
    episodes = {}
    with PyBulletFollower(setup.world) as follower:
        for condition in STRATEGIES:
            for name, plan in plans(setup.world.objects).items():
                episodes[condition.name, name] = run_episode(setup, condition, plan, follower)
    return Demo(setup, episodes, intervened="can")


def test_the_summary_says_what_was_measured(demo, tmp_path):
    save(demo, tmp_path)
    facts = json.loads((tmp_path / "summary.json").read_text())
    assert set(facts["objects"]) == {"can", "box"}
    for row in facts["objects"].values():
        assert row["candidates"] == 150
        for condition in STRATEGIES:
            assert {
                "lifted",
                "path_length_m",
                "rotation_rad",
                "duration_s",
                "sparc",
                "ldlj",
                "switch_jump",
            } <= set(row[condition.name])
    assert facts["limit_violations"] == {"position": 0, "velocity": 0, "acceleration": 0, "jerk": 0}
    assert facts["interventions"] == 2
    assert facts["ticks"] == sum(len(episode.run) for episode in demo.episodes.values())
    assert 0 < facts["tick_p50_us"] <= facts["tick_p99_us"]
    assert (tmp_path / "approach.png").stat().st_size > 50_000
    assert len(list((tmp_path / "runs").glob("*.npz"))) == 4


def test_the_paper_s_strategy_lifts(demo):
    for name in ("can", "box"):
        episode = demo.episodes["paper", name]
        heights = np.array([tick.objects[name].translation[2] for tick in episode.run])
        assert episode.lifted
        assert heights[-1] > LIFT_HEIGHT
        assert episode.target_name == name


def test_the_operator_steps_in_once_and_the_command_does_not_step(demo):
    episode = demo.episodes["paper", "can"]
    modes = [episode.run.modes[i] for i in episode.run.switches()]
    assert modes[:4] == [Mode.MANUAL, Mode.APPROACH, Mode.MANUAL, Mode.APPROACH]
    assert modes.count(Mode.MANUAL) == 2
    limits = demo.setup.world.robot.limits
    assert np.all(np.abs(np.diff(episode.run.v, axis=0)) <= limits.acceleration / 500.0 * (1 + 1e-9))


def test_operators_of_one_seed_move_alike_until_the_robot_takes_over(demo):
    one, other = (demo.episodes[condition.name, "box"].run for condition in STRATEGIES)
    switch = demo.episodes["paper", "box"].switch
    assert one.commands[:switch].tobytes() == other.commands[:switch].tobytes()


def test_the_same_seed_gives_the_same_motion_to_the_byte(demo):
    setup = demo.setup
    with PyBulletFollower(setup.world) as follower:
        again = run_episode(setup, PAPER, (Intention("box"),), follower)
    assert again.run.commands.tobytes() == demo.episodes["paper", "box"].run.commands.tobytes()


def test_a_grasp_that_never_came_is_a_result(demo):
    episode = replace(demo.episodes["paper", "box"], switch=None, arrival=None, lifted=False)
    measures = episode.measures()
    assert measures["path_length_m"] is None
    assert measures["lifted"] is False
    assert "no" in table(replace(demo, episodes={**demo.episodes, ("paper", "box"): episode}))


def test_from_the_camera_alone_an_object_is_found_grasped_and_lifted(monkeypatch):
    """Nothing that is known of the scene reaches the controller. A low rate and a single strategy save time."""
    monkeypatch.setattr("optsc.demo.demonstration.STRATEGIES", (PAPER,))
    robot = load_robot("panda")
    demo = run_demo(robot, objects=("can",), seed=0, rate=250.0, say=lambda text: None, perception=True)
    episode = demo.episodes["paper", "can"]
    assert episode.lifted
    assert episode.target_name == "can"
    facts = summary(demo)
    (found,) = facts["perception"]["objects"]["can"]
    assert found["template"] == "can"
    assert found["add_s_m"] < 0.005
    assert facts["objects"]["can"]["candidates"] == found["candidates"] == 150
    assert facts["perception"]["not_objects"] == []
