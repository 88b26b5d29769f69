import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import PointCloud, Pose, rotation
from optsc.grasps import GraspSet
from optsc.viewers.drawing import save_figure
from optsc.viewers.figure_grasps import fork_lines, grasps_figure


def grasps(count, **change):
    rng = np.random.default_rng(0)
    X_OG = Pose(rotation.random(rng, (count,)), 0.05 * rng.normal(size=(count, 3)))
    return GraspSet("thing", "0", "panda_hand", X_OG, np.full(count, 0.04), np.linspace(0, 1, count), {}, **change)


def test_the_tines_of_a_fork_are_as_far_apart_as_the_opening_and_point_along_z():
    some = grasps(5)
    lines = fork_lines(some)
    assert np.allclose(np.linalg.norm(lines[:, 0] - lines[:, -1], axis=1), some.opening)
    tine = lines[:, 0] - lines[:, 1]
    z = some.X_OG.rotation_matrix()[:, :, 2]
    assert np.allclose(np.cross(tine, z), 0.0, atol=1e-9)
    assert np.all(np.einsum("ni,ni->n", tine, z) > 0.0)


def test_every_grasp_is_drawn_in_both_views_and_failed_ones_differ(tmp_path):
    held = np.array([True, False, True])
    cloud = PointCloud(np.random.default_rng(0).normal(size=(50, 3)), None, np.arange(50) % 2 > 0)
    figure = grasps_figure(grasps(3, tried=np.ones(3, dtype=bool), held=held), cloud)
    views = [axes for axes in figure.axes if hasattr(axes, "get_zlim")]
    assert [len(axes.lines) for axes in views] == [3, 3]
    assert [line.get_linestyle() for line in views[0].lines] == ["-", ":", "-"]
    assert "2 of 3 tried held" in figure.texts[0].get_text()
    first = save_figure(figure, tmp_path / "a.png").read_bytes()
    assert first == save_figure(figure, tmp_path / "b.png").read_bytes()


def test_nothing_to_draw_is_refused():
    with pytest.raises(InvalidValue, match="to draw"):
        grasps_figure(grasps(0))
