"""What others bring along: their own arms, objects, scenes and grasps in a study."""

import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import optsc.study.sweep
from optsc.cli.cases import PEOPLE
from optsc.errors import DamagedFile, InvalidValue, Mismatch, UnknownName
from optsc.geometry import Pose, TriangleMesh
from optsc.grasps import GraspLibrary
from optsc.ik.batch import solve_ik
from optsc.people.parameters import TYPES
from optsc.robot import PANDA_HAND, load_robot
from optsc.sim import ObjectModel, object_model
from optsc.study import (
    PAPER,
    Arm,
    Cases,
    EpisodeSettings,
    EpisodeSetup,
    OperatorSpec,
    Scene,
    episode_key,
    random_scene,
)
from optsc.study.episode_setup import nearest_distance
from optsc.study.libraries import library_of
from optsc.study.scenes import grade

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (0, 1)], dtype=float)
SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
PERSON = OperatorSpec("typical", 3)


def block(width=0.02, mass=0.2):
    faces = [face for a, b, c, d in SIDES for face in ((a, b, c), (a, c, d))]
    mesh = TriangleMesh(CORNERS * [width, 0.02, 0.1], np.array(faces))
    return ObjectModel("block", mesh, (mesh,), mass, 0.6)


def scene_with(model, **changes):
    places = ((0.5, 0.15, 0.0), (0.5, -0.15, 0.3))
    return Scene("panda", ("can", "block"), places, "can", models=(model,), **changes)


@pytest.fixture(scope="module")
def panda():
    return load_robot("panda")


@pytest.fixture
def urdf(panda, tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_bytes(panda.urdf.read_bytes())
    return path


def arm_of(urdf, panda, **changes):
    return Arm("mine", urdf, "panda_hand_tcp", home=panda.home, **changes)


def test_every_name_of_the_room_of_sweeps_is_there_and_costs_nothing_to_import():
    for name in optsc.study.sweep.__all__:
        assert getattr(optsc.study.sweep, name) is not None
    with pytest.raises(AttributeError, match="no_such_name"):
        optsc.study.sweep.no_such_name  # noqa: B018
    code = "import sys, optsc.study.sweep; print('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_cases_take_scenes_as_they_are():
    scenes = [random_scene("panda", 5), random_scene("ur5", 6, objects=["can"])]
    cases = Cases(scenes=scenes, people=("typical", "hasty"))
    assert [scene for scene, _ in cases.pairs()] == [scenes[0], scenes[0], scenes[1], scenes[1]]
    assert [person.seed for _, person in cases.pairs()] == [5, 5, 6, 6]
    assert Cases(scenes=iter(scenes)).all_scenes() == scenes
    for wrong in ([], ["panda"]):
        with pytest.raises(InvalidValue, match="Scene"):
            Cases(scenes=wrong)


def test_people_who_step_in_are_refused_before_anything_is_computed():
    cases = Cases(scenes=1, people=("typical", "mind-changing"))
    with pytest.raises(InvalidValue, match="typical, patient"):
        cases.jobs([PAPER])
    assert len(cases.policy_jobs([])) == 2


def test_the_help_names_every_kind_of_people():
    assert all(kind in PEOPLE for kind in TYPES)


def test_an_arm_is_known_by_its_content(urdf, panda, tmp_path):
    mine, moved = arm_of(urdf, panda), tmp_path / "elsewhere.urdf"
    moved.write_bytes(urdf.read_bytes())
    again = pickle.loads(pickle.dumps(mine))
    assert again == mine == arm_of(moved, panda)
    assert hash(again) == hash(mine)
    slow = arm_of(urdf, panda, limits={"velocity": 0.5 * panda.limits.velocity})
    assert slow != mine
    assert np.allclose(slow.load().limits.velocity, 0.5 * panda.limits.velocity)
    with pytest.raises(InvalidValue, match="catalogue"):
        Arm("panda", urdf, "panda_hand_tcp")
    with pytest.raises(DamagedFile, match=r"nowhere\.urdf"):
        Arm("mine", tmp_path / "nowhere.urdf", "panda_hand_tcp")


def test_an_arm_whose_file_has_changed_is_refused(urdf, panda):
    mine = arm_of(urdf, panda)
    urdf.write_text(urdf.read_text() + "<!-- changed -->")
    with pytest.raises(Mismatch, match="mine"):
        mine.load()


def test_scenes_of_an_own_arm_are_drawn_as_those_of_the_catalogue(urdf, panda):
    mine, known = random_scene(arm_of(urdf, panda, gripper=PANDA_HAND), 4), random_scene("panda", 4)
    assert (mine.objects, mine.goal, mine.robot) == (known.objects, known.goal, "mine")
    # The place on the table follows from the arm's reach, which is the same here.
    assert np.allclose(mine.places, known.places)
    assert mine.hash != known.hash
    copy = pickle.loads(pickle.dumps(mine))
    assert copy.hash == mine.hash
    assert copy.robot_model() is mine.robot_model()
    assert Cases((mine.arm, "panda"), scenes=1).pairs()[0][0].arm == mine.arm
    with pytest.raises(InvalidValue, match="mine"):
        replace(mine, robot="panda")


def test_an_own_object_is_part_of_the_scene_by_its_content():
    scene = scene_with(block())
    assert scene.hash == scene_with(block()).hash
    assert len({scene.hash, scene_with(block(0.03)).hash, scene_with(block(mass=0.3)).hash}) == 3
    copy = pickle.loads(pickle.dumps(scene))
    assert copy.hash == scene.hash
    assert copy.object_models()["block"] is scene.object_models()["block"]
    assert scene.object_models()["can"] is object_model("can")
    with pytest.raises(UnknownName, match="block"):
        replace(scene, models=())


def test_a_stored_scene_wants_its_own_things_back():
    scene = scene_with(block())
    stored = scene.to_json()
    assert Scene.from_json(stored, models=scene.models) == scene
    with pytest.raises(Mismatch, match="panda"):
        Scene.from_json(stored, models=[block(0.03)])


def test_own_objects_are_grasped_and_graded():
    scene = random_scene("panda", 2, objects=[block(), "can"])
    assert set(scene.objects) == {"block", "can"}
    stage = EpisodeSetup(replace(scene, goal="block"), EpisodeSettings())
    assert len(stage.library["block"]) > 20
    assert grade(stage.scene).reachable > 0.0
    assert set(stage.candidates.object_names) == {"block", "can"}


@pytest.fixture
def stored(panda, tmp_path):
    library = library_of(panda, ("can",))
    GraspLibrary({"can": library["can"].select(np.arange(10))}).save(tmp_path / "a")
    return tmp_path / "a"


def test_stored_grasps_are_those_that_a_stage_chooses_from(stored):
    scene = Scene("panda", ("can",), ((0.5, 0.1, 0.0),), "can")
    assert len(EpisodeSetup(scene, EpisodeSettings(library=stored)).library["can"]) == 10
    assert len(EpisodeSetup(scene, EpisodeSettings()).library["can"]) > 10


def test_rows_are_told_apart_by_the_grasps_and_not_by_their_folder(stored, panda, tmp_path):
    scene = Scene("panda", ("can",), ((0.5, 0.1, 0.0),), "can")
    here = episode_key(scene, PERSON, EpisodeSettings(library=stored))
    assert here != episode_key(scene, PERSON, EpisodeSettings())
    GraspLibrary.load(stored).save(tmp_path / "b")
    assert episode_key(scene, PERSON, EpisodeSettings(library=str(tmp_path / "b"))) == here
    GraspLibrary({"can": library_of(panda, ("can",))["can"]}).save(tmp_path / "b")
    assert episode_key(scene, PERSON, EpisodeSettings(library=tmp_path / "b")) == episode_key(
        scene, PERSON, EpisodeSettings()
    )


def test_an_object_without_stored_grasps_is_an_error_before_anything_is_computed(stored, tmp_path):
    scene = random_scene("panda", 1, objects=["can", "mug"])
    (job,) = Cases(scenes=[scene], settings=EpisodeSettings(library=stored)).jobs([PAPER])
    with pytest.raises(UnknownName, match="mug"):
        job.keys()
    with pytest.raises(DamagedFile):
        episode_key(scene, PERSON, EpisodeSettings(library=tmp_path / "nothing"))


def test_the_clearance_of_a_row_is_also_that_to_own_objects():
    scene = scene_with(block())
    stage = EpisodeSetup(scene, EpisodeSettings())
    X_WG = Pose(np.array([0.0, 1.0, 0.0, 0.0]), np.array([0.5, -0.15, 0.115]))
    above = solve_ik(stage.robot, X_WG, seeds=stage.robot.home).q.reshape(1, -1)
    near, alone = (
        nearest_distance(stage),
        EpisodeSetup(Scene("panda", ("can",), scene.places[:1], "can"), EpisodeSettings()),
    )
    assert near(above)[0] < 0.02 < nearest_distance(alone)(above)[0]


def test_an_error_in_a_worker_comes_back_as_what_it_was():
    for error in (
        UnknownName("object", "x", ["can"]),
        InvalidValue("seed", -1, "0 or more"),
        Mismatch("a", 1, 2),
    ):
        back = pickle.loads(pickle.dumps(error))
        assert (type(back), str(back), vars(back)) == (type(error), str(error), vars(error))
