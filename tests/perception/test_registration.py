"""Which template, and where, on depth images drawn by the tests themselves."""

import dataclasses
import importlib.util

import numpy as np
import pytest
from perception_cases import CAMERA, X_WC, drawn, segment_of, upright

from benchmarks.pose_errors import surface_distance, surface_tail
from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, PointCloud, Pose
from optsc.perception import (
    RegistrationSettings,
    SearchSettings,
    Segment,
    add_s,
    catalogue_template,
    register,
    register_scene,
    template_from_mesh,
)
from optsc.perception.pose_hypotheses import PoseHypotheses
from optsc.perception.scoring import fit, free_space, shape_distance
from optsc.sim.objects.solids import cuboid, revolved

NAMES = ("box", "can", "mug")


@pytest.fixture(scope="module")
def templates():
    return tuple(catalogue_template(name) for name in NAMES)


def by_name(templates, name):
    return next(t for t in templates if t.name == name)


def nothing_at(pixels=()):
    mask = np.zeros((CAMERA.height, CAMERA.width), dtype=bool)
    for v, u in pixels:
        mask[v, u] = True
    return mask


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("pose", ["upright", "lying"])
@pytest.mark.parametrize("method", ["gicp", "plane", "field"])
def test_what_stands_or_lies_in_the_open_is_found_within_a_millimetre(templates, name, pose, method):
    template = by_name(templates, name)
    rest = next(X for X in template.resting if abs(X.rotation_matrix()[2, 2]) < 0.5)
    X_WO = upright(0.7, 0.03, -0.05) @ (rest if pose == "lying" else Pose.identity())
    if name == "mug" and pose == "upright":
        X_WO = upright(1.5, 0.03, -0.05)  # the handle towards the camera
    image, owner = drawn([(template.mesh, X_WO)], noise=1e-3)
    settings = RegistrationSettings(search=SearchSettings(method=method))
    found = register(segment_of(image, owner), templates, image, settings=settings)
    assert (found.refusal, found.template) == ("", name)
    assert surface_distance(template, X_WO, found.X_WO) < 1.5e-3
    assert add_s(template.points, X_WO, found.X_WO) < 3e-3
    assert found.inliers > 0.9
    assert found.residual < 1.5e-3
    assert found.visible_fraction > 0.7


def test_a_visible_handle_decides_the_yaw_of_a_mug(templates):
    mug = by_name(templates, "mug")
    X_WO = upright(1.4)
    image, owner = drawn([(mug.mesh, X_WO)], noise=1e-3)
    found = register(segment_of(image, owner), templates, image)
    assert found.accepted
    assert surface_tail(mug, X_WO, found.X_WO) < 4e-3


def test_a_hidden_handle_is_an_ambiguity_with_its_alternatives(templates):
    mug = by_name(templates, "mug")
    away = np.arctan2(*-X_WC.translation[1::-1])  # from the camera to the mug, and on
    X_WO = upright(away)
    image, owner = drawn([(mug.mesh, X_WO)], noise=1e-3)
    found = register(segment_of(image, owner), templates, image)
    assert found.ambiguous
    assert not found.accepted
    assert found.refusal == ""
    assert {other.template for other in found.alternatives} == {"mug"}
    poses = [found.X_WO, *(other.X_WO for other in found.alternatives)]
    yaw = [np.arctan2(*X.rotation_matrix()[1::-1, 0]) for X in poses]
    assert np.all(np.cos(np.array(yaw) - away) > 0.7)  # all of them are hidden behind the mug
    assert np.ptp(np.unwrap(yaw)) > 0.2


def test_a_can_is_not_ambiguous_but_its_turn_is_unknown(templates):
    image, owner = drawn([(by_name(templates, "can").mesh, upright(0.3))], noise=1e-3)
    found = register(segment_of(image, owner), templates, image)
    assert found.accepted
    deviation = np.sqrt(np.diag(found.covariance))
    assert deviation[5] > 0.5  # about the vertical axis, in radians
    assert deviation[3:5].max() < 0.05
    assert deviation[:3].max() < 1e-3
    np.testing.assert_allclose(found.covariance, found.covariance.T)
    assert np.linalg.eigvalsh(found.covariance).min() > 0.0


def test_the_covariance_is_the_inverse_of_hessian_and_prior(templates):
    from optsc.perception.refinement import covariance

    box = by_name(templates, "box")
    hypothesis = PoseHypotheses.of(Pose.stack([Pose.identity()]))
    # 100 points on one side that faces x: only the shift along x and the turns about y and z are measured
    y, z = np.meshgrid(np.linspace(-0.02, 0.02, 10), np.linspace(0.03, 0.1, 10))
    points = np.stack([np.full(100, 0.026), y.ravel(), z.ravel()], axis=-1)
    C = covariance(hypothesis, points, box, 0.005, 1e-3, 0.1)
    rows = np.concatenate([np.tile([1.0, 0, 0], (100, 1)), np.cross(points, [1.0, 0, 0])], axis=1)
    expected = np.linalg.inv(rows.T @ rows / 1e-6 + np.diag([100.0] * 3 + [np.pi**-2] * 3))
    np.testing.assert_allclose(C, expected, rtol=1e-3, atol=1e-9)
    assert C[1, 1] == pytest.approx(0.01, rel=1e-3)


def test_an_object_that_no_template_has_is_refused_with_the_reason(templates):
    ball = revolved([(0.01, 0.0), (0.04, 0.02), (0.05, 0.05), (0.04, 0.08), (0.01, 0.1)])
    image, owner = drawn([(ball, upright())], noise=1e-3)
    found = register(segment_of(image, owner), templates, image)
    assert not found.accepted
    assert found.refusal.startswith("no template fits; the best, ")


def test_free_space_tells_a_short_can_from_a_long_one():
    short = template_from_mesh("short", revolved([(0.03, 0.0), (0.03, 0.06)]), count=600)
    long = template_from_mesh("long", revolved([(0.03, 0.0), (0.03, 0.16)]), count=600)
    image, owner = drawn([(short.mesh, upright())], noise=1e-3)
    segment, standing = segment_of(image, owner), PoseHypotheses.of(Pose.stack([upright()]))
    points, space = segment.cloud.points, free_space(image)
    fits = [fit(standing, points, t, space, tolerance=0.005, table_height=0.0, count=600) for t in (short, long)]
    assert fits[0].violations[0] == 0.0
    assert fits[1].violations[0] > 0.4
    assert register(segment, [long], image).refusal
    assert register(segment_of(image, owner), [long, short], image).template == "short"


def test_what_something_else_hides_does_not_count_against_a_pose(templates):
    box = by_name(templates, "box")
    screen = cuboid([-0.005, -0.03, 0.0], [0.005, 0.03, 0.2])
    X_WO, X_WS = upright(0.4), upright(0.25, 0.13, 0.05)
    image, owner = drawn([(box.mesh, X_WO), (screen, X_WS)], noise=1e-3)
    owner_alone = drawn([(box.mesh, X_WO)])[1]
    left = np.sum(owner == 0) / np.sum(owner_alone == 0)
    assert 0.3 < left < 0.8
    found = register(segment_of(image, owner), templates, image)
    assert found.accepted
    assert surface_distance(box, X_WO, found.X_WO) < 2e-3
    assert found.visible_fraction == pytest.approx(left, abs=0.15)


def test_a_point_is_seen_through_only_where_the_camera_measured_something_behind_it():
    image, _ = drawn([(cuboid([-0.05, -0.05, 0.0], [0.05, 0.05, 0.1]), Pose.identity())])
    depth = np.array(image.depth)
    beside = np.array([0.15, 0.15, 0.05])
    u, v = np.rint(CAMERA.project(X_WC.inverse().apply(beside))[:2]).astype(int)
    points = np.array([beside, [0.0, 0.0, 0.05], [0.0, 0.0, 0.1], [3.0, 0.0, 0.0]])
    through, seen = free_space(image).classify(points)
    assert through.tolist() == [True, False, False, False]
    assert seen.tolist() == [False, False, True, False]
    depth[v, u] = np.nan  # a pixel without a measurement says nothing
    assert not free_space(dataclasses.replace(image, depth=depth)).classify(points)[0].any()
    arm = np.full(depth.shape, np.inf)
    arm[v - 4 : v + 5, u - 4 : u + 5] = 0.2
    assert not free_space(image, arm).classify(points)[0].any()
    with pytest.raises(InvalidValue, match="robot_depth"):
        free_space(image, arm[1:])


def test_poses_that_a_symmetry_makes_equal_are_no_distance_apart(templates):
    half = PoseHypotheses.of(Pose.stack([upright(np.pi)]))
    same = PoseHypotheses.of(Pose.stack([upright()]))
    assert shape_distance(half, same, by_name(templates, "box"))[0] < 1.5e-3
    assert shape_distance(half, same, by_name(templates, "mug"))[0] > 0.01


def test_the_result_does_not_depend_on_the_order_of_the_templates_and_repeats(templates):
    image, owner = drawn([(by_name(templates, "box").mesh, upright(0.4))], noise=1e-3)
    segment = segment_of(image, owner)
    results = [register(segment, order, image, seed=3) for order in (templates, templates, templates[::-1])]
    for other in results[1:]:
        np.testing.assert_array_equal(other.X_WO.matrix(), results[0].X_WO.matrix())
        assert other.score == results[0].score


def test_where_the_world_is_does_not_matter(templates):
    box = by_name(templates, "box")
    image, owner = drawn([(box.mesh, upright(0.4))], noise=1e-3)
    X_VW = Pose.from_rotation_vector([0.0, 0.0, 2.0], [3.0, -1.0, 0.7])
    moved = DepthImage(image.depth, image.camera, X_VW @ image.X_WC)
    segment = segment_of(image, owner)
    there = Segment(segment.cloud.transformed(X_VW), segment.pixels, False)
    a = register(segment, templates, image)
    b = register(there, templates, moved, table_height=0.7)
    assert a.template == b.template == "box"
    assert surface_distance(box, X_VW @ a.X_WO, b.X_WO) < 1e-3


def test_an_object_on_top_of_another_is_found_without_the_table(templates):
    can = by_name(templates, "can")
    stool = cuboid([-0.05, -0.05, 0.0], [0.05, 0.05, 0.06])
    X_WO = (
        Pose.from_translation([0.0, 0.0, 0.06])
        @ can.resting[int(np.argmin(np.abs(can.resting.rotation_matrix()[:, 2, 2])))]
    )
    image, owner = drawn([(stool, Pose.identity()), (can.mesh, X_WO)], noise=1e-3)
    found = register(segment_of(image, owner, 1), templates, image)
    assert found.template == "can"
    assert surface_distance(can, X_WO, found.X_WO) < 2e-3


class TestBadInput:
    def test_an_empty_cloud_is_refused(self, templates):
        image, _ = drawn([])
        found = register(Segment(PointCloud(np.zeros((0, 3))), nothing_at(), False), templates, image)
        assert found.refusal == "too few points: 0 were seen, 15 are needed"
        assert found.X_WO is None
        assert found.template is None

    def test_an_object_of_one_pixel_is_refused(self, templates):
        image, _ = drawn([])
        one = Segment(PointCloud([[0.0, 0.0, 0.03]]), nothing_at([(100, 100)]), False)
        assert "too few points: 1" in register(one, templates, image).refusal

    def test_many_points_in_one_place_are_too_few(self, templates):
        image, _ = drawn([])
        points = np.random.default_rng(0).uniform(0.03, 0.034, (500, 3))
        found = register(Segment(PointCloud(points), nothing_at(), False), templates, image)
        assert "cubes of 4 mm" in found.refusal

    def test_points_that_are_not_finite_never_get_this_far(self):
        with pytest.raises(InvalidValue, match="cloud points"):
            PointCloud([[0.0, np.nan, 0.0]])

    def test_an_image_without_any_depth_gives_no_free_space(self, templates):
        image, owner = drawn([(by_name(templates, "box").mesh, upright(0.4))])
        blind = DepthImage(np.full(image.depth.shape, np.nan), CAMERA, X_WC)
        found = register(segment_of(image, owner), templates, blind)
        assert found.violations == 0.0
        assert found.visible_fraction == 0.0

    def test_points_all_over_the_room_are_refused(self, templates):
        image, _ = drawn([])
        points = np.random.default_rng(0).uniform(-10.0, 10.0, (500, 3))
        found = register(Segment(PointCloud(points), nothing_at(), False), templates, image)
        assert "no object on a table" in found.refusal

    def test_a_segment_taller_than_every_template_is_refused(self, templates):
        tower = cuboid([-0.03, -0.03, 0.0], [0.03, 0.03, 0.3])
        image, owner = drawn([(tower, Pose.identity())])
        found = register(segment_of(image, owner), templates, image)
        assert found.refusal
        assert not found.accepted

    @pytest.mark.parametrize("names", [(), ("can", "can")])
    def test_templates_have_to_be_there_once(self, names):
        image, owner = drawn([])
        with pytest.raises(InvalidValue, match="each name once"):
            register(segment_of(image, owner), [catalogue_template(n) for n in names], image)
        if names:
            with pytest.raises(InvalidValue, match="each name once"):
                register_scene([], [catalogue_template(n) for n in names], image)

    @pytest.mark.parametrize(
        ("field", "value"),
        [("voxel", 0.0), ("tolerance", np.nan), ("refined", 0), ("method", "magic"), ("free_rotations", -1)],
    )
    def test_settings_out_of_range_are_refused(self, field, value):
        with pytest.raises(InvalidValue, match=f"SearchSettings.{field}"):
            SearchSettings(**{field: value})


class TestWholeScene:
    def test_the_two_halves_of_a_parted_object_are_one(self, templates):
        box = by_name(templates, "box")
        X_WO = upright(0.9) @ next(X for X in box.resting if abs(X.rotation_matrix()[2, 2]) < 0.5)
        image, owner = drawn([(box.mesh, X_WO)], noise=1e-3)
        whole = segment_of(image, owner)
        rows, columns = np.nonzero(whole.pixels)
        middle = np.median(columns)
        points = image.points()
        halves = []
        for side in (columns < middle - 4, columns > middle + 4):
            mask = np.zeros_like(whole.pixels)
            mask[rows[side], columns[side]] = True
            halves.append(Segment(PointCloud(points[mask]), mask, False))
        (found,) = register_scene(halves, templates, image)
        assert set(found.pieces) == {0, 1}
        assert found.registration.accepted
        assert surface_distance(box, X_WO, found.registration.X_WO) < 1.5e-3

    def test_two_objects_taken_for_one_are_cut_apart(self, templates):
        can, box = by_name(templates, "can"), by_name(templates, "box")
        poses = {"can": upright(0.0, 0.0, -0.045), "box": upright(0.0, 0.0, 0.025)}
        image, owner = drawn([(can.mesh, poses["can"]), (box.mesh, poses["box"])], noise=5e-4)
        one = segment_of(image, np.where(owner >= 0, 0, -1))
        assert register(one, templates, image).refusal
        found = register_scene([one], templates, image)
        good = {f.registration.template: f.registration for f in found if not f.registration.refusal}
        assert set(good) == {"box", "can"}
        for name, result in good.items():
            assert surface_distance(by_name(templates, name), poses[name], result.X_WO) < 2e-3

    def test_without_segments_nothing_is_found(self, templates):
        image, _ = drawn([])
        assert register_scene([], templates, image) == ()


def open3d_works():
    if importlib.util.find_spec("open3d") is None:
        return False
    try:
        import open3d  # noqa: F401
    except (ImportError, OSError):  # the wheel is there, a system library is not
        return False
    return True


@pytest.mark.skipif(not open3d_works(), reason="open3d cannot be imported")
def test_features_find_an_object_in_the_air(templates):
    from optsc.perception.pose_hypotheses import feature_starts

    box = by_name(templates, "box")
    X_WO = Pose.from_rotation_vector([0.5, 0.3, 0.2], [0.0, 0.0, 0.15])
    image, owner = drawn([(box.mesh, X_WO)], noise=5e-4)
    segment = segment_of(image, owner)
    starts = feature_starts(box, segment.cloud.points, 0.004)
    assert len(starts) > 0
    settings = RegistrationSettings(search=SearchSettings(features=True))
    found = register(segment, templates, image, settings=settings)
    assert found.template == "box"


@pytest.mark.skipif(open3d_works(), reason="open3d can be imported")
def test_features_without_open3d_say_what_to_install(templates):
    image, owner = drawn([(by_name(templates, "box").mesh, upright())])
    settings = RegistrationSettings(search=SearchSettings(features=True))
    with pytest.raises(InvalidValue, match=r"optsc\[features\]"):
        register(segment_of(image, owner), templates, image, settings=settings)
