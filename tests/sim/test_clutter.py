import numpy as np
import pytest

from optsc.collision import CollisionModel
from optsc.errors import InvalidValue, UnknownName
from optsc.robot import load_robot
from optsc.sim.clutter import cluttered_tabletop
from optsc.sim.physics import Physics


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


@pytest.fixture(scope="module")
def scenes(robot):
    return [cluttered_tabletop(robot, seed) for seed in (1, 9, 11)]


def test_there_are_three_to_five_objects_some_upright_and_some_lying(scenes):
    assert all(3 <= len(scene.world.objects) <= 5 for scene in scenes)
    lying = sum(len(scene.lying) for scene in scenes)
    assert 0 < lying < sum(len(scene.world.objects) for scene in scenes)


def test_objects_rest_on_the_table(scenes):
    for scene in scenes:
        for name, model in scene.world.objects.items():
            heights = scene.world.X_WO[name].apply(model.mesh.vertices)[:, 2]
            assert -2e-3 < heights.min() < 0.05  # one may lean on another


def test_objects_stay_where_they_are_in_a_simulation(scenes):
    scene = scenes[0]
    q = scene.world.robot.home.tolist()
    with Physics(scene.world) as physics:
        for _ in range(200):
            physics.step(q, [0.0] * len(q), 0.04)
        for name, X in physics.poses().items():
            assert np.linalg.norm(X.translation - scene.world.X_WO[name].translation) < 2e-3


def test_the_arm_hovers_above_them_and_touches_nothing(scenes):
    for scene in scenes:
        obstacles = {n: (m.parts, scene.world.X_WO[n]) for n, m in scene.world.objects.items()}
        assert CollisionModel(scene.world.robot).clear(scene.q[None], obstacles).clear.all()
        assert 0.0 < scene.world.robot.forward(scene.q).translation[2] < 0.6


def test_the_same_seed_gives_the_same_scene_and_another_seed_another(robot, scenes):
    again = cluttered_tabletop(robot, 1)
    assert list(again.world.objects) == list(scenes[0].world.objects)
    for name, X in again.world.X_WO.items():
        assert X.translation.tobytes() == scenes[0].world.X_WO[name].translation.tobytes()
    assert again.q.tobytes() == scenes[0].q.tobytes()
    assert list(scenes[1].world.X_WO) != list(scenes[0].world.X_WO) or scenes[1].q.tobytes() != again.q.tobytes()


def test_objects_can_be_chosen_and_be_made_to_stand(robot):
    scene = cluttered_tabletop(robot, 0, objects=("mug", "can"), lying=0.0)
    assert list(scene.world.objects) == ["mug", "can"]
    assert scene.lying == frozenset()


@pytest.mark.parametrize(
    "arguments",
    [{"objects": ()}, {"objects": ("can", "can")}, {"lying": 2.0}, {"gap": -1.0}, {"spread": 9.0}],
)
def test_what_is_no_scene_is_refused(robot, arguments):
    with pytest.raises(InvalidValue, match=next(iter(arguments))):
        cluttered_tabletop(robot, **arguments)


def test_an_unknown_object_is_named(robot):
    with pytest.raises(UnknownName, match="teapot"):
        cluttered_tabletop(robot, objects=("teapot",))
