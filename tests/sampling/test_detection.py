"""Grasps on clouds: completed ones, partial ones of unknown objects, noisy ones, and what is no cloud of an object."""

from dataclasses import replace

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import PointCloud, Pose, TriangleMesh, rotation
from optsc.grasps import GraspSet
from optsc.robot.gripper import PANDA_HAND
from optsc.sampling.checks import Tally
from optsc.sampling.contacts import cone_cosine
from optsc.sampling.detection import cloud_hash, detect_grasps, with_hidden_side
from optsc.sampling.proposals import propose_on_points
from optsc.sampling.settings import AntipodalSettings
from optsc.sampling.surface import measured_surface, mesh_area, with_normals
from optsc.sim.objects import object_model

FEW = replace(AntipodalSettings.for_clouds(12), pool=2, spacing=0.003)
EYE = np.array([0.5, 0.2, 0.6])


def cloud_of(mesh: TriangleMesh, count: int = 4000, noise: float = 0.0, seed: int = 0) -> PointCloud:
    rng = np.random.default_rng(seed)
    points, normals = mesh.sample(rng, count)
    return PointCloud(points + noise * rng.normal(size=points.shape), normals)


def seen_from(mesh: TriangleMesh, eye: np.ndarray) -> PointCloud:
    """What of a convex mesh is seen, without normals."""
    cloud = cloud_of(mesh)
    assert cloud.normals is not None
    towards = np.einsum("ni,ni->n", cloud.normals, eye - cloud.points) > 0.0
    return PointCloud(cloud.points[towards])


def detect(cloud: PointCloud, **change: object) -> GraspSet:
    arguments = {"name": "thing", "seed": 1, "settings": FEW, "support": 0.0, **change}
    return detect_grasps(cloud, PANDA_HAND, **arguments)  # type: ignore[arg-type]


class TestMeasuredSurface:
    @pytest.mark.parametrize("known", [True, False])
    def test_normals_areas_and_noise_are_those_of_the_surface(self, brick: TriangleMesh, known: bool) -> None:
        cloud = cloud_of(brick, 6000, noise=0.0005)
        surface, noise = measured_surface(cloud if known else PointCloud(cloud.points), 0.003, "brick")
        inner = np.sort(np.abs(surface.points - [0.0, 0.0, 0.04]) - [0.02, 0.03, 0.04], axis=1)[:, 1] < -0.006
        middle = surface.points[inner] - [0.0, 0.0, 0.04]
        side = np.argmax(np.abs(middle) - [0.02, 0.03, 0.04], axis=1)
        outward = np.sign(middle[np.arange(len(side)), side])
        cosine = surface.normals[inner][np.arange(len(side)), side] * outward
        assert inner.sum() > 200
        assert np.quantile(cosine, 0.02) > 0.97
        assert surface.areas.sum() == pytest.approx(mesh_area(brick), rel=0.2)
        assert 0.0002 < noise < 0.0009

    def test_the_two_sides_of_a_thin_wall_stay_apart(self) -> None:
        wall = cloud_of(object_model("mug").mesh, 8000)
        surface, noise = measured_surface(wall, 0.0025, "mug")
        assert noise < 0.0006
        radius = np.linalg.norm(surface.points[:, :2], axis=1)
        high = (surface.points[:, 2] > 0.06) & (surface.points[:, 2] < 0.08) & (radius < 0.036)
        along = np.einsum("ni,ni->n", surface.normals[:, :2], surface.points[:, :2]) / radius
        assert np.mean(along[high & (radius > 0.0335)] > 0.8) > 0.97
        assert np.mean(along[high & (radius < 0.0305)] < -0.8) > 0.97

    def test_a_flying_pixel_is_dropped(self, brick: TriangleMesh) -> None:
        points = np.concatenate([cloud_of(brick).points, [[0.0, 0.0, 0.2]]])
        assert measured_surface(PointCloud(points), 0.003, "brick").surface.points[:, 2].max() < 0.1

    def test_seen_points_have_normals_towards_the_camera(self, brick: TriangleMesh) -> None:
        cloud = with_normals(seen_from(brick, EYE), 0.003, "brick", EYE)
        assert cloud.normals is not None
        assert np.all(np.einsum("ni,ni->n", cloud.normals, EYE - cloud.points) > 0.0)


class TestHiddenSide:
    def test_the_unseen_faces_of_a_brick_are_guessed_where_they_are(self, brick: TriangleMesh) -> None:
        whole = with_hidden_side(seen_from(brick, EYE), EYE)
        guessed = whole.select(~whole.seen_mask).points
        assert len(guessed) > 500
        off = np.abs(np.max(np.abs(guessed - [0.0, 0.0, 0.04]) - [0.02, 0.03, 0.04], axis=1))
        assert np.quantile(off, 0.9) < 0.005

    def test_what_was_seen_stays_as_it_is(self, brick: TriangleMesh) -> None:
        seen = seen_from(brick, EYE)
        whole = with_hidden_side(seen, EYE)
        assert whole.select(whole.seen_mask).points.tobytes() == seen.points.tobytes()

    def test_nothing_is_guessed_where_the_camera_looked_through(self, brick: TriangleMesh) -> None:
        whole = with_hidden_side(seen_from(brick, EYE), EYE)
        guessed = whole.select(~whole.seen_mask).points
        outside = guessed[np.any(np.abs(guessed[:, :2]) > [0.026, 0.036], axis=1)]
        rays = (outside - EYE)[:, None] * np.linspace(0.0, 1.0, 400)[:, None] + EYE  # from the eye to the point
        near = np.abs(rays - [0.0, 0.0, 0.04]) < np.array([0.02, 0.03, 0.04]) + 0.012
        assert np.all(near.all(axis=2).any(axis=1))

    def test_a_viewpoint_at_the_object_or_nowhere_is_refused(self, brick: TriangleMesh) -> None:
        for eye in ([np.nan, 0.0, 1.0], [0.0, 0.0, 0.08]):
            with pytest.raises(InvalidValue, match="viewpoint"):
                with_hidden_side(cloud_of(brick), np.array(eye))


class TestDetection:
    @pytest.mark.parametrize("noise", [0.0, 0.001])
    def test_a_brick_is_held_by_opposite_faces(self, brick: TriangleMesh, noise: float) -> None:
        grasps = detect(cloud_of(brick, noise=noise))
        assert len(grasps) == 12
        closing = np.abs(grasps.X_OG.rotation_matrix()[:, :, 1])
        straight = closing.max(axis=1) > np.cos(np.radians(15))
        assert straight.all() if noise == 0.0 else straight.mean() > 0.7
        across = np.array([0.04, 0.06, 0.08])[closing.argmax(axis=1)]
        assert np.all(np.abs(grasps.opening - across)[straight] < 0.01)
        assert np.all(grasps.X_OG.rotation_matrix()[:, 2, 2] <= 1e-9)
        assert grasps.provenance["source"] == "cloud"

    def test_a_brick_seen_from_one_side_is_held_by_a_face_that_was_not_seen(self, brick: TriangleMesh) -> None:
        seen = seen_from(brick, EYE)
        assert len(detect(seen)) == 0
        grasps = detect(seen, viewpoint=EYE)
        assert len(grasps) == 12
        closing = np.abs(grasps.X_OG.rotation_matrix()[:, :, 1])
        assert np.all(closing.max(axis=1) > np.cos(np.radians(20)))
        assert grasps.provenance["guessed"] > 500  # type: ignore[operator]

    def test_the_same_input_gives_the_same_bytes_and_another_seed_others(self, brick: TriangleMesh) -> None:
        first, again, other = (detect(cloud_of(brick), seed=seed) for seed in (1, 1, 2))
        assert first.X_OG.translation.tobytes() == again.X_OG.translation.tobytes()
        assert first.quality.tobytes() == again.quality.tobytes()
        assert first.X_OG.translation.tobytes() != other.X_OG.translation.tobytes()

    def test_a_toppled_object_gets_grasps_from_above_the_table(self, brick: TriangleMesh) -> None:
        X_UO = Pose.from_rotation_vector([0.5 * np.pi, 0.0, 0.0], [0.0, 0.0, 0.03])  # as it lies, z up
        cloud, up = cloud_of(brick), X_UO.inverse().rotation_matrix()[:, 2]
        tally = Tally(keep=True)
        grasps = detect(cloud, up=up, support=-0.03, tally=tally)
        assert len(grasps) == 12
        assert tally.poses is not None
        assert tally.poses["kept"][0].almost_equal(grasps.X_OG, 1e-12)
        X_UG = X_UO @ grasps.X_OG
        assert np.all(X_UG.rotation_matrix()[:, 2, 2] <= 1e-9)
        corners = PANDA_HAND.boxes(PANDA_HAND.max_opening)
        lowest = X_UG[:, None].apply(corners.reshape(-1, 3))[..., 2].min()
        assert lowest >= 0.0

    def test_without_a_table_hands_come_from_below_too(self, brick: TriangleMesh) -> None:
        grasps = detect(cloud_of(brick), support=None)
        assert grasps.X_OG.rotation_matrix()[:, 2, 2].max() > 0.5

    def test_the_hand_keeps_away_from_a_neighbour(self, brick: TriangleMesh) -> None:
        wall = np.stack(np.meshgrid([0.06], np.linspace(-0.2, 0.2, 81), np.linspace(0, 0.3, 61)), axis=-1)
        neighbour = PointCloud(wall.reshape(-1, 3))
        grasps = detect(cloud_of(brick), neighbours=neighbour)
        assert len(grasps) == 12
        boxes = PANDA_HAND.boxes(PANDA_HAND.max_opening)
        for distance in (0.0, 0.05, 0.1):
            for X in grasps.X_OG @ Pose.from_translation([0.0, 0.0, -distance]):
                p = X.inverse().apply(neighbour.points)
                assert not any(np.any(np.all((p > low) & (p < high), axis=1)) for low, high in boxes)

    def test_provenance_tells_the_view_and_what_the_caller_knows(self, brick: TriangleMesh) -> None:
        cloud = cloud_of(brick)
        half = PointCloud(cloud.points, cloud.normals, np.arange(len(cloud)) % 4 > 0)
        grasps = detect(half, provenance={"template": "brick", "stamp": 3.0}, viewpoint=EYE)
        assert grasps.visible_fraction == pytest.approx(0.75)
        assert (grasps.stamp, grasps.provenance["template"], grasps.provenance["guessed"]) == (
            3.0,
            "brick",
            0,
        )
        assert grasps.object_hash == cloud_hash(half)
        assert not grasps.made_on_mesh

    def test_too_few_grasps_come_with_the_reason_and_the_funnel(self) -> None:
        ball = np.random.default_rng(0).normal(size=(3000, 3))
        ball *= 0.06 / np.linalg.norm(ball, axis=1, keepdims=True)
        tally = Tally(keep=True)
        settings = replace(FEW, max_rounds=2)
        grasps = detect(PointCloud(ball + [0.0, 0.0, 0.06]), settings=settings, tally=tally)
        assert len(grasps) == 0
        assert "0 of 12 found in 2 rounds" in str(grasps.provenance["reason"])
        assert tally.poses is not None
        assert sum(map(len, tally.poses["antipodal"])) == tally.funnel["antipodal"]

    def test_proposals_on_points_have_both_contacts_in_the_friction_cone(self, brick: TriangleMesh) -> None:
        surface = measured_surface(cloud_of(brick), 0.003, "brick").surface
        settings = replace(FEW, friction=0.3)
        closing = propose_on_points(surface, PANDA_HAND, settings, np.random.default_rng(0))
        assert len(closing) > 200
        cosine = np.abs(closing.rotation_matrix()[:, :, 1]).max(axis=1)
        # The estimated normals of points at edges are off by up to 45 degrees.
        assert np.mean(cosine >= cone_cosine(0.3) - 0.02) > 0.9


class TestBadInput:
    @pytest.mark.parametrize("count", [0, 1, 29])
    def test_an_empty_cloud_and_a_few_pixels_are_refused(self, brick: TriangleMesh, count: int) -> None:
        with pytest.raises(InvalidValue, match="points of thing") as error:
            detect(cloud_of(brick).select(np.arange(count)))
        assert error.value.value == count

    def test_a_cloud_in_millimetres_is_suspected(self, brick: TriangleMesh) -> None:
        with pytest.raises(InvalidValue, match="millimetres"):
            detect(PointCloud(1000.0 * cloud_of(brick).points))

    def test_points_that_do_not_hang_together_are_refused(self) -> None:
        with pytest.raises(InvalidValue, match="connected points"):
            detect(PointCloud(np.random.default_rng(0).uniform(0.0, 1.0, (50, 3))))

    @pytest.mark.parametrize("up", [[0.0, 0.0, 0.0], [np.nan, 0.0, 1.0], [0.0, 1.0]])
    def test_no_direction_of_up_is_refused(self, brick: TriangleMesh, up: list[float]) -> None:
        with pytest.raises(InvalidValue, match="up"):
            detect(cloud_of(brick), up=up)

    def test_a_negative_seed_is_refused(self, brick: TriangleMesh) -> None:
        with pytest.raises(InvalidValue, match="seed"):
            detect(cloud_of(brick), seed=-1)


def test_grasps_turn_with_the_object(brick: TriangleMesh) -> None:
    """Turned about the vertical, a cloud is divided into other cubes: the grasps are others but just as good."""
    turn = Pose(rotation.exp([0.0, 0.0, 0.6]), np.zeros(3))
    straight, turned = detect(cloud_of(brick)), detect(cloud_of(brick).transformed(turn))
    closing = np.abs((turn.inverse() @ turned.X_OG).rotation_matrix()[:, :, 1])
    assert np.all(closing.max(axis=1) > np.cos(np.radians(15)))
    assert len(turned) == len(straight)
