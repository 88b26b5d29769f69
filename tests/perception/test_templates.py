"""Templates: what is computed of a shape beforehand, and what is refused to be one."""

import numpy as np
import pytest

from benchmarks.pose_errors import surface_distance, surface_tail
from optsc.errors import DamagedFile, InvalidValue, UnknownName
from optsc.geometry import Pose, TriangleMesh
from optsc.perception import add_s, catalogue_template, template_from_file, template_from_mesh
from optsc.perception.distance_field import distance_field
from optsc.sim.objects.solids import cuboid, revolved


def prism(sides: int, radius: float = 0.03, height: float = 0.08) -> TriangleMesh:
    return revolved([(radius, 0.0), (radius, height)], sides=sides)


def write(path, mesh, scale=1.0):
    import trimesh

    trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False).export(path)
    return path


BOX = cuboid([-0.02, -0.03, 0.0], [0.02, 0.03, 0.10])


def test_the_distance_field_is_the_signed_distance_to_a_box():
    field = distance_field(BOX, np.random.default_rng(0))
    points = np.random.default_rng(1).uniform([-0.035, -0.045, -0.015], [0.035, 0.045, 0.115], (3000, 3))
    outside = np.maximum(np.abs(points - [0, 0, 0.05]) - [0.02, 0.03, 0.05], -np.inf)
    exact = np.linalg.norm(np.maximum(outside, 0.0), axis=1) + np.minimum(outside.max(axis=1), 0.0)
    found, gradient = field.lookup(points)
    assert np.percentile(np.abs(found - exact), 95) < 5e-4
    assert np.abs(found - exact).max() < 3e-3
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1.0, atol=1e-5)


def test_far_from_the_surface_the_field_goes_on_growing():
    field = distance_field(BOX, np.random.default_rng(0))
    near, far = field.lookup(np.array([[0.1, 0.0, 0.05], [1.0, 0.0, 0.05]]))[0]
    assert near == pytest.approx(0.08, abs=2e-3)
    assert far == pytest.approx(0.98, abs=2e-3)


@pytest.mark.parametrize(("sides", "order"), [(3, 3), (4, 4), (6, 6), (64, 0)])
def test_the_symmetry_of_a_prism_is_the_number_of_its_sides(sides, order):
    assert template_from_mesh("prism", prism(sides), count=400).symmetry == order


def test_the_objects_of_the_catalogue_have_the_symmetries_that_they_show():
    assert catalogue_template("can").round
    assert catalogue_template("box").symmetry == 2
    assert catalogue_template("mug").symmetry == 1


def test_a_box_rests_on_each_of_its_sides_once():
    template = template_from_mesh("box", BOX, count=300)
    up = template.resting.rotation_matrix()[:, 2]
    expected = {(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, 1, 0)}
    assert {tuple(np.abs(np.round(row)) if abs(row[2]) < 0.5 else np.round(row)) for row in up} == expected
    for X in template.resting:
        assert X.apply(BOX.vertices)[:, 2].min() == pytest.approx(0.0, abs=1e-9)


def test_a_can_stands_on_both_ends_and_lies_on_its_side():
    template = catalogue_template("can")
    heights = np.sort(np.round(template.resting.rotation_matrix()[:, 2, 2], 2))
    np.testing.assert_allclose(heights, [-1.0, 0.0, 1.0], atol=0.01)


def test_every_first_part_of_the_points_is_spread_over_the_whole_surface():
    template = catalogue_template("box")
    distances, _ = template.field.lookup(template.points)
    assert np.abs(distances).max() < 2e-3
    few = template.points[:100]
    gaps = np.sqrt(((template.points[:, None] - few[None]) ** 2).sum(-1).min(axis=1))
    assert gaps.max() < 0.03
    assert template.diameter == pytest.approx(np.linalg.norm(template.mesh.extents), abs=3e-3)


def test_the_same_mesh_and_seed_give_the_same_template():
    a, b = (template_from_mesh("box", BOX, count=100, seed=4) for _ in range(2))
    np.testing.assert_array_equal(a.points, b.points)
    np.testing.assert_array_equal(a.field.distance, b.field.distance)


def test_a_template_of_zero_volume_is_refused():
    flat = TriangleMesh(np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0.0]]), np.array([[0, 1, 2], [0, 2, 1]]))
    tilted = TriangleMesh(np.array([[0, 0, 0], [0.1, 0, 0.1], [0, 0.1, 0.1]]), np.array([[0, 1, 2], [0, 2, 1]]))
    for mesh in (flat, tilted):
        with pytest.raises(InvalidValue, match="volume of template sheet"):
            template_from_mesh("sheet", mesh)


def test_a_surface_that_is_inside_out_is_refused():
    with pytest.raises(InvalidValue, match="counter-clockwise"):
        template_from_mesh("box", TriangleMesh(BOX.vertices, BOX.faces[:, ::-1]))


def test_a_mesh_in_millimetres_is_suspected_by_name(tmp_path):
    path = write(tmp_path / "carton.stl", BOX, 1000.0)
    with pytest.raises(InvalidValue, match=r"template carton is 100.*millimetres.*unit=0\.001"):
        template_from_file(path)
    template = template_from_file(path, unit=0.001)
    np.testing.assert_allclose(template.mesh.extents, BOX.extents, atol=1e-6)


def test_a_mesh_that_was_scaled_twice_is_suspected():
    with pytest.raises(InvalidValue, match="scaled twice"):
        template_from_mesh("box", TriangleMesh(BOX.vertices * 1e-3, BOX.faces))


@pytest.mark.parametrize("ending", ["stl", "obj", "ply"])
def test_a_file_gives_a_template_with_its_origin_at_the_centre_of_the_base(tmp_path, ending):
    moved = TriangleMesh(BOX.vertices + [0.3, -0.2, 0.1], BOX.faces)
    template = template_from_file(write(tmp_path / f"thing.{ending}", moved))
    assert template.name == "thing"
    low, high = template.mesh.vertices.min(axis=0), template.mesh.vertices.max(axis=0)
    np.testing.assert_allclose([low[2], *(low + high)[:2]], 0.0, atol=1e-6)
    kept = template_from_file(tmp_path / f"thing.{ending}", keep_frame=True)
    np.testing.assert_allclose(kept.mesh.vertices.min(axis=0), moved.vertices.min(axis=0), atol=1e-6)


def test_what_is_no_mesh_is_called_a_damaged_file(tmp_path):
    with pytest.raises(DamagedFile, match="no such file"):
        template_from_file(tmp_path / "nothing.stl")
    (tmp_path / "words.obj").write_text("these are words\n")
    with pytest.raises(DamagedFile):
        template_from_file(tmp_path / "words.obj")
    (tmp_path / "noise.stl").write_bytes(bytes(range(256)))
    with pytest.raises(DamagedFile):
        template_from_file(tmp_path / "noise.stl")


def test_an_unknown_object_is_named_with_those_that_there_are():
    with pytest.raises(UnknownName, match="mug"):
        catalogue_template("teapot")


def test_add_s_of_three_points_by_hand():
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    shifted = Pose.from_translation([1.0, 0.0, 0.0])
    # found points: 1, 2, 6; nearest to 0: 1, to 1: 0, to 5: 1
    assert add_s(points, Pose.identity(), shifted) == pytest.approx(2.0 / 3.0)
    assert add_s(points, shifted, shifted) == 0.0
    with pytest.raises(InvalidValue, match="points of the model"):
        add_s(np.zeros((0, 3)), Pose.identity(), Pose.identity())


def test_add_s_does_not_see_what_the_shape_does_not_show():
    can, mug = catalogue_template("can"), catalogue_template("mug")
    quarter = Pose.from_rotation_vector([0.0, 0.0, 0.5 * np.pi], [0.0, 0.0, 0.0])
    assert surface_distance(can, Pose.identity(), quarter) < 4e-4
    assert add_s(can.points, Pose.identity(), quarter) < 0.5 * can.spacing
    assert 1e-3 < surface_distance(mug, Pose.identity(), quarter) < 2e-3
    assert surface_tail(mug, Pose.identity(), quarter) > 0.012
    assert surface_tail(can, Pose.identity(), quarter) < 2e-3
    shift = Pose.from_translation([0.0, 0.0, 0.004])
    assert 0.0 < surface_distance(can, Pose.identity(), shift) <= add_s(can.points, Pose.identity(), shift) + 1e-4
