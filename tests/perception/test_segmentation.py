import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, PinholeCamera, Pose, look_at
from optsc.perception import SegmentationSettings, robot_mask, segment_image
from optsc.perception.table import find_table
from optsc.robot import load_robot
from optsc.sim import Tabletop, object_model
from optsc.sim.camera import DepthCamera
from optsc.sim.clutter import cluttered_tabletop

CAMERA = PinholeCamera.from_field_of_view(320, 240, 0.75)
X_WC = look_at([1.05, 0.3, 0.65], [0.45, 0.0, 0.05])
APART = {"can": (0.4, 0.15), "box": (0.45, -0.15), "mug": (0.55, 0.0)}
LABELS = list(APART)


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


@pytest.fixture(scope="module")
def view(robot):
    objects = {name: object_model(name) for name in APART}
    X_WO = {name: Pose.from_translation([*place, 0.0]) for name, place in APART.items()}
    with DepthCamera(Tabletop(robot, objects, X_WO), X_WC, CAMERA) as camera:
        return camera.capture(robot.home, rng=np.random.default_rng(0))


def overlap(a, b):
    return (a & b).sum() / (a | b).sum()


def best_overlap(segments, pixels):
    return max((overlap(s.pixels, pixels) for s in segments), default=0.0)


def arm_of(robot, view):
    return robot_mask(robot, robot.home, view.image)


def test_objects_apart_from_each_other_are_found_one_by_one(robot, view):
    segments = segment_image(view.image, robot_mask=arm_of(robot, view)).segments
    assert len(segments) == len(LABELS)
    for name in LABELS:
        seen = view.pixels_of(name) & view.image.measured
        assert best_overlap(segments, seen) > 0.9
    sizes = [len(s.cloud) for s in segments]
    assert sizes == sorted(sizes, reverse=True)


def test_a_segment_s_points_are_those_of_its_pixels_and_its_normals_face_the_camera(robot, view):
    points = view.image.points()
    for found in segment_image(view.image, robot_mask=arm_of(robot, view)).segments:
        np.testing.assert_allclose(found.cloud.points, points[found.pixels])
        towards = X_WC.translation - found.cloud.points
        assert (np.einsum("ij,ij->i", towards, found.cloud.normals) > 0.0).all()
        assert not found.touches_border


def test_normals_of_a_box_are_those_of_its_sides(robot):
    X_WO = {"box": Pose.from_rotation_vector([0.0, 0.0, 0.5], [0.5, 0.0, 0.0])}
    with DepthCamera(Tabletop(robot, {"box": object_model("box")}, X_WO), X_WC, CAMERA) as camera:
        exact = camera.capture(robot.home).image
    (box,) = segment_image(exact, robot_mask=robot_mask(robot, robot.home, exact)).segments
    normals = X_WO["box"].inverse().apply(box.cloud.normals + X_WO["box"].translation)
    straight = np.abs(normals).max(axis=1)
    assert np.median(straight) > 0.9999
    assert (straight > 0.99).mean() > 0.6  # the others are at edges, where the window sees two sides


def test_without_its_mask_the_arm_would_be_taken_for_an_object(robot, view):
    arm = view.pixels_of("arm")
    with_mask = segment_image(view.image, robot_mask=arm_of(robot, view)).segments
    without = segment_image(view.image, settings=SegmentationSettings(largest=2.0)).segments
    assert not any((s.pixels & arm).any() for s in with_mask)
    assert any((s.pixels & arm).sum() > 100 for s in without)


def test_an_object_at_the_edge_of_the_image_says_so(robot, view):
    camera = PinholeCamera(320, 240, CAMERA.fx, CAMERA.fy, CAMERA.cx + 110.0, CAMERA.cy)
    objects = {name: object_model(name) for name in APART}
    X_WO = {name: Pose.from_translation([*place, 0.0]) for name, place in APART.items()}
    with DepthCamera(Tabletop(robot, objects, X_WO), X_WC, camera) as looking:
        shifted = looking.capture(robot.home)
    segments = segment_image(shifted.image, robot_mask=robot_mask(robot, robot.home, shifted.image)).segments
    for found in segments:
        edge = np.zeros_like(found.pixels)
        edge[[0, -1]], edge[:, [0, -1]] = True, True
        assert found.touches_border == bool((found.pixels & edge).any())
    assert any(found.touches_border for found in segments)


def test_an_object_beside_the_arm_says_so(robot, view):
    can = view.pixels_of("can")
    beside = np.zeros_like(can)
    beside[:, : np.flatnonzero(can.any(axis=0)).mean().astype(int)] = True  # the left half of the can and beyond
    found = segment_image(view.image, robot_mask=beside | arm_of(robot, view)).segments
    touching = [s for s in found if s.touches_robot]
    assert len(touching) == 1
    assert (touching[0].pixels & can).sum() > 50


def test_a_tilted_table_below_the_expected_one_is_found():
    tilt = Pose.from_rotation_vector([0.02, 0.0, 0.0], [0.0, 0.0, 0.008])
    level = flat(np.zeros((240, 320), dtype=bool), 0.0)
    moved = DepthImage(level.depth, CAMERA, tilt @ X_WC)
    table = find_table(moved, 0.0)
    assert table.measured
    np.testing.assert_allclose(table.normal, tilt.rotation_matrix()[:, 2], atol=1e-6)
    assert np.abs(table.heights(moved)).max() < 1e-6
    assert segment_image(moved).segments == ()


def test_the_table_s_height_can_be_found_without_an_expected_one():
    higher = DepthImage(
        flat(np.zeros((240, 320), dtype=bool), 0.0).depth, CAMERA, Pose.from_translation([0, 0, 0.3]) @ X_WC
    )
    assert find_table(higher, None).offset == pytest.approx(0.3, abs=1e-6)
    assert segment_image(higher, table_height=None).segments == ()


def test_a_plane_far_from_the_expected_one_is_not_taken_for_the_table():
    higher = DepthImage(
        flat(np.zeros((240, 320), dtype=bool), 0.0).depth, CAMERA, Pose.from_translation([0, 0, 0.3]) @ X_WC
    )
    table = find_table(higher, 0.0)
    assert not table.measured
    assert table.offset == 0.0


def flat(raised, height):
    """Return the exact image of an empty table in which the pixels ``raised`` are ``height`` above it."""
    R = X_WC.rotation_matrix()
    falling = CAMERA.rays() @ R[2]
    return DepthImage(np.where(raised, height - X_WC.translation[2], -X_WC.translation[2]) / falling, CAMERA, X_WC)


def block(rows, columns):
    mask = np.zeros((240, 320), dtype=bool)
    mask[rows, columns] = True
    return mask


def test_a_raised_patch_is_found_to_the_pixel():
    raised = block(slice(100, 120), slice(150, 190))
    (found,) = segment_image(flat(raised, 0.05)).segments
    np.testing.assert_array_equal(found.pixels, raised)
    np.testing.assert_allclose(found.cloud.points[:, 2], 0.05, atol=1e-9)
    np.testing.assert_allclose(found.cloud.normals, np.broadcast_to([0.0, 0.0, 1.0], (800, 3)), atol=1e-6)


def test_patches_a_finger_apart_are_two():
    raised = block(slice(100, 120), slice(150, 170)) | block(slice(100, 120), slice(176, 196))
    assert len(segment_image(flat(raised, 0.05)).segments) == 2


def test_an_object_of_one_pixel_is_dropped_with_its_count_and_reason():
    one = segment_image(flat(block(slice(100, 101), slice(150, 151)), 0.05))
    assert one.segments == ()
    assert one.dropped == ((1, "fewer than 60 pixels"),)
    kept = segment_image(flat(block(slice(100, 101), slice(150, 151)), 0.05), settings=SegmentationSettings(smallest=1))
    assert [len(s.cloud) for s in kept.segments] == [1]
    assert np.linalg.norm(kept.segments[0].cloud.normals) == pytest.approx(1.0)


def test_what_is_too_long_for_an_object_is_dropped_with_its_length():
    result = segment_image(flat(block(slice(100, 130), slice(20, 310)), 0.05))
    assert result.segments == ()
    assert "m long, more than 0.5 m" in result.dropped[0].reason


def test_an_image_without_a_single_depth_has_no_object_and_says_why():
    result = segment_image(DepthImage(np.full((240, 320), np.nan), CAMERA, X_WC))
    assert result.segments == ()
    assert "nothing was measured" in result.dropped[0].reason


def test_an_empty_table_has_no_object():
    result = segment_image(flat(np.zeros((240, 320), dtype=bool), 0.0))
    assert (result.segments, result.dropped) == ((), ())


def test_what_hangs_over_is_joined_to_what_is_below_it(robot):
    """A drill's barrel hides its grip from above."""
    X_WO = {"drill": Pose.from_rotation_vector([0.0, 0.0, 1.2], [0.5, 0.0, 0.0])}
    with DepthCamera(Tabletop(robot, {"drill": object_model("drill")}, X_WO), X_WC, CAMERA) as camera:
        view = camera.capture(robot.home, rng=np.random.default_rng(0))
    arm = robot_mask(robot, robot.home, view.image)
    seen = view.pixels_of("drill") & view.image.measured
    assert best_overlap(segment_image(view.image, robot_mask=arm).segments, seen) > 0.9
    apart = segment_image(view.image, robot_mask=arm, settings=SegmentationSettings(overhang=1.0)).segments
    assert best_overlap(apart, seen) < 0.8


def test_most_objects_of_cluttered_tables_are_found(robot):
    overlaps = []
    for seed in (1003, 1011, 1016):
        scene = cluttered_tabletop(robot, seed)
        with DepthCamera(scene.world) as camera:
            view = camera.capture(scene.q, rng=np.random.default_rng(seed))
        segments = segment_image(view.image, robot_mask=robot_mask(robot, scene.q, view.image)).segments
        for name in scene.world.objects:
            seen = view.pixels_of(name) & view.image.measured
            if seen.sum() >= 300:
                overlaps.append(best_overlap(segments, seen))
    assert np.mean(overlaps) > 0.9


def test_the_same_image_gives_the_same_segments(robot, view):
    first, again = (segment_image(view.image, robot_mask=arm_of(robot, view)).segments for _ in range(2))
    assert [s.cloud.points.tobytes() for s in first] == [s.cloud.points.tobytes() for s in again]


def test_what_cannot_be_segmented_is_refused_by_name(view):
    with pytest.raises(InvalidValue, match="robot_mask"):
        segment_image(view.image, robot_mask=np.zeros((5, 5), dtype=bool))
    with pytest.raises(InvalidValue, match="robot_mask"):
        segment_image(view.image, robot_mask=np.zeros(view.image.depth.shape))
    with pytest.raises(InvalidValue, match="table_height"):
        segment_image(view.image, table_height=np.inf)
    for field, value in (
        ("lowest", 0.0),
        ("gap", np.nan),
        ("smallest", 0),
        ("normal_window", 4),
        ("reach", 2.0),
    ):
        with pytest.raises(InvalidValue, match=f"SegmentationSettings.*{field}"):
            SegmentationSettings(**{field: value})
