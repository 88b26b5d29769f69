"""The figure of a scene state is drawn of whatever is known."""

import numpy as np
import pytest

from optsc.geometry import DepthImage, PinholeCamera, PointCloud, Pose
from optsc.grasps import GraspLibrary, GraspSet
from optsc.perception import Explanation, KnownObject, SceneState
from optsc.viewers.drawing import save_figure
from optsc.viewers.figure_scene_state import scene_state_figure

CAMERA = PinholeCamera.from_field_of_view(80, 60, 0.8)
PIXELS = np.zeros((60, 80), dtype=bool)
PIXELS[20:40, 30:50] = True
IMAGE = DepthImage(np.where(PIXELS, 0.8, 1.0), CAMERA, Pose.from_rotation_vector([np.pi, 0, 0], [0.5, 0, 1.0]))


def state(explanations=2):
    rng = np.random.default_rng(0)
    X_WO = Pose.from_translation([0.5, 0.0, 0.0])
    points = rng.uniform(-0.05, 0.05, (50, 3)) + [0.0, 0.0, 0.1]
    cloud = PointCloud(points, None, points[:, 2] > 0.1)
    explained = (Explanation("mug", X_WO),) * explanations
    known = KnownObject("mug", "mug", X_WO, explained, cloud, points[:5] + 0.1, IMAGE, PIXELS, (), 0.0)
    grasps = GraspSet(
        "mug",
        "x",
        "panda_hand",
        Pose.stack([Pose.identity()] * 3),
        np.full(3, 0.04),
        np.linspace(0, 1, 3),
        {},
    )
    return SceneState({"mug": known}, GraspLibrary({"mug": grasps}))


def words(figure):
    found = [t.get_text() for axes in figure.axes for t in axes.texts]
    return found + [axes.get_title() for axes in figure.axes]


@pytest.mark.parametrize(("explanations", "label"), [(1, "mug"), (2, "mug (2 poses)")])
def test_the_picture_names_the_objects_and_counts_the_grasps(explanations, label, tmp_path):
    figure = scene_state_figure(state(explanations), IMAGE)
    assert label in words(figure)
    assert "3 grasps, coloured by quality" in words(figure)
    assert save_figure(figure, tmp_path / "seen.png").stat().st_size > 10_000


def test_an_empty_scene_is_drawn_too(tmp_path):
    figure = scene_state_figure(SceneState(), IMAGE)
    assert "0 grasps, coloured by quality" in words(figure)
    unmeasured = DepthImage(np.full((60, 80), np.nan), CAMERA, IMAGE.X_WC)
    save_figure(scene_state_figure(SceneState(), unmeasured), tmp_path / "seen.png")
