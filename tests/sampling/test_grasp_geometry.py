"""The parts of the sampler: surface points, rays, swept boxes, pads, and the choice of a few."""

import numpy as np
import pytest

from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.robot.gripper import PANDA_HAND
from optsc.sampling.antipodal import LENGTH, pose_distance, spread_out
from optsc.sampling.contacts import (
    approach_boxes,
    closing_boxes,
    collides,
    in_tool_frame,
    lowest_point,
    pad_contacts,
    thin_product,
)
from optsc.sampling.proposals import exits
from optsc.sampling.surface import SurfacePoints, centre_of_mass, is_closed, mesh_area, sample_surface
from optsc.sim.objects import object_model
from optsc.sim.objects.solids import cuboid


def random_poses(rng: np.random.Generator, count: int, scale: float = 0.05) -> Pose:
    return Pose(rotation.random(rng, (count,)), scale * rng.normal(size=(count, 3)))


class TestSurface:
    def test_areas_of_the_points_sum_to_the_area(self, brick: TriangleMesh) -> None:
        surface = sample_surface(brick, 0.002, np.random.default_rng(0))
        exact = 2 * (0.04 * 0.06 + 0.04 * 0.08 + 0.06 * 0.08)
        assert mesh_area(brick) == pytest.approx(exact, rel=1e-9)
        assert surface.areas.sum() == pytest.approx(exact, rel=1e-9)
        assert surface.every(8).areas.sum() == pytest.approx(exact, rel=0.05)

    def test_points_lie_on_the_surface_about_as_far_apart_as_asked(self, brick: TriangleMesh) -> None:
        points = sample_surface(brick, 0.002, np.random.default_rng(0)).points
        to_faces = np.abs(np.abs(points - [0.0, 0.0, 0.04]) - [0.02, 0.03, 0.04])
        assert np.all(to_faces.min(axis=1) < 1e-9)
        top = points[points[:, 2] > 0.08 - 1e-9, :2]
        grid = np.stack(np.meshgrid(np.linspace(-0.02, 0.02, 21), np.linspace(-0.03, 0.03, 31)), axis=-1)
        gaps = np.linalg.norm(grid.reshape(-1, 1, 2) - top, axis=-1).min(axis=1)
        assert gaps.max() < 3 * 0.002

    def test_sharp_corners_are_among_the_points_and_round_sides_are_not_marked(self, brick: TriangleMesh) -> None:
        surface = sample_surface(brick, 0.002, np.random.default_rng(0))
        for corner in brick.vertices:
            assert np.linalg.norm(surface.points - corner, axis=1).min() < 1e-12
        can = sample_surface(object_model("can").mesh, 0.002, np.random.default_rng(0))
        marked = can.points[can.areas == 0.0]
        assert not np.any((marked[:, 2] > 0.01) & (marked[:, 2] < 0.09))

    def test_centre_of_mass_is_that_of_the_solid_and_moves_with_it(self, brick: TriangleMesh) -> None:
        tetrahedron = TriangleMesh(
            np.vstack([np.zeros(3), 0.1 * np.eye(3)]), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
        )
        assert np.allclose(centre_of_mass(tetrahedron), 0.025)
        shift = np.array([0.3, -0.2, 0.1])
        moved = TriangleMesh(brick.vertices + shift, brick.faces)
        assert np.allclose(centre_of_mass(moved) - shift, [0.0, 0.0, 0.04])

    def test_an_open_surface_is_known_as_open_and_has_the_centre_of_its_area(self, brick: TriangleMesh) -> None:
        bottomless = TriangleMesh(brick.vertices, brick.faces[np.ptp(brick.vertices[brick.faces, 2], axis=1) > 0])
        assert is_closed(brick)
        assert not is_closed(bottomless)
        assert np.allclose(centre_of_mass(bottomless), [0.0, 0.0, 0.04])


class TestRays:
    def test_a_ray_through_a_box_leaves_it_once_at_the_far_face(self, brick: TriangleMesh) -> None:
        ray, distance, normal = exits(brick, np.array([[-0.02, 0.011, 0.031]]), np.array([[1.0, 0.0, 0.0]]), 0.1)
        assert ray.tolist() == [0]
        assert distance == pytest.approx([0.04])
        assert np.allclose(normal, [[1.0, 0.0, 0.0]])

    def test_a_ray_that_is_too_short_or_goes_outwards_finds_nothing(self, brick: TriangleMesh) -> None:
        start, along = np.array([[-0.02, 0.011, 0.031]]), np.array([[1.0, 0.0, 0.0]])
        assert len(exits(brick, start, along, 0.039)[0]) == 0
        assert len(exits(brick, start, -along, 0.1)[0]) == 0

    def test_a_ray_across_a_mug_leaves_both_of_its_walls(self) -> None:
        mug = object_model("mug").mesh
        ray, distance, _ = exits(mug, np.array([[0.0, -0.04, 0.0711]]), np.array([[0.001, 1.0, 0.0]]), 0.1)
        assert ray.tolist() == [0, 0]
        assert np.sort(distance) == pytest.approx([0.0101, 0.0739], abs=4e-4)


class TestClearance:
    def test_touched_agrees_with_looking_at_every_point_in_every_box(self) -> None:
        rng = np.random.default_rng(0)
        points, X_OG = 0.06 * rng.normal(size=(40, 3)), random_poses(rng, 60)
        boxes, margin = PANDA_HAND.boxes(0.05), (0.002, 0.0, 0.005)
        expected = []
        for pose in X_OG:
            p = pose.inverse().apply(points)
            grown = boxes + np.array([[-1.0], [1.0]]) * margin
            expected.append(any(np.any(np.all((p > b[0]) & (p < b[1]), axis=1)) for b in grown))
        assert 5 < sum(expected) < 55
        assert collides(in_tool_frame(X_OG, points), boxes, margin).tolist() == expected

    def test_boxes_of_each_pose_are_used_for_that_pose(self) -> None:
        X_OG, point = Pose.identity((2,)), np.array([[0.0, 0.03, 0.0]])
        boxes = closing_boxes(PANDA_HAND, np.array([0.07, 0.02]))
        assert collides(in_tool_frame(X_OG, point), boxes, (0.0, 0.0, 0.0)).tolist() == [False, True]

    def test_the_approach_contains_the_open_gripper_and_its_half_turn_all_along(self) -> None:
        swept = approach_boxes(PANDA_HAND, 0.1)
        rng = np.random.default_rng(1)
        for distance in rng.uniform(0.0, 0.1, 8):
            for low, high in PANDA_HAND.boxes(PANDA_HAND.max_opening):
                point = rng.uniform(low, high) - [0.0, 0.0, distance]
                for p in (point, point * [-1.0, -1.0, 1.0]):
                    assert np.any(np.all((p >= swept[:, 0] - 1e-12) & (p <= swept[:, 1] + 1e-12), axis=1))

    def test_closing_contains_the_jaws_at_every_opening_on_the_way_and_not_beyond(self) -> None:
        (swept,) = closing_boxes(PANDA_HAND, np.array([0.03]))
        jaws = PANDA_HAND.boxes(0.0)[len(PANDA_HAND.body) :]
        for opening in (0.03, 0.05, 0.08):
            moved = PANDA_HAND.boxes(opening)[len(PANDA_HAND.body) :]
            assert np.all(moved[:, 0] >= swept[:, 0] - 1e-12)
            assert np.all(moved[:, 1] <= swept[:, 1] + 1e-12)
        assert len(swept) == len(jaws)
        assert np.abs(swept[..., 1]).min() == pytest.approx(0.015)

    def test_lowest_point_is_that_of_the_lowest_corner(self) -> None:
        X_OG, boxes = random_poses(np.random.default_rng(0), 20), PANDA_HAND.boxes(0.08)
        corners = np.array([[b[i, 0], b[j, 1], b[k, 2]] for b in boxes for i, j, k in np.ndindex(2, 2, 2)])
        assert np.allclose(lowest_point(X_OG, boxes), X_OG[:, None].apply(corners)[..., 2].min(axis=1))


class TestContacts:
    """A box of 40 mm between the pads: its faces are at y = -20 mm and y = 20 mm of the tool frame."""

    surface = sample_surface(cuboid([-0.1, -0.02, -0.1], [0.1, 0.02, 0.1]), 0.001, np.random.default_rng(0))

    def contacts(self, surface: SurfacePoints, X_OG: Pose) -> dict[str, float]:
        points_T = in_tool_frame(X_OG, surface.points)
        found = pad_contacts(points_T, surface, X_OG, PANDA_HAND, 0.5)._asdict()
        return {name: float(value[0]) for name, value in found.items() if value.ndim == 1}

    def test_pads_flat_on_the_box_are_covered_centred_and_aligned(self) -> None:
        found = self.contacts(self.surface, Pose.identity((1,)))
        assert found["width"] == pytest.approx(0.04, abs=1e-6)
        assert found["offset"] == pytest.approx(0.0, abs=1e-6)
        assert found["coverage"] == pytest.approx(1.0, abs=0.1)
        assert found["eccentricity"] < 0.1
        assert found["alignment"] == pytest.approx(1.0, abs=1e-6)

    def test_the_middle_of_the_load_and_the_inward_normals_face_each_other(self) -> None:
        X_OG = Pose.identity((1,))
        found = pad_contacts(in_tool_frame(X_OG, self.surface.points), self.surface, X_OG, PANDA_HAND, 0.5)
        assert np.allclose(found.points[0], [[0.0, -0.02, 0.0], [0.0, 0.02, 0.0]], atol=1e-3)
        assert np.allclose(found.inward[0], [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]], atol=1e-6)

    def test_a_pad_half_over_the_edge_is_half_covered_and_eccentric(self) -> None:
        at_the_edge = Pose.from_translation([[0.1, 0.0, 0.0]])
        found = self.contacts(self.surface, at_the_edge)
        assert found["coverage"] == pytest.approx(0.5, abs=0.08)
        assert found["eccentricity"] == pytest.approx(0.5, abs=0.08)

    def test_an_object_nearer_to_one_jaw_shows_in_the_offset(self) -> None:
        found = self.contacts(self.surface, Pose.from_translation([[0.0, -0.004, 0.0]]))
        assert found["offset"] == pytest.approx(0.004, abs=1e-6)
        assert found["width"] == pytest.approx(0.04, abs=1e-6)

    def test_a_tilted_pad_has_the_cosine_of_the_tilt_and_less_load(self) -> None:
        tilt = np.radians(8.0)
        found = self.contacts(self.surface, Pose.from_rotation_vector([[tilt, 0.0, 0.0]], np.zeros((1, 3))))
        assert found["alignment"] == pytest.approx(np.cos(tilt), abs=1e-6)
        # One millimetre deep, the pad covers 1 mm / sin(tilt) of the face.
        assert found["coverage"] == pytest.approx(0.001 / np.sin(tilt) / PANDA_HAND.pad_size[1], rel=0.3)

    def test_a_face_outside_the_friction_cone_carries_no_load(self) -> None:
        X_OG = Pose.from_rotation_vector([[np.radians(30.0), 0.0, 0.0]], np.zeros((1, 3)))
        points_T = in_tool_frame(X_OG, self.surface.points)
        load = [pad_contacts(points_T, self.surface, X_OG, PANDA_HAND, mu).coverage[0] for mu in (0.5, 0.7)]
        assert np.degrees(np.arctan([0.5, 0.7])) == pytest.approx([26.6, 35.0], abs=0.1)
        assert load[0] == 0.0
        assert load[1] > 0.01

    def test_nothing_between_the_jaws_gives_zeros(self) -> None:
        found = self.contacts(self.surface, Pose.from_translation([[1.0, 0.0, 0.0]]))
        assert (found["width"], found["offset"], found["coverage"]) == (0.0, 0.0, 0.0)


class TestSpread:
    def test_distance_of_a_jaw_symmetric_grasp_from_its_half_turn_is_zero(self) -> None:
        X = random_poses(np.random.default_rng(0), 10)
        turned = X @ Pose.from_rotation_vector([0.0, 0.0, np.pi], np.zeros(3))
        assert np.allclose(pose_distance(X, turned, jaw_symmetric=True), 0.0, atol=1e-9)
        assert np.allclose(pose_distance(X, turned, jaw_symmetric=False), np.pi)

    def test_distance_weighs_length_and_angle_as_documented(self) -> None:
        a = Pose.identity()
        b = Pose.from_rotation_vector([0.4, 0.0, 0.0], [0.0, 0.0, 0.3 * LENGTH])
        assert pose_distance(a, b, jaw_symmetric=True) == pytest.approx(0.5)

    def test_the_best_comes_first_and_nothing_comes_twice(self) -> None:
        rng = np.random.default_rng(0)
        X, quality = random_poses(rng, 40), rng.uniform(0.1, 0.9, 40)
        chosen = spread_out(X, quality, 15, jaw_symmetric=True)
        assert chosen[0] == np.argmax(quality)
        assert len(set(chosen)) == 15

    def test_two_distant_clusters_are_both_represented_by_their_best(self) -> None:
        p = np.zeros((10, 3))
        p[5:, 0] = 1.0
        p[:, 1] = 1e-3 * np.arange(10)
        quality = np.array([0.5, 0.9, 0.5, 0.5, 0.5, 0.5, 0.5, 0.8, 0.5, 0.5])
        assert spread_out(Pose.from_translation(p), quality, 2, jaw_symmetric=True).tolist() == [1, 7]

    def test_too_few_poses_are_all_taken_and_none_gives_none(self) -> None:
        X = random_poses(np.random.default_rng(0), 3)
        assert sorted(spread_out(X, np.full(3, 0.5), 10, jaw_symmetric=False)) == [0, 1, 2]
        assert spread_out(Pose.identity((0,)), np.zeros(0), 10, jaw_symmetric=False).shape == (0,)


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (7, 100_000), (3000, 120), (0, 5), (5, 0)])
def test_a_thin_product_is_the_product(rows: int, columns: int) -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(rows, 3)), rng.normal(size=(3, columns))
    np.testing.assert_allclose(thin_product(a, b), a @ b, rtol=0.0, atol=1e-12)
    assert thin_product(a.astype(np.float32), b.astype(np.float32)).dtype == np.float32
