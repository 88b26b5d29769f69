"""Surfaces as points with normals and areas: sampled from a mesh, or estimated from a measured point cloud."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import PointCloud, TriangleMesh
from optsc.geometry.rotation import Array

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


FEWEST = 30
"""Points without which a cloud shows no surface."""
MOST_NOISE = 0.003
"""Error of the points [m] that is believed at most: what is rougher is a rough object."""
_SHARP = np.cos(np.radians(20.0))
_AROUND = 3.0  # radius of the neighbourhood that a plane is laid through, in spacings
_NEIGHBOURS = 24
_LONELY = 5  # points in a neighbourhood, itself included, below which a point is a flying pixel
_SPREAD = 8  # the distance of so many neighbours tells how densely the points lie
_TUBE = 1.2  # radius of the tube that tells inside from outside, in spacings
_FAR = 0.10  # [m], length of the tube


class SurfacePoints(NamedTuple):
    """Points of a surface in the object's frame."""

    points: Array
    """(N, 3) [m]."""
    normals: Array
    """Outward unit normals (N, 3)."""
    areas: Array
    """Area that each point stands for (N,) [m^2]; zero for points that only mark an edge."""

    def every(self, step: int) -> SurfacePoints:
        """Return every ``step``-th point; the areas keep their sum in the mean."""
        return SurfacePoints(self.points[::step], self.normals[::step], self.areas[::step] * step)


def sample_surface(mesh: TriangleMesh, spacing: float, rng: np.random.Generator) -> SurfacePoints:
    """Return points about ``spacing`` [m] apart, uniform by area, shuffled among points along sharp edges.

    The edges are sampled as well because they are what sticks out furthest, and random points miss them.
    """
    area = mesh_area(mesh)
    count = max(int(np.ceil(area / spacing**2)), 100)
    points, normals = mesh.sample(rng, count)
    edge_points, edge_normals = _sharp_edges(mesh, spacing)
    areas = np.concatenate([np.full(count, area / count), np.zeros(len(edge_points))])
    points, normals = np.concatenate([points, edge_points]), np.concatenate([normals, edge_normals])
    order = rng.permutation(len(points))
    return SurfacePoints(points[order], normals[order], areas[order])


def _sharp_edges(mesh: TriangleMesh, spacing: float) -> tuple[Array, Array]:
    """Return points about ``spacing`` apart along edges between faces that turn by more than 20 degrees."""
    crosses = face_crosses(mesh)
    lengths = np.linalg.norm(crosses, axis=1)
    normals = crosses / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    edges = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(mesh.faces)), 3)
    order = np.lexsort(edges.T)
    edges, owner = edges[order], owner[order]
    pairs = np.nonzero(np.all(edges[1:] == edges[:-1], axis=1))[0]
    first, second = normals[owner[pairs]], normals[owner[pairs + 1]]
    sharp = np.einsum("ei,ei->e", first, second) < _SHARP
    pairs, outwards = pairs[sharp], (first + second)[sharp]
    start, end = np.moveaxis(mesh.vertices[edges[pairs]], 1, 0)
    counts = np.ceil(np.linalg.norm(end - start, axis=1) / spacing).astype(int) + 1
    edge = np.repeat(np.arange(len(pairs)), counts)
    within = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)
    fraction = (within / np.maximum(counts[edge] - 1, 1))[:, None]
    # A knife edge's two normals cancel; the length then only must not be divided by.
    outwards /= np.maximum(np.linalg.norm(outwards, axis=1, keepdims=True), 1e-9)
    return start[edge] + fraction * (end - start)[edge], outwards[edge]


def mesh_area(mesh: TriangleMesh) -> float:
    """Return the surface area [m^2]."""
    return float(0.5 * np.linalg.norm(face_crosses(mesh), axis=1).sum())


def face_crosses(mesh: TriangleMesh) -> Array:
    """Return the outward face normals (F, 3), twice the face's area long [m^2]."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return np.cross(b - a, c - a)


def is_closed(mesh: TriangleMesh) -> bool:
    """Tell whether every edge is shared by faces that run along it in opposite directions."""
    forth = mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    back = forth[:, ::-1]
    return np.array_equal(forth[np.lexsort(forth.T)], back[np.lexsort(back.T)])


def centre_of_mass(mesh: TriangleMesh) -> Array:
    """Return the centre of the enclosed volume (3,) [m], or of the surface where it encloses none.

    Volume: the sum of the tetrahedra between each face and one point (the divergence theorem).
    """
    corners = mesh.vertices[mesh.faces] - mesh.centre
    if is_closed(mesh):
        six_volumes = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
        if six_volumes.sum() > 0.0:
            return mesh.centre + six_volumes @ corners.sum(axis=1) / (4.0 * six_volumes.sum())
    weights = np.linalg.norm(face_crosses(mesh), axis=1)
    return mesh.centre + weights @ corners.mean(axis=1) / weights.sum()


class Measured(NamedTuple):
    """A cloud that was made ready."""

    surface: SurfacePoints
    noise: float
    """Root mean square distance of the points from the planes through their neighbourhoods, median [m]."""


def measured_surface(cloud: PointCloud, spacing: float, name: str, viewpoint: Array | None = None) -> Measured:
    """Return the surface that a cloud shows.

    One point for each cube of ``spacing`` [m], moved onto the plane through its neighbours, which takes most of
    the noise; flying pixels are dropped. Normals are the planes'; they point to the side that given normals
    point to, else to ``viewpoint`` (3,) for points that were seen, else to where fewer other points are.

    Raises:
        InvalidValue: too few points.
    """
    from scipy.spatial import cKDTree

    if len(cloud) < FEWEST:
        raise InvalidValue(f"points of {name}", len(cloud), f"at least {FEWEST}")
    points, hints = _thinned(cloud, spacing, viewpoint)
    tree = cKDTree(points)
    count = min(_NEIGHBOURS, len(points))
    distance, index = tree.query(points, k=count, distance_upper_bound=_AROUND * spacing)
    near = np.isfinite(distance)
    # The two sides of a thin wall must not be taken for one surface.
    near &= np.einsum("ni,nki->nk", hints, hints[np.where(near, index, 0)]) >= 0.0
    firm = near.sum(axis=1) >= min(_LONELY, count)
    if firm.sum() < FEWEST:
        raise InvalidValue(f"connected points of {name}", int(firm.sum()), f"at least {FEWEST}, {spacing} m apart")
    centre, normals, rough = _planes(points, index, near)
    areas = _areas(tree, points, spacing)
    flat = points - np.einsum("ni,ni->n", points - centre, normals)[:, None] * normals
    flat, normals, areas, hints = flat[firm], normals[firm], areas[firm], hints[firm]
    normals = _outward(flat, normals, hints, spacing)
    order = np.random.default_rng(0).permutation(len(flat))  # every n-th point then is a fair sample
    surface = SurfacePoints(flat[order], normals[order], areas[order])
    return Measured(surface, float(min(np.median(rough[firm]), MOST_NOISE)))


def with_normals(cloud: PointCloud, spacing: float, name: str, viewpoint: Array | None = None) -> PointCloud:
    """Return the cloud with normals, its own where it has some, else those of `measured_surface`."""
    from scipy.spatial import cKDTree

    if cloud.normals is not None:
        return cloud
    surface = measured_surface(cloud, spacing, name, viewpoint).surface
    _, nearest = cKDTree(surface.points).query(cloud.points)
    return PointCloud(cloud.points, surface.normals[nearest], cloud.seen)


def _thinned(cloud: PointCloud, spacing: float, viewpoint: Array | None) -> tuple[Array, Array]:
    """Return the mean point of each cube, and the mean direction that its outward normal should be near (0: any)."""
    hints = np.zeros((len(cloud), 3))
    if cloud.normals is not None:
        hints = cloud.normals
    elif viewpoint is not None:
        seen = cloud.seen_mask
        towards = viewpoint - cloud.points[seen]
        hints[seen] = towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
    cubes = np.floor(cloud.points / spacing).astype(np.int64)
    _, cube, size = np.unique(cubes, axis=0, return_inverse=True, return_counts=True)
    cube = cube.reshape(-1)

    def mean(values: Array) -> Array:
        return np.stack([np.bincount(cube, column) for column in values.T], axis=-1) / size[:, None]

    return mean(cloud.points), mean(hints)


def _planes(points: Array, index: np.ndarray, near: np.ndarray) -> tuple[Array, Array, Array]:
    """Return centre (N, 3), unit normal (N, 3) and roughness (N,) [m] of the plane around each point."""
    neighbours = points[np.where(near, index, 0)]
    weight = near / near.sum(axis=1, keepdims=True)
    centre = np.einsum("nk,nki->ni", weight, neighbours)
    offset = neighbours - centre[:, None]
    spread, axes = np.linalg.eigh(np.einsum("nk,nki,nkj->nij", weight, offset, offset))
    return centre, axes[:, :, 0], np.sqrt(np.maximum(spread[:, 0], 0.0))


def _areas(tree: cKDTree, points: Array, spacing: float) -> Array:
    """Return the area (N,) [m^2] that each point stands for: its share of a disc that holds its neighbours."""
    count = min(_SPREAD + 1, len(points))
    distance, _ = tree.query(points, k=count)
    # The last neighbour lies on the rim and is half inside.
    return np.pi * np.minimum(distance[:, -1], _AROUND * spacing) ** 2 / (count - 0.5)


def _outward(points: Array, normals: Array, hints: Array, spacing: float) -> Array:
    """Return the normals, each turned to the side that its hint or else its surroundings say."""
    side = np.einsum("ni,ni->n", normals, hints)
    unknown = np.abs(side) < 0.05
    if unknown.any():
        guess = _emptier_side(points, normals[unknown], points[unknown], spacing)
        side[unknown] = guess
    return normals * np.where(side < 0.0, -1.0, 1.0)[:, None]


def _emptier_side(points: Array, normals: Array, starts: Array, spacing: float) -> Array:
    """Return numbers (N,) that are positive where fewer points lie ahead along the normal than behind."""
    outwards = np.einsum("ni,ni->n", normals, starts - points.mean(axis=0)) * 1e-3
    for i in range(0, len(starts), 256):
        offset = points[None] - starts[i : i + 256, None]
        along = np.einsum("nki,ni->nk", offset, normals[i : i + 256])
        beside = np.einsum("nki,nki->nk", offset, offset) - along**2 < (_TUBE * spacing) ** 2
        far = beside & (np.abs(along) > 2.0 * spacing) & (np.abs(along) < _FAR)
        outwards[i : i + 256] += np.sum(far & (along < 0.0), axis=1) - np.sum(far & (along > 0.0), axis=1)
    return outwards
