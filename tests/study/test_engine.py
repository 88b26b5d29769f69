"""The engine gives what a plain run gives, and does what it shares only once."""

import numpy as np
import pytest

from optsc.control.modes import Mode
from optsc.errors import InvalidValue, UnknownName
from optsc.followers import IdealFollower
from optsc.metrics import Motion
from optsc.robot.manipulability import DEFINITIONS
from optsc.selection import PoseDistance, WeightedSum
from optsc.selection.costs import JointTravel, ManipulabilityLoss, OrientationDistance, PositionDistance
from optsc.session import run
from optsc.study.cases import Job
from optsc.study.conditions import MANIPULABILITY_ONLY, PAPER, Condition, OperatorSpec
from optsc.study.engine import Engine
from optsc.study.episode_setup import EpisodeSettings, EpisodeSetup, episode_key
from optsc.study.outcomes import MEASURED, do, rows
from optsc.study.scenes import LEVELS, Scene, grade, random_scene, scene_set

WEIGHTED = Condition(
    "weighted", WeightedSum(((OrientationDistance(), 1.0), (ManipulabilityLoss(), 8.0), (JointTravel(), 0.2)))
)
POSES = Condition("poses", WeightedSum(((PoseDistance(), 1.0), (PositionDistance(), 2.0))), "simox")
CONDITIONS = (PAPER, MANIPULABILITY_ONLY, PAPER.with_measure("inverse-condition"), WEIGHTED, POSES)
SETTINGS = EpisodeSettings()
OBJECTS = ("box", "can", "mug")


@pytest.fixture(scope="module", params=["panda", "ur5"])
def engine(request):
    engine = Engine(random_scene(request.param, 4, objects=OBJECTS), OperatorSpec(seed=4), SETTINGS)
    engine.choices(CONDITIONS)
    return engine


def plain_run(engine, condition):
    """The same episode without anything shared."""
    stage = EpisodeSetup(engine.setup.scene, SETTINGS)
    return run(
        stage.controller(condition),
        operator=engine.person.operator(stage.scene.goal, stage.scene.objects),
        follower=IdealFollower(stage.robot, stage.world.X_WO, stage.candidates),
        candidates=stage.candidates,
        clear=stage.clear,
        rate=SETTINGS.rate,
        duration=SETTINGS.longest,
    )


@pytest.mark.parametrize("condition", [PAPER, MANIPULABILITY_ONLY, POSES], ids=lambda c: c.name)
def test_a_condition_by_itself_in_a_plain_run_moves_the_same_to_the_last_bit(engine, condition):
    (choice,) = engine.choices([condition])
    recorder, ended, _ = engine.motion(condition, choice)
    shared, plain = recorder.motion(), plain_run(engine, condition)
    count = len(shared)
    assert ended == "arrived"
    assert shared.modes == tuple(mode.value for mode in plain.modes[:count])
    for name in ("q", "v", "a"):
        assert getattr(shared, name).tobytes() == getattr(plain, name)[:count].tobytes()
    begin = shared.modes.index(Mode.APPROACH.value)
    assert plain[begin].step.target.candidate == choice.target.candidate
    assert np.array_equal(plain[begin].step.target.q, choice.target.q)
    whole = Motion.of_run(plain, engine.setup.robot)
    assert np.array_equal(whole.hand.p[: len(shared.hand.p)], shared.hand.p)


def test_a_row_does_not_depend_on_what_else_was_computed(engine):
    together = rows(engine, CONDITIONS)
    scene, person = engine.setup.scene, engine.person
    alone = do(Job(scene, person, SETTINGS, (WEIGHTED,)))[0]
    assert repr(alone) == repr(together[3])


def test_each_distinct_target_is_executed_once(engine):
    found = rows(engine, CONDITIONS)
    before = engine.executions
    distinct = {(row["hand_over"], row["candidate"], row["half_turn"]) for row in found}
    assert before == len(distinct)
    rows(engine, [PAPER.with_measure(name) for name in DEFINITIONS if name.startswith("yoshikawa")])
    assert engine.executions <= before + 2


def test_rows_have_keys_before_they_are_computed(engine):
    job = Job(engine.setup.scene, engine.person, SETTINGS, CONDITIONS)
    assert [row["key"] for row in rows(engine, CONDITIONS)] == job.keys()
    assert len(set(job.keys())) == len(CONDITIONS)
    assert all(np.isfinite([row[name] for name in MEASURED]).all() for row in rows(engine, CONDITIONS))


def test_both_strategies_start_from_the_same_moment(engine):
    one, other = (engine.motion(c, engine.choices([c])[0]).motion.motion() for c in (PAPER, MANIPULABILITY_ONLY))
    begin = one.modes.index(Mode.APPROACH.value)
    assert other.modes.index(Mode.APPROACH.value) == begin
    assert one.q[:begin].tobytes() == other.q[:begin].tobytes()


def test_whoever_refuses_waits_for_the_next_hand_over():
    """A grasp out of reach is refused; the person then aims anew, in the engine as in a plain run."""
    scene = Scene("panda", ("can",), ((0.86, 0.0, 0.0),), "can")
    engine = Engine(scene, OperatorSpec(seed=1), SETTINGS)
    (choice,) = engine.choices([PAPER])
    plain = plain_run(engine, PAPER)
    starts = [i for i in plain.switches() if plain.modes[i] is Mode.APPROACH]
    if choice is None:
        assert starts == []
    else:
        shared = engine.motion(PAPER, choice).motion.motion()
        assert shared.modes.index(Mode.APPROACH.value) == starts[0]
        assert shared.q.tobytes() == plain.q[: len(shared)].tobytes()


def test_people_who_step_in_and_unknown_followers_are_refused():
    with pytest.raises(InvalidValue, match="step in"):
        Engine(random_scene("panda", 0, objects=OBJECTS), OperatorSpec("mind-changing"))
    with pytest.raises(UnknownName, match="pybullet"):
        EpisodeSettings(follower="gazebo")
    with pytest.raises(UnknownName, match="typical"):
        OperatorSpec("sleepy")


def test_a_scene_is_the_same_for_the_same_seed_and_in_a_file():
    scene = random_scene("panda", 11)
    assert scene == random_scene("panda", 11) == Scene.from_json(scene.to_json())
    assert scene.hash == random_scene("panda", 11).hash
    assert scene.hash != random_scene("panda", 12).hash
    assert len(scene.objects) == 3
    world = scene.world()
    assert tuple(world.objects) == scene.objects


def test_every_arm_gets_the_same_objects_and_wishes():
    panda, ur5 = (scene_set([name], 4, 5) for name in ("panda", "ur5"))
    assert [s.goal for s in panda] == [s.goal for s in ur5]
    assert [s.objects for s in panda] == [s.objects for s in ur5]
    assert len({s.hash for s in [*panda, *ur5]}) == 8


def test_graded_scenes_are_as_hard_as_their_names():
    def mean(level, what):
        scenes = [random_scene("panda", seed, objects=OBJECTS, level=level) for seed in range(4)]
        return np.mean([getattr(grade(scene), what) for scene in scenes])

    assert mean("far", "distance") > mean("easy", "distance") + 0.05
    assert mean("cluttered", "gap") < mean("easy", "gap") - 0.02
    assert mean("near-limits", "margin") < mean("easy", "margin") - 0.02
    with pytest.raises(UnknownName, match="cluttered"):
        random_scene("panda", 0, level="impossible")
    assert set(LEVELS) >= {"random", "easy", "medium", "hard"}


def test_what_is_wrong_with_a_scene_is_said():
    with pytest.raises(UnknownName, match="can"):
        Scene("panda", ("can",), ((0.5, 0.0, 0.0),), "mug")
    with pytest.raises(InvalidValue, match="each object once"):
        Scene("panda", ("can", "can"), ((0.5, 0.0, 0.0),) * 2, "can")
    with pytest.raises(InvalidValue, match="number of objects"):
        random_scene("panda", 0, objects=99)


def test_the_key_of_an_episode_holds_everything_but_the_condition():
    scene, person = random_scene("panda", 1, objects=OBJECTS), OperatorSpec(seed=1)
    keys = {
        episode_key(scene, person, SETTINGS),
        episode_key(random_scene("panda", 2, objects=OBJECTS), person, SETTINGS),
        episode_key(random_scene("ur5", 1, objects=OBJECTS), person, SETTINGS),
        episode_key(scene, OperatorSpec(seed=2), SETTINGS),
        episode_key(scene, OperatorSpec("hasty", 1), SETTINGS),
        episode_key(scene, person, EpisodeSettings(rate=500.0)),
        episode_key(scene, person, EpisodeSettings(follower="pybullet")),
    }
    assert len(keys) == 7


def test_in_a_simulated_world_the_same_choice_is_lifted():
    scene = random_scene("panda", 4, objects=("can", "mug", "box"))
    (row,) = do(Job(scene, OperatorSpec(seed=4), EpisodeSettings(follower="pybullet"), (PAPER,)))
    assert row["arrived"]
    assert row["success"]
    assert row["path_length_m"] > 0.05
