import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import TriangleMesh

TETRAHEDRON = TriangleMesh(
    np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]),
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)


def test_samples_lie_on_the_surface_with_outward_normals():
    points, normals = TETRAHEDRON.sample(np.random.default_rng(0), 500)
    on_face = np.stack([points[:, 2], points[:, 1], points[:, 0], (1 - points.sum(axis=1)) / np.sqrt(3)], axis=1)
    np.testing.assert_allclose(np.abs(on_face).min(axis=1), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    centre = TETRAHEDRON.vertices.mean(axis=0)
    assert np.all(np.einsum("ij,ij->i", normals, points - centre) > 0)


def test_samples_are_uniform_by_area():
    points, _ = TETRAHEDRON.sample(np.random.default_rng(0), 20000)
    slanted = np.mean(np.abs(points.sum(axis=1) - 1) < 1e-9)
    assert slanted == pytest.approx(np.sqrt(3) / (3 + np.sqrt(3)), abs=0.02)


def test_the_hash_is_of_the_shape_alone():
    again = TriangleMesh(TETRAHEDRON.vertices + 1e-9, TETRAHEDRON.faces)
    other = TriangleMesh(TETRAHEDRON.vertices * 1.01, TETRAHEDRON.faces)
    assert again.hash == TETRAHEDRON.hash != other.hash


def test_impossible_meshes_are_refused():
    for vertices, faces in (
        (np.zeros((3, 2)), [[0, 1, 2]]),
        (np.full((3, 3), np.nan), [[0, 1, 2]]),
        (np.zeros((3, 3)), np.zeros((0, 3))),
        (np.zeros((3, 3)), [[0, 1, 3]]),
    ):
        with pytest.raises(InvalidValue):
            TriangleMesh(vertices, faces)
