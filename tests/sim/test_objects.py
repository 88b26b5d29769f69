"""The project's own objects: their surfaces, their convex pieces, and how they stand."""

import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import TriangleMesh
from optsc.sampling.surface import centre_of_mass, is_closed
from optsc.sim.objects import OBJECT_NAMES, ObjectModel, object_model
from optsc.sim.objects.solids import cuboid, hull, revolved, tube, union


def winding_number(mesh: TriangleMesh, points: np.ndarray) -> np.ndarray:
    """How often the surface goes around each point: 1 inside, 0 outside (Van Oosterom, Strackee 1983)."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]][None] - points[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    numerator = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    denominator = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return np.arctan2(numerator, denominator).sum(axis=1) / (2 * np.pi)


def volume(mesh: TriangleMesh) -> float:
    return float(np.linalg.det(mesh.vertices[mesh.faces]).sum() / 6.0)


def within_a_part(model: ObjectModel, points: np.ndarray) -> np.ndarray:
    planes = [ConvexHull(part.vertices).equations for part in model.parts]
    return np.any([np.all(points @ p[:, :3].T + p[:, 3] <= 1e-9, axis=1) for p in planes], axis=0)


@pytest.mark.parametrize("name", OBJECT_NAMES)
class TestEveryObject:
    def test_has_a_closed_surface_in_one_piece(self, name: str) -> None:
        mesh = object_model(name).mesh
        assert is_closed(mesh)
        reached, frontier = {0}, {0}
        neighbours: dict[int, set[int]] = {}
        for face in mesh.faces.tolist():
            for vertex in face:
                neighbours.setdefault(vertex, set()).update(face)
        while frontier:
            frontier = set().union(*(neighbours[v] for v in frontier)) - reached
            reached |= frontier
        assert len(reached) == len(mesh.vertices)

    def test_is_inside_its_surface_exactly_where_it_is_inside_a_part(self, name: str) -> None:
        model = object_model(name)
        low, high = model.mesh.vertices.min(axis=0) - 0.005, model.mesh.vertices.max(axis=0) + 0.005
        points = np.random.default_rng(0).uniform(low, high, size=(1500, 3))
        inside = winding_number(model.mesh, points) > 0.5
        assert 100 < inside.sum() < 1400
        assert np.mean(inside == within_a_part(model, points)) > 0.999

    def test_has_convex_parts(self, name: str) -> None:
        for part in object_model(name).parts:
            assert is_closed(part)
            assert volume(part) == pytest.approx(ConvexHull(part.vertices).volume, rel=1e-6)

    def test_stands_on_the_plane_with_its_mass_above_its_footprint(self, name: str) -> None:
        model = object_model(name)
        vertices, centre = model.mesh.vertices, centre_of_mass(model.mesh)
        assert vertices[:, 2].min() == 0.0
        footprint = ConvexHull(vertices[vertices[:, 2] < 1e-6, :2]).equations
        assert np.all(footprint[:, :2] @ centre[:2] + footprint[:, 2] < -0.004)
        assert np.all(footprint[:, 2] <= 0.001)  # the origin is in the footprint, too

    def test_has_a_believable_mass_and_is_narrow_enough_for_the_hand(self, name: str) -> None:
        model = object_model(name)
        assert 0.1 <= model.mass <= 0.4
        assert np.sort(model.mesh.extents)[0] < 0.07
        assert np.sort(model.mesh.extents)[2] < 0.25

    def test_is_built_once_and_then_shared(self, name: str) -> None:
        assert object_model(name) is object_model(name)


def test_objects_have_the_same_hash_in_every_process() -> None:
    script = "from optsc.sim.objects import *; print(*(object_model(n).mesh.hash for n in OBJECT_NAMES))"
    environment = {**os.environ, "PYTHONHASHSEED": "12345", "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.split() == [object_model(name).mesh.hash for name in OBJECT_NAMES]


def test_mug_is_open_hollow_and_has_a_hole_behind_its_handle() -> None:
    mesh = object_model("mug").mesh
    inside_the_cup = [[0.0, 0.0, 0.045], [0.025, 0.0, 0.07], [0.0, -0.028, 0.085], [0.0, 0.0, 0.006]]
    behind_the_handle = [[0.045, 0.0, 0.046], [0.055, 0.0, 0.046], [0.045, 0.0, 0.06]]
    solid = [[0.032, 0.0, 0.045], [0.0, -0.032, 0.085], [0.064, 0.0, 0.046], [0.0, 0.0, 0.003]]
    assert np.allclose(winding_number(mesh, np.array(inside_the_cup + behind_the_handle)), 0.0, atol=1e-6)
    assert np.allclose(winding_number(mesh, np.array(solid)), 1.0, atol=1e-6)


def test_mug_has_one_hole_and_the_other_objects_have_none() -> None:
    for name in OBJECT_NAMES:
        mesh = object_model(name).mesh
        edges = np.unique(np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
        euler = len(mesh.vertices) - len(edges) + len(mesh.faces)
        assert euler == (0 if name == "mug" else 2), name


def test_solids_have_the_volumes_that_geometry_gives_them() -> None:
    polygon = 0.5 * 32 * np.sin(2 * np.pi / 32)  # area of a regular 32-gon in a unit circle
    assert volume(cuboid([-0.01, -0.02, 0.0], [0.01, 0.02, 0.03])) == pytest.approx(2.4e-5, rel=1e-9)
    prism = revolved([(0.03, 0.0), (0.03, 0.1)])
    assert volume(prism) == pytest.approx(polygon * 0.03**2 * 0.1, rel=1e-4)
    ring = union(tube(0.02, 0.03, 0.0, 0.1))
    assert is_closed(ring)
    assert volume(ring) == pytest.approx(polygon * (0.03**2 - 0.02**2) * 0.1, rel=1e-4)


def test_chamfer_takes_a_prism_off_every_edge_of_a_box() -> None:
    size, chamfer = 0.04, 0.004
    # 12 triangular prisms between the corners; a cube in each of the 8 corners loses all but a sixth.
    expected = size**3 - 6 * chamfer**2 * (size - 2 * chamfer) - 8 * (5 / 6) * chamfer**3
    assert volume(cuboid([0, 0, 0], [size] * 3, chamfer)) == pytest.approx(expected, rel=1e-6)


def test_union_of_touching_boxes_has_no_wall_between_them() -> None:
    both = union([cuboid([0, 0, 0], [0.01, 0.01, 0.01]), cuboid([0.01, 0, 0], [0.02, 0.01, 0.01])])
    assert volume(both) == pytest.approx(2e-6, rel=1e-9)
    area = 0.5 * np.linalg.norm(np.cross(*np.diff(both.vertices[both.faces], axis=1).transpose(1, 0, 2)), axis=1)
    assert area.sum() == pytest.approx(10e-4, rel=1e-9)


def test_an_unknown_object_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(UnknownName, match=r"teapot.*banana.*mug"):
        object_model("teapot")


def test_flat_points_have_no_hull_and_say_so() -> None:
    with pytest.raises(InvalidValue, match="span a volume"):
        hull([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])


@pytest.mark.parametrize(("field", "value"), [("mass", 0.0), ("friction", float("nan")), ("parts", ())])
def test_an_impossible_object_is_refused_by_name_of_the_field(field: str, value: object) -> None:
    part = cuboid([0, 0, 0], [0.01, 0.01, 0.01])
    good: dict[str, object] = {"mass": 0.1, "friction": 0.5, "parts": (part,)}
    with pytest.raises(InvalidValue, match=field):
        ObjectModel("brick", part, **{**good, field: value})  # type: ignore[arg-type]
