"""An observed scene: when its library changes, and that it does not otherwise."""

from dataclasses import replace

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, PinholeCamera, Pose, rotation
from optsc.ik.batch import solve_ik
from optsc.perception import (
    ObserverSettings,
    RegisteredSegment,
    RegistrationSettings,
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
from optsc.perception.known_objects import unused_name
from optsc.perception.scene_registration import Observation, SceneRegistrar, recognise
from optsc.robot import load_robot
from optsc.sampling.contacts import approach_boxes, collides, in_tool_frame
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


class ObservedTable:
    """A table before a camera, and an observer of it; counts its images."""

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
        return self.camera.capture(q, X_WO={**self.X_WO, **moved}, rng=rng, stamp=0.5 * self.count).image

    def observe(self, state, q=None, **moved):
        image = self.image(q, **moved)
        return self.observer.observe(state, image, self.robot.home if q is None else q)

    def configuration(self, p, R=DOWN):
        """Return a configuration with the tool at a place, pointing straight down."""
        found = solve_ik(self.robot, Pose(R.quaternion, np.asarray(p, float)), seeds=self.robot.home)
        assert found.success
        return found.q

    def in_front_of(self, name):
        """Return a configuration with the hand between the camera and an object."""
        middle = self.X_WO[name].translation + [0.0, 0.0, 0.05]
        towards = self.camera.X_WC.translation - middle
        return self.configuration(middle + 0.16 * towards / np.linalg.norm(towards))


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


@pytest.fixture(scope="module")
def templates():
    return {template.name: template for template in catalogue_templates(["can", "box", "mug"])}


@pytest.fixture(scope="module")
def table(robot, templates):
    table = ObservedTable(robot, PLACES, [templates["can"], templates["box"]])
    yield table
    table.camera.close()


@pytest.fixture(scope="module")
def first(table):
    state, events = table.observe(SceneState())
    assert {event.kind for event in events} == {SceneEventKind.STORED}
    return state


def error(table, templates, state, name, X_WO=None):
    return add_s(templates[name].points, table.X_WO[name] if X_WO is None else X_WO, state.objects[name].X_WO)


def test_a_first_observation_finds_every_object_and_stores_its_grasps(table, first, templates):
    assert set(first.objects) == set(first.library) == set(PLACES)
    for name, grasps in first.library.items():
        assert error(table, templates, first, name) < 0.005
        assert len(grasps) == 20
        assert 0.7 < grasps.visible_fraction <= 1.0
        assert grasps.age(first.objects[name].stamp + 3.0) == pytest.approx(3.0)
        assert grasps.provenance["template"] == name


def test_a_still_scene_changes_nothing(table, first):
    state, events = table.observe(first)
    assert events == ()
    assert state.library is first.library
    for name, known in state.objects.items():
        assert known.stamp > first.objects[name].stamp
        assert replace(known, stamp=0.0).__dict__ == replace(first.objects[name], stamp=0.0).__dict__


def test_a_view_with_the_arm_in_front_leaves_every_library_bit_identical(table, first, tmp_path):
    first.library.save(tmp_path / "before")
    for name in PLACES:
        q = table.in_front_of(name)
        # Behind the arm the object may even be missing: no image shows it.
        image = table.image(q, **{name: UNDERGROUND})
        known = first.objects[name]
        hiding = robot_depth(table.robot, q, image.camera, image.X_WC)
        assert not view_is_clear(known.pixels, hiding, known.image).clear
        state, events = table.observer.observe(first, image, q)
        assert events == ()
        assert state.library is first.library
        assert state.objects[name] is known
        state.library.save(tmp_path / name)
        for path in (tmp_path / "before").iterdir():
            assert (tmp_path / name / path.name).read_bytes() == path.read_bytes()


def test_a_moved_object_gets_its_grasps_moved(table, first, templates):
    there = at(0.40, 0.02, 0.3)
    state, events = table.observe(first, can=there)
    assert [(event.kind, event.name) for event in events] == [(SceneEventKind.MOVED, "can")]
    assert state.library is first.library
    assert error(table, templates, state, "can", there) < 0.005
    before, after = first.place(), state.place()
    can = np.array(before.object_names)[before.object_index] == "can"
    turn = rotation.angle(state.objects["can"].X_WO.quaternion, first.objects["can"].X_WO.quaternion)
    assert turn < 0.02  # a can that moves is not said to turn, nor to stand on its head
    X_WW = state.objects["can"].X_WO @ first.objects["can"].X_WO.inverse()
    np.testing.assert_allclose(after.X_WG[can].translation, (X_WW @ before.X_WG[can]).translation, atol=1e-9)
    np.testing.assert_array_equal(after.X_WG[~can].translation, before.X_WG[~can].translation)


def test_a_toppled_object_gets_new_grasps(table, first, templates):
    model = object_model("box")
    tipped = Pose.from_rotation_vector([0.5 * np.pi, 0.0, 0.0], [0.52, -0.16, 0.0])
    tipped = Pose.from_translation([0.0, 0.0, -tipped.apply(model.mesh.vertices)[:, 2].min()]) @ tipped
    state, events = table.observe(first, box=tipped)
    assert [(event.kind, event.name) for event in events] == [(SceneEventKind.TOPPLED, "box")]
    assert error(table, templates, state, "box", tipped) < 0.005
    assert state.library["box"] is not first.library["box"]
    assert state.library["can"] is first.library["can"]
    assert np.all((state.X_WO["box"] @ state.library["box"].X_OG).translation[:, 2] > 0.0)


def test_an_object_that_is_taken_away_is_retired(table, first):
    state, events = table.observe(first, can=UNDERGROUND)
    assert [(event.kind, event.name) for event in events] == [(SceneEventKind.RETIRED, "can")]
    assert set(state.objects) == set(state.library) == {"box"}
    assert set(state.obstacles) == {"box"}
    again, events = table.observe(state)
    assert [(event.kind, event.name) for event in events] == [(SceneEventKind.STORED, "can")]
    assert again.library["can"] is not first.library["can"]


def test_an_object_in_the_hand_is_neither_a_new_object_nor_retired_nor_grasped_again(table, first, templates):
    X_TO = (Pose.from_translation([0.48, 0.16, 0.09]) @ DOWN).inverse() @ table.X_WO["can"]
    reached, _ = table.observe(first, table.configuration([0.48, 0.16, 0.09]))
    assert "can" in reached.grips
    state, reported = reached, []
    for p in ([0.48, 0.10, 0.2], [0.45, 0.0, 0.3], [0.45, 0.0, 0.3]):
        X_WO = Pose(DOWN.quaternion, np.array(p)) @ X_TO
        state, events = table.observe(state, table.configuration(p), can=X_WO)
        reported += [(event.kind, event.name) for event in events]
        assert set(state.objects) == set(PLACES)
        assert state.library is first.library
    assert reported == [(SceneEventKind.TAKEN, "can")]
    assert state.held == {"can"}
    assert set(state.place().object_names) == {"box"}
    assert set(state.obstacles) == {"box"}
    assert error(table, templates, state, "can", X_WO) < 0.01
    there = at(0.42, 0.05)
    state, events = table.observe(state, can=there)
    assert [(event.kind, event.name) for event in events] == [(SceneEventKind.MOVED, "can")]
    assert state.held == frozenset()
    assert state.library is first.library
    assert error(table, templates, state, "can", there) < 0.005


def test_a_hand_that_leaves_without_the_object_has_not_taken_it(table, first):
    reached, _ = table.observe(first, table.configuration([0.48, 0.16, 0.09]))
    state, events = table.observe(reached, table.configuration([0.45, 0.0, 0.3]))
    assert (events, state.held, dict(state.grips)) == ((), frozenset(), {})
    state, events = table.observe(reached, table.configuration([0.45, 0.0, 0.3]), can=UNDERGROUND)
    assert [(event.kind, event.name) for event in events] == [(SceneEventKind.RETIRED, "can")]


@pytest.fixture(scope="module")
def mug(robot, templates):
    """A mug whose handle points away from the camera."""
    table = ObservedTable(robot, {"mug": (0.47, 0.05, 0.0)}, [templates["mug"]])
    away = table.X_WO["mug"].translation - table.camera.X_WC.translation
    handle = object_model("mug").mesh.vertices.mean(axis=0)
    table.X_WO["mug"] = at(0.47, 0.05, np.arctan2(away[1], away[0]) - np.arctan2(handle[1], handle[0]))
    yield table
    table.camera.close()


def test_the_hand_keeps_away_from_every_place_where_a_hidden_handle_may_be(mug, templates):
    state, _ = mug.observe(SceneState())
    known, grasps = state.objects["mug"], state.library["mug"]
    assert not known.certain
    assert grasps.provenance["explanations"] == len(known.explanations) > 1
    assert len(grasps) > 0
    gripper = mug.observer.gripper
    spread = [X.rotation_matrix()[:2, 0] for _, X in known.explanations]
    assert min(float(a @ b) for a in spread for b in spread) < 0.97  # the handle may be in different places
    assert len(known.doubtful) > 20
    boxes = approach_boxes(gripper, AntipodalSettings().standoff)
    assert not collides(in_tool_frame(grasps.X_OG, known.doubtful), boxes, (0.0,) * 3).any()


def test_an_unknown_shape_is_grasped_as_it_is_seen(table, templates):
    blind = SceneObserver(table.robot, [templates["box"]], FEW)
    state, _ = blind.observe(SceneState(), table.image(), table.robot.home)
    assert set(state.objects) == {"box", "unknown"}
    known, grasps = state.objects["unknown"], state.library["unknown"]
    assert known.template is None
    assert known.cloud.seen_mask.all()
    assert len(grasps) > 0
    assert grasps.visible_fraction == 1.0  # of what there are points of, for no more are known of
    distance = np.linalg.norm(known.X_WO.translation[:2] - table.X_WO["can"].translation[:2])
    assert distance < 0.03
    wary = SceneObserver(table.robot, [templates["box"]], replace(FEW, unknown=False))
    state, events = wary.observe(SceneState(), table.image(), table.robot.home)
    assert [event.name for event in events if event.kind is SceneEventKind.REFUSED] == ["unknown"]
    assert set(state.library) == {"box"}
    assert set(state.obstacles) == {"box", "unknown"}


def test_without_templates_everything_is_unknown(table):
    observer = SceneObserver(table.robot, (), replace(FEW, unknown=False))
    state, _ = observer.observe(SceneState(), table.image(), table.robot.home)
    assert set(state.objects) == {"unknown", "unknown-2"}
    again, events = observer.observe(state, table.image(), table.robot.home)
    assert events == ()
    assert again.library is state.library


def test_what_is_seen_in_two_pieces_is_one_object(table, templates):
    image = table.image()
    segments = segment_image(image, robot_mask=robot_mask(table.robot, table.robot.home, image)).segments
    can = max(segments, key=lambda one: one.cloud.points[:, 1].mean())
    left = can.pixels & (np.arange(320) < np.median(np.nonzero(can.pixels)[1]))
    pieces = [segment_from_pixels(image, pixels) for pixels in (left, can.pixels & ~left)]

    scene = SceneRegistrar({"can": templates["can"]}, image, None, 0.0, RegistrationSettings(), 0)
    found = [RegisteredSegment(one, scene.register(one), (i,)) for i, one in enumerate(pieces)]
    (whole,) = scene.without_overlaps(found)
    assert whole.pieces == (0, 1)
    assert len(whole.segment.cloud) == len(can.cloud)
    np.testing.assert_array_equal(whole.segment.pixels, can.pixels)
    assert not whole.registration.refusal
    box = register(max(segments, key=lambda one: -one.cloud.points[:, 1].mean()), [templates["box"]], image)
    apart = [found[0], RegisteredSegment(pieces[1], box, (1,))]
    assert scene._replace(templates=templates).without_overlaps(apart) == tuple(apart)


def test_without_the_arm_s_configuration_the_arm_is_an_object_too(table):
    image = table.image()
    alone = Observation.of(image, robot=table.robot, q=table.robot.home)
    assert len(Observation.of(image).segments) > len(alone.segments) == 2
    assert all(alone.shows_clearly(one) for one in alone.segments)
    assert np.isfinite(alone.robot_depth).any()
    assert not np.isfinite(Observation.of(image).robot_depth).any()
    refused = recognise(alone, alone.segments, {})
    assert [one.registration.refusal for one in refused] == ["no templates were given"] * 2


def test_names_of_one_kind_are_numbered_from_the_second_on():
    assert unused_name(None, ()) == "unknown"
    assert unused_name("mug", ["can"]) == "mug"
    assert unused_name("mug", ["mug", "mug-2"]) == "mug-3"


def test_same_images_and_seed_give_the_same_state(table, first):
    image = DepthImage(first.objects["can"].image.depth, SMALL, table.camera.X_WC, first.objects["can"].image.stamp)
    state, _ = table.observer.observe(SceneState(), image, table.robot.home)
    for name, grasps in state.library.items():
        assert grasps.X_OG.matrix().tobytes() == first.library[name].X_OG.matrix().tobytes()


def test_an_empty_table_and_an_image_without_depths_are_no_scene(table):
    for depth in (np.full((240, 320), np.nan), table.image(can=UNDERGROUND, box=UNDERGROUND).depth):
        image = DepthImage(depth, SMALL, table.camera.X_WC)
        state, events = table.observer.observe(SceneState(), image, table.robot.home)
        assert (dict(state.objects), events) == ({}, ())
        assert len(state.place()) == 0


def test_an_image_without_depths_says_nothing_about_a_known_scene(table, first):
    image = DepthImage(np.full((240, 320), np.nan), SMALL, table.camera.X_WC)
    state, events = table.observer.observe(first, image, table.robot.home)
    assert events == ()
    assert state.library is first.library


def test_what_cannot_be_observed_is_refused(table, first, templates):
    image = table.image()
    large = PinholeCamera.from_field_of_view(160, 120, 0.75)
    with pytest.raises(InvalidValue, match="camera"):
        table.observer.observe(first, DepthImage(np.ones((120, 160)), large, image.X_WC), table.robot.home)
    elsewhere = Pose.from_translation([0.0, 0.01, 0.0]) @ image.X_WC
    with pytest.raises(InvalidValue, match="place"):
        table.observer.observe(first, DepthImage(image.depth, SMALL, elsewhere), table.robot.home)
    for q in (table.robot.home * np.nan, table.robot.home[:3]):
        with pytest.raises(InvalidValue):
            table.observer.observe(first, image, q)
    with pytest.raises(InvalidValue, match="templates"):
        SceneObserver(table.robot, [templates["can"], templates["can"]])
    with pytest.raises(InvalidValue, match="gripper"):
        SceneObserver(replace(table.robot, gripper=None))


@pytest.mark.parametrize("wrong", [{"tilt": 0.0}, {"tilt": 4.0}, {"explained": 0.0}, {"explained": 1.1}])
def test_settings_out_of_range_are_refused(wrong):
    with pytest.raises(InvalidValue):
        ObserverSettings(**wrong)
