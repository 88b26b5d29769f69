"""A watched scene: when its library changes, and that it does not otherwise."""

from dataclasses import replace

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, PinholeCamera, Pose, rotation
from optsc.ik.batch import solve_ik
from optsc.perception import (
    ObserverSettings,
    RegisteredSegment,
    SceneEventKind,
    SceneObserver,
    SceneState,
    add_s,
    catalogue_templates,
    register,
    robot_depth,
    robot_mask,
    segment_from_pixels,
    segment_image,
    view_is_clear,
)
from optsc.perception.scene_registration import without_overlaps
from optsc.robot import load_robot
from optsc.sampling.contacts import approach_boxes, in_tool_frame, touched
from optsc.sampling.settings import AntipodalSettings
from optsc.sim import Tabletop, object_model
from optsc.sim.camera import DepthCamera

SMALL = PinholeCamera.from_field_of_view(320, 240, 0.75)
FEW = ObserverSettings(grasps=AntipodalSettings.for_clouds(count=20))
PLACES = {"can": (0.48, 0.16, 0.3), "box": (0.52, -0.16, 0.4)}
UNDERGROUND = Pose.from_translation([0.0, 0.0, -3.0])
DOWN = Pose.from_rotation_vector([np.pi, 0.0, 0.0], [0.0, 0.0, 0.0])


def at(x, y, yaw=0.0):
    return Pose.from_rotation_vector([0.0, 0.0, yaw], [x, y, 0.0])


class Stage:
    """A table before a camera, and an observer that looks at it; counts its images."""

    def __init__(self, robot, places, templates, settings=FEW):
        X_WO = {name: at(*place) for name, place in places.items()}
        self.world = Tabletop(robot, {name: object_model(name) for name in X_WO}, X_WO)
        self.robot, self.X_WO = robot, X_WO
        self.camera = DepthCamera(self.world, camera=SMALL)
        self.observer = SceneObserver(robot, templates, settings)
        self.count = 0

    def image(self, q=None, **moved):
        self.count += 1
        rng = np.random.default_rng(self.count)
        q = self.robot.home if q is None else q
        return self.camera.look(q, X_WO={**self.X_WO, **moved}, rng=rng, stamp=0.5 * self.count).image

    def look(self, memory, q=None, **moved):
        image = self.image(q, **moved)
        return self.observer.observe(memory, image, self.robot.home if q is None else q)

    def posture(self, p, R=DOWN):
        """Return a posture with the tool at a place, pointing straight down."""
        found = solve_ik(self.robot, Pose(R.quaternion, np.asarray(p, float)), seeds=self.robot.home)
        assert found.success
        return found.q

    def in_front_of(self, name):
        """Return a posture with the hand between the camera and an object."""
        middle = self.X_WO[name].translation + [0.0, 0.0, 0.05]
        way = self.camera.X_WC.translation - middle
        return self.posture(middle + 0.16 * way / np.linalg.norm(way))


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


@pytest.fixture(scope="module")
def templates():
    return {template.name: template for template in catalogue_templates(["can", "box", "mug"])}


@pytest.fixture(scope="module")
def stage(robot, templates):
    stage = Stage(robot, PLACES, [templates["can"], templates["box"]])
    yield stage
    stage.camera.close()


@pytest.fixture(scope="module")
def first(stage):
    memory, events = stage.look(SceneState())
    assert {event.kind for event in events} == {SceneEventKind.STORED}
    return memory


def error(stage, templates, memory, name, X_WO=None):
    return add_s(
        templates[name].points, stage.X_WO[name] if X_WO is None else X_WO, memory.objects[name].X_WO
    )


def test_a_first_look_finds_every_object_and_stores_its_grasps(stage, first, templates):
    assert set(first.objects) == set(first.library) == set(PLACES)
    for name, grasps in first.library.items():
        assert error(stage, templates, first, name) < 0.005
        assert len(grasps) == 20
        assert 0.7 < grasps.visible_fraction <= 1.0
        assert grasps.age(first.objects[name].stamp + 3.0) == pytest.approx(3.0)
        assert grasps.provenance["template"] == name


def test_a_still_scene_changes_nothing(stage, first):
    memory, events = stage.look(first)
    assert events == ()
    assert memory.library is first.library
    for name, known in memory.objects.items():
        assert known.stamp > first.objects[name].stamp
        assert replace(known, stamp=0.0).__dict__ == replace(first.objects[name], stamp=0.0).__dict__


def test_a_view_with_the_arm_in_front_leaves_every_library_bit_identical(stage, first, tmp_path):
    first.library.save(tmp_path / "before")
    for name in PLACES:
        q = stage.in_front_of(name)
        # Behind the arm the object may even be gone: nobody has seen it.
        image = stage.image(q, **{name: UNDERGROUND})
        known = first.objects[name]
        hiding = robot_depth(stage.robot, q, image.camera, image.X_WC)
        assert not view_is_clear(known.pixels, hiding, known.image).clear
        memory, events = stage.observer.observe(first, image, q)
        assert events == ()
        assert memory.library is first.library
        assert memory.objects[name] is known
        memory.library.save(tmp_path / name)
        for path in (tmp_path / "before").iterdir():
            assert (tmp_path / name / path.name).read_bytes() == path.read_bytes()


def test_a_moved_object_gets_its_grasps_moved(stage, first, templates):
    there = at(0.40, 0.02, 0.3)
    memory, events = stage.look(first, can=there)
    assert [(event.kind, event.name) for event in events] == [(SceneEventKind.MOVED, "can")]
    assert memory.library is first.library
    assert error(stage, templates, memory, "can", there) < 0.005
    before, after = first.place(), memory.place()
    can = np.array(before.object_names)[before.object_index] == "can"
    turn = rotation.angle(memory.objects["can"].X_WO.quaternion, first.objects["can"].X_WO.quaternion)
    assert turn < 0.02  # a can that moves is not said to turn, nor to stand on its head
    X_WW = memory.objects["can"].X_WO @ first.objects["can"].X_WO.inverse()
    np.testing.assert_allclose(after.X_WG[can].translation, (X_WW @ before.X_WG[can]).translation, atol=1e-9)
    np.testing.assert_array_equal(after.X_WG[~can].translation, before.X_WG[~can].translation)


def test_a_toppled_object_s_grasps_are_made_anew(stage, first, templates):
    model = object_model("box")
    tipped = Pose.from_rotation_vector([0.5 * np.pi, 0.0, 0.0], [0.52, -0.16, 0.0])
    tipped = Pose.from_translation([0.0, 0.0, -tipped.apply(model.mesh.vertices)[:, 2].min()]) @ tipped
    memory, events = stage.look(first, box=tipped)
    assert [(event.kind, event.name) for event in events] == [(SceneEventKind.TOPPLED, "box")]
    assert error(stage, templates, memory, "box", tipped) < 0.005
    assert memory.library["box"] is not first.library["box"]
    assert memory.library["can"] is first.library["can"]
    assert np.all((memory.X_WO["box"] @ memory.library["box"].X_OG).translation[:, 2] > 0.0)


def test_an_object_that_is_taken_away_is_retired(stage, first):
    memory, events = stage.look(first, can=UNDERGROUND)
    assert [(event.kind, event.name) for event in events] == [(SceneEventKind.RETIRED, "can")]
    assert set(memory.objects) == set(memory.library) == {"box"}
    assert set(memory.obstacles) == {"box"}
    again, events = stage.look(memory)
    assert [(event.kind, event.name) for event in events] == [(SceneEventKind.STORED, "can")]
    assert again.library["can"] is not first.library["can"]


def test_an_object_in_the_hand_is_neither_a_new_thing_nor_retired_nor_grasped_again(stage, first, templates):
    X_TO = (Pose.from_translation([0.48, 0.16, 0.09]) @ DOWN).inverse() @ stage.X_WO["can"]
    reached, _ = stage.look(first, stage.posture([0.48, 0.16, 0.09]))
    assert "can" in reached.grips
    memory, told = reached, []
    for p in ([0.48, 0.10, 0.2], [0.45, 0.0, 0.3], [0.45, 0.0, 0.3]):
        X_WO = Pose(DOWN.quaternion, np.array(p)) @ X_TO
        memory, events = stage.look(memory, stage.posture(p), can=X_WO)
        told += [(event.kind, event.name) for event in events]
        assert set(memory.objects) == set(PLACES)
        assert memory.library is first.library
    assert told == [(SceneEventKind.TAKEN, "can")]
    assert memory.held == {"can"}
    assert set(memory.place().object_names) == {"box"}
    assert set(memory.obstacles) == {"box"}
    assert error(stage, templates, memory, "can", X_WO) < 0.01
    there = at(0.42, 0.05)
    memory, events = stage.look(memory, can=there)
    assert [(event.kind, event.name) for event in events] == [(SceneEventKind.MOVED, "can")]
    assert memory.held == frozenset()
    assert memory.library is first.library
    assert error(stage, templates, memory, "can", there) < 0.005


def test_a_hand_that_leaves_without_the_object_has_not_taken_it(stage, first):
    reached, _ = stage.look(first, stage.posture([0.48, 0.16, 0.09]))
    memory, events = stage.look(reached, stage.posture([0.45, 0.0, 0.3]))
    assert (events, memory.held, dict(memory.grips)) == ((), frozenset(), {})
    memory, events = stage.look(reached, stage.posture([0.45, 0.0, 0.3]), can=UNDERGROUND)
    assert [(event.kind, event.name) for event in events] == [(SceneEventKind.RETIRED, "can")]


@pytest.fixture(scope="module")
def mug(robot, templates):
    """A mug whose handle points away from the camera."""
    stage = Stage(robot, {"mug": (0.47, 0.05, 0.0)}, [templates["mug"]])
    away = stage.X_WO["mug"].translation - stage.camera.X_WC.translation
    handle = object_model("mug").mesh.vertices.mean(axis=0)
    stage.X_WO["mug"] = at(0.47, 0.05, np.arctan2(away[1], away[0]) - np.arctan2(handle[1], handle[0]))
    yield stage
    stage.camera.close()


def test_a_hidden_handle_is_not_guessed_the_hand_keeps_away_from_every_place_where_it_may_be(mug, templates):
    memory, _ = mug.look(SceneState())
    known, grasps = memory.objects["mug"], memory.library["mug"]
    assert not known.certain
    assert grasps.provenance["explanations"] == len(known.explanations) > 1
    assert len(grasps) > 0
    gripper = mug.observer.gripper
    spread = [X.rotation_matrix()[:2, 0] for _, X in known.explanations]
    assert min(float(a @ b) for a in spread for b in spread) < 0.97  # the handle may be in different places
    assert len(known.doubtful) > 20
    boxes = approach_boxes(gripper, AntipodalSettings().standoff)
    assert not touched(in_tool_frame(grasps.X_OG, known.doubtful), boxes, (0.0,) * 3).any()


def test_an_unknown_shape_is_grasped_as_it_is_seen(stage, templates):
    blind = SceneObserver(stage.robot, [templates["box"]], FEW)
    memory, _ = blind.observe(SceneState(), stage.image(), stage.robot.home)
    assert set(memory.objects) == {"box", "unknown"}
    known, grasps = memory.objects["unknown"], memory.library["unknown"]
    assert known.template is None
    assert known.cloud.seen_mask.all()
    assert len(grasps) > 0
    assert grasps.visible_fraction == 1.0  # of what there are points of, for nobody knows of more
    distance = np.linalg.norm(known.X_WO.translation[:2] - stage.X_WO["can"].translation[:2])
    assert distance < 0.03
    wary = SceneObserver(stage.robot, [templates["box"]], replace(FEW, unknown=False))
    memory, events = wary.observe(SceneState(), stage.image(), stage.robot.home)
    assert [event.name for event in events if event.kind is SceneEventKind.REFUSED] == ["unknown"]
    assert set(memory.library) == {"box"}
    assert set(memory.obstacles) == {"box", "unknown"}


def test_without_templates_everything_is_unknown(stage):
    observer = SceneObserver(stage.robot, (), replace(FEW, unknown=False))
    memory, _ = observer.observe(SceneState(), stage.image(), stage.robot.home)
    assert set(memory.objects) == {"unknown", "unknown-2"}
    again, events = observer.observe(memory, stage.image(), stage.robot.home)
    assert events == ()
    assert again.library is memory.library


def test_what_is_seen_in_two_pieces_is_one_thing(stage, templates):
    image = stage.image()
    segments = segment_image(image, robot_mask=robot_mask(stage.robot, stage.robot.home, image)).segments
    can = max(segments, key=lambda one: one.cloud.points[:, 1].mean())
    left = can.pixels & (np.arange(320) < np.median(np.nonzero(can.pixels)[1]))
    pieces = [segment_from_pixels(image, pixels) for pixels in (left, can.pixels & ~left)]

    def register_one(one):
        return register(one, [templates["can"]], image)

    found = [RegisteredSegment(one, register_one(one), (i,)) for i, one in enumerate(pieces)]
    (whole,) = without_overlaps(found, templates, image, register_one)
    assert whole.pieces == (0, 1)
    assert len(whole.segment.cloud) == len(can.cloud)
    np.testing.assert_array_equal(whole.segment.pixels, can.pixels)
    assert not whole.registration.refusal
    box = register(max(segments, key=lambda one: -one.cloud.points[:, 1].mean()), [templates["box"]], image)
    apart = [found[0], RegisteredSegment(pieces[1], box, (1,))]
    assert without_overlaps(apart, templates, image, register_one) == tuple(apart)


def test_same_images_and_seed_give_the_same_memory(stage, first):
    image = DepthImage(
        first.objects["can"].image.depth, SMALL, stage.camera.X_WC, first.objects["can"].image.stamp
    )
    memory, _ = stage.observer.observe(SceneState(), image, stage.robot.home)
    for name, grasps in memory.library.items():
        assert grasps.X_OG.matrix().tobytes() == first.library[name].X_OG.matrix().tobytes()


def test_an_empty_table_and_an_image_without_depths_are_no_scene(stage):
    for depth in (np.full((240, 320), np.nan), stage.image(can=UNDERGROUND, box=UNDERGROUND).depth):
        image = DepthImage(depth, SMALL, stage.camera.X_WC)
        memory, events = stage.observer.observe(SceneState(), image, stage.robot.home)
        assert (dict(memory.objects), events) == ({}, ())
        assert len(memory.place()) == 0


def test_an_image_without_depths_says_nothing_about_a_known_scene(stage, first):
    image = DepthImage(np.full((240, 320), np.nan), SMALL, stage.camera.X_WC)
    memory, events = stage.observer.observe(first, image, stage.robot.home)
    assert events == ()
    assert memory.library is first.library


def test_what_cannot_be_looked_at_is_refused(stage, first, templates):
    image = stage.image()
    large = PinholeCamera.from_field_of_view(160, 120, 0.75)
    with pytest.raises(InvalidValue, match="camera"):
        stage.observer.observe(first, DepthImage(np.ones((120, 160)), large, image.X_WC), stage.robot.home)
    elsewhere = Pose.from_translation([0.0, 0.01, 0.0]) @ image.X_WC
    with pytest.raises(InvalidValue, match="place"):
        stage.observer.observe(first, DepthImage(image.depth, SMALL, elsewhere), stage.robot.home)
    for q in (stage.robot.home * np.nan, stage.robot.home[:3]):
        with pytest.raises(InvalidValue):
            stage.observer.observe(first, image, q)
    with pytest.raises(InvalidValue, match="templates"):
        SceneObserver(stage.robot, [templates["can"], templates["can"]])
    with pytest.raises(InvalidValue, match="gripper"):
        SceneObserver(replace(stage.robot, gripper=None))


@pytest.mark.parametrize("wrong", [{"tilt": 0.0}, {"tilt": 4.0}, {"explained": 0.0}, {"explained": 1.1}])
def test_settings_out_of_range_are_refused(wrong):
    with pytest.raises(InvalidValue):
        ObserverSettings(**wrong)
