"""Depth images drawn here, triangle by triangle, so that registration is tested without the simulator."""

import numpy as np

from optsc.geometry import DepthImage, PinholeCamera, PointCloud, Pose, look_at
from optsc.perception import Segment

CAMERA = PinholeCamera.from_field_of_view(320, 240, 0.5)
X_WC = look_at([0.55, 0.15, 0.55], [0.0, 0.0, 0.05])
TABLE_HALF = 0.6


def drawn(objects, X_WC=X_WC, camera=CAMERA, noise=0.0, seed=0):
    """Depth image of objects, (mesh, X_WO) each, on the table z = 0, and the number of the object in each pixel."""
    table = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * TABLE_HALF
    depth, owner = _table(table, X_WC, camera)
    X_CW = X_WC.inverse()
    for number, (mesh, X_WO) in enumerate(objects):
        corners = (X_CW @ X_WO).apply(mesh.vertices)[mesh.faces]
        for triangle in corners:
            _draw(triangle, camera, depth, owner, number)
    rng = np.random.default_rng(seed)
    if noise:
        depth = depth + noise * rng.standard_normal(depth.shape)
    return DepthImage(np.where(np.isfinite(depth), depth, np.nan), camera, X_WC), owner


def segment_of(image, owner, number=0, lowest=0.006):
    """The pixels of one object as a perfect segmentation would give them."""
    points = image.points()
    mask = (owner == number) & image.measured & (points[..., 2] > lowest)
    return Segment(PointCloud(points[mask]), mask, False)


def upright(yaw=0.0, x=0.0, y=0.0):
    return Pose.from_rotation_vector([0.0, 0.0, yaw], [x, y, 0.0])


def _table(corners, X_WC, camera):
    rays = camera.rays() @ X_WC.rotation_matrix().T
    with np.errstate(divide="ignore"):
        depth = -X_WC.translation[2] / rays[..., 2]
    hit = (depth > 0) & np.all(np.abs(X_WC.translation[:2] + depth[..., None] * rays[..., :2]) < TABLE_HALF, axis=-1)
    return np.where(hit, depth, np.inf), np.full(depth.shape, -1)


def _draw(triangle, camera, depth, owner, number):
    u, v, z = camera.project(triangle)
    if not (z > 0.05).all():
        return
    low = np.maximum(np.ceil([u.min(), v.min()]).astype(int), 0)
    high = np.minimum(np.floor([u.max(), v.max()]).astype(int), [camera.width - 1, camera.height - 1])
    if (low > high).any():
        return
    area = (u[1] - u[0]) * (v[2] - v[0]) - (u[2] - u[0]) * (v[1] - v[0])
    if abs(area) < 1e-9:
        return
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    a = ((u[1] - x) * (v[2] - y) - (u[2] - x) * (v[1] - y)) / area
    b = ((u[2] - x) * (v[0] - y) - (u[0] - x) * (v[2] - y)) / area
    c = 1.0 - a - b
    inside = (a >= -1e-9) & (b >= -1e-9) & (c >= -1e-9)
    with np.errstate(divide="ignore"):
        d = 1.0 / (a / z[0] + b / z[1] + c / z[2])  # 1/z is what is linear in the image
    rows, columns = slice(low[1], high[1] + 1), slice(low[0], high[0] + 1)
    nearer = inside & (d > 0) & (d < depth[rows, columns])
    depth[rows, columns] = np.where(nearer, d, depth[rows, columns])
    owner[rows, columns] = np.where(nearer, number, owner[rows, columns])
