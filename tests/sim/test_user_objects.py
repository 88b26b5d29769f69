"""User-defined objects: convex pieces that fill what a surface encloses, and not what it does not."""

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import TriangleMesh
from optsc.sim import object_model
from optsc.sim.objects.model import DENSITY, added_thickness, model_from_mesh
from optsc.sim.objects.solids import cuboid


def test_a_convex_surface_is_one_piece_and_weighs_what_it_holds():
    box = cuboid([-0.02, -0.03, 0.0], [0.02, 0.03, 0.05])
    model = model_from_mesh("part", box)
    assert len(model.parts) == 1
    assert model.mass == pytest.approx(DENSITY * 0.04 * 0.06 * 0.05)
    assert model.mesh is box
    assert model_from_mesh("part", box, mass=0.2, friction=0.4).mass == 0.2


def inside(parts, points):
    from scipy.spatial import ConvexHull

    faces = [ConvexHull(part.vertices).equations for part in parts]
    return np.any([(points @ f[:, :3].T + f[:, 3]).max(axis=1) < 1e-6 for f in faces], axis=0)


def test_a_hollow_thing_stays_hollow():
    mug = object_model("mug").mesh
    model = model_from_mesh("mug", mug)
    assert added_thickness(model) < 0.0003
    within = np.array([[0.0, 0.0, 0.05], [0.0, 0.02, 0.08], [0.05, 0.0, 0.046], [0.2, 0.0, 0.0]])
    assert not inside(model.parts, within).any()  # where one drinks from, and behind the handle
    rng = np.random.default_rng(0)
    points, normals = mug.sample(rng, 500)
    assert inside(model.parts, points - 1e-4 * normals).all()


def test_an_open_surface_is_refused():
    box = cuboid([-0.02, -0.03, 0.0], [0.02, 0.03, 0.05])
    with pytest.raises(InvalidValue, match="closed"):
        model_from_mesh("part", TriangleMesh(box.vertices, box.faces[1:]))
    with pytest.raises(InvalidValue, match=r"part.*above 0"):
        model_from_mesh("part", box, mass=-1.0)
