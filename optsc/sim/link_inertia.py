"""Masses of links whose description states none: estimated from their shapes, since a simulator cannot do without.

A moving body without mass does not move in PyBullet, and one kilogram at every link, its default, is no arm either.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from optsc.collision.capsules import surface
from optsc.collision.link_shapes import LinkShapes, massless_links
from optsc.geometry import TriangleMesh, rotation
from optsc.geometry.rotation import Array
from optsc.robot import RobotModel
from optsc.sim.bullet_bodies import Inertia, inertia

DENSITY = 1200.0
"""Mass of an arm per volume of its links' convex hulls [kg/m^3].

What the descriptions of Panda, UR3, UR5, UR10, xArm7 and Z1 state for the whole arm lies between 885 and 1532.
"""
LEAST_MASS = 0.05
"""Mass of a moving link without any shape [kg]; it gets the moments of a ball of `LEAST_RADIUS` [m]."""
LEAST_RADIUS = 0.03
_LOG = logging.getLogger(__name__)


class LinkInertia(NamedTuple):
    """Estimated mass [kg] of a link, and its centre, axes and moments in the link's frame."""

    mass: float
    inertia: Inertia | None


def estimated_inertias(robot: RobotModel) -> Mapping[str, LinkInertia]:
    """Return an estimate, by link, for every moving body of a description that has no mass.

    A body is a link with all that is fixed to it. The mass is that of the convex hulls of its collision shapes at
    `DENSITY`. Empty for a description that states all masses, which is then not looked at further.

    Raises:
        DamagedFile: a mesh that is needed was not found.
    """
    without = massless_links(robot)
    if not without:
        return {}
    shapes, found = LinkShapes(robot), {}
    for joint, link in without.items():
        hulls = [_hull(shape) for shape in shapes.shapes if shape.parentJoint == joint]
        found[link] = _estimate([hull for hull in hulls if hull is not None])
    masses = ", ".join(f"{link} {value.mass:.2f} kg" for link, value in found.items())
    _LOG.warning("%s states no mass for: %s (estimated from their shapes)", robot.name, masses)
    return found


def with_inertias(root: Element, inertias: Mapping[str, LinkInertia]) -> Element:
    """Give the links of a description (changed in place) their masses; all others without any get none."""
    for link in root.findall("link"):
        estimate = inertias.get(link.get("name", ""))
        inertial = link.find("inertial")
        if inertial is not None and estimate is None:
            continue
        if inertial is not None:
            link.remove(inertial)
        link.append(_inertial(estimate))
    return root


def _hull(shape: object) -> TriangleMesh | None:
    """Return the convex hull of a shape in the frame of its joint; None for one that is flat."""
    from scipy.spatial import ConvexHull, QhullError

    points = surface(shape.geometry, shape.name).reshape(-1, 3)  # type: ignore[attr-defined]
    X = shape.placement  # type: ignore[attr-defined]
    points = points @ X.rotation.T + X.translation
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    corners = points[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # The library lists the corners of a face in any order.
    inwards = np.einsum("fi,fi->f", normals, hull.equations[:, :3]) < 0.0
    corners[inwards] = corners[inwards][:, ::-1]
    return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def _estimate(hulls: list[TriangleMesh]) -> LinkInertia:
    if not hulls:
        return LinkInertia(LEAST_MASS, None)
    vertices = np.concatenate([hull.vertices for hull in hulls])
    body = TriangleMesh(vertices, np.arange(len(vertices)).reshape(-1, 3))
    mass = max(DENSITY * sum(map(_volume, hulls)), LEAST_MASS)
    return LinkInertia(mass, inertia(body, mass))


def _volume(hull: TriangleMesh) -> float:
    return float(np.linalg.det(hull.vertices[hull.faces]).sum() / 6.0)


def _inertial(estimate: LinkInertia | None) -> Element:
    element = ElementTree.Element("inertial")
    moments = np.zeros((3, 3))
    mass = 0.0 if estimate is None else estimate.mass
    if estimate is not None and estimate.inertia is None:
        moments = np.eye(3) * 0.4 * mass * LEAST_RADIUS**2
    elif estimate is not None and estimate.inertia is not None:
        X_LM, principal = estimate.inertia
        R = rotation.to_matrix(X_LM.quaternion)
        moments = R @ np.diag(principal) @ R.T
        ElementTree.SubElement(element, "origin", xyz=_text(X_LM.translation))
    ElementTree.SubElement(element, "mass", value=repr(float(mass)))
    names = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    ElementTree.SubElement(element, "inertia", {name: repr(float(moments[at])) for name, at in names.items()})
    return element


def _text(vector: Array) -> str:
    return " ".join(repr(float(x)) for x in vector)
