import subprocess
import sys

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import Pose, TriangleMesh
from optsc.viewers import shapes
from optsc.viewers.drawing import save_figure
from optsc.viewers.figure_approach import (
    BASELINE_COLOUR,
    PROPOSED_COLOUR,
    SelectedGrasps,
    StrategyPath,
    approach_figure,
)

# Corner c of a cube has its upper coordinate along x, y, z where bit 2, 1, 0 of c is set.
CORNERS = [[x, y, z] for x in (-0.03, 0.03) for y in (-0.03, 0.03) for z in (0.0, 0.1)]
LEFT_RIGHT = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5]]
FRONT_BACK = [[0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6]]
DOWN_UP = [[0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
CUBE = TriangleMesh(CORNERS, [*LEFT_RIGHT, *FRONT_BACK, *DOWN_UP])
OBJECTS = {
    "box": (CUBE, Pose.from_translation([0.5, 0.1, 0.0])),
    "crate": (CUBE, Pose.from_rotation_vector([0.0, 0.0, 0.7], [0.45, -0.15, 0.0])),
}
BOXES = np.array([[[-0.03, -0.1, -0.13], [0.03, 0.1, -0.04]], [[-0.01, 0.04, -0.04], [0.01, 0.06, 0.01]]])
DOWN = [0.0, 1.0, 0.0, 0.0]
X_WG = Pose.from_quaternion(DOWN, [0.5, 0.1, 0.07])
SELECTION = SelectedGrasps("pose 1", Pose.from_quaternion(DOWN, [0.4, 0.0, 0.25]), {"box": X_WG})


def strategy_path(bend, colour=PROPOSED_COLOUR, label="proposed", marker=X_WG):
    s = np.linspace(0.0, 1.0, 50)
    p = np.column_stack([0.35 + 0.15 * s, 0.1 * s, 0.4 - 0.33 * s + bend * np.sin(np.pi * s)])
    return StrategyPath(label, p, s > 0.395, colour, marker)


PATHS = [strategy_path(0.0), strategy_path(0.08, BASELINE_COLOUR, "manipulability only", None)]


@pytest.fixture(scope="module")
def figure():
    return approach_figure(OBJECTS, BOXES, [SELECTION], PATHS, title="a title")


def drawn(axes, colour, style):
    return [line for line in axes.lines if line.get_color() == colour and (line.get_linestyle() == "-") == style]


def test_one_panel_for_each_selection_and_two_views_of_the_paths(figure):
    assert [axes.name for axes in figure.axes] == ["3d", "rectilinear", "rectilinear"]
    two = approach_figure(OBJECTS, BOXES, [SELECTION, SELECTION], PATHS)
    assert [axes.name for axes in two.axes] == ["3d", "3d", "rectilinear", "rectilinear"]


def test_the_views_carry_the_paths_that_were_given_manual_dashed_and_automatic_solid(figure):
    views = {axes.get_ylabel(): axes for axes in figure.axes[1:]}
    for path in PATHS:
        for j, label in ((1, "y [m]"), (2, "z [m]")):
            (manual,) = [x for x in drawn(views[label], path.colour, False) if len(x.get_xdata()) > 1]
            (automatic,) = [x for x in drawn(views[label], path.colour, True) if len(x.get_xdata()) > 1]
            both = np.concatenate([manual.get_xydata(), automatic.get_xydata()[1:]])
            np.testing.assert_array_equal(both, path.p[:, [0, j]])
            assert len(manual.get_xdata()) == np.count_nonzero(~path.automatic)


def test_both_views_have_equal_axes_of_one_scale(figure):
    figure.canvas.draw()
    scales = []
    for axes in figure.axes[1:]:
        origin, unit = axes.transData.transform([[0.0, 0.0], [0.1, 0.1]])
        scales += list(unit - origin)
    np.testing.assert_allclose(scales, scales[0], rtol=1e-6)
    assert figure.axes[1].get_xlim() == figure.axes[2].get_xlim()


def test_everything_automatic_is_within_the_frame(figure):
    for axes in figure.axes[1:]:
        j = 1 if axes.get_ylabel() == "y [m]" else 2
        for path in PATHS:
            low, high = axes.viewLim.min, axes.viewLim.max
            shown = path.p[path.automatic][:, [0, j]]
            assert np.all((shown > low) & (shown < high))


def test_the_legend_names_each_strategy_with_the_length_of_its_path(figure):
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    for path in PATHS:
        length = np.sum(np.linalg.norm(np.diff(path.p[19:], axis=0), axis=1))
        assert f"{path.label}: {length:.2f} m automatic" in texts


def test_the_scene_has_a_marker_for_each_selected_grasp():
    def facets(grasps):
        figure = approach_figure(OBJECTS, BOXES, [SelectedGrasps("", SELECTION.X_WT, grasps)], PATHS)
        figure.canvas.draw()
        return max(len(collection.get_facecolor()) for collection in figure.axes[0].collections)

    assert facets({}) < facets({"box": X_WG}) < facets({"box": X_WG, "crate": X_WG})


def test_pieces_join_and_add_up_to_the_whole_path():
    p = np.arange(30.0).reshape(10, 3)
    path = StrategyPath("", p, [0, 0, 1, 1, 1, 0, 1, 1, 1, 1])
    pieces = path.pieces()
    assert [automatic for automatic, _ in pieces] == [False, True, False, True]
    np.testing.assert_array_equal(np.concatenate([pieces[0][1]] + [q[1:] for _, q in pieces[1:]]), p)
    assert path.automatic_length() == pytest.approx(7 * np.sqrt(27.0))
    np.testing.assert_array_equal(path.hand_overs(), p[[1, 5]])


@pytest.mark.parametrize("suffix", [".png", ".pdf", ".svg"])
def test_the_same_picture_is_saved_as_the_same_bytes(tmp_path, suffix):
    first, second = (
        save_figure(approach_figure(OBJECTS, BOXES, [SELECTION], PATHS), tmp_path / f"{name}{suffix}").read_bytes()
        for name in "ab"
    )
    assert first == second
    assert len(first) > 10_000


def test_a_suffix_that_is_no_picture_is_refused(figure, tmp_path):
    with pytest.raises(InvalidValue, match="png"):
        save_figure(figure, tmp_path / "picture.txt")


def test_drawing_needs_neither_a_display_nor_the_global_figure_state(tmp_path):
    code = (
        "import sys, numpy as np\n"
        "from optsc.geometry import Pose, TriangleMesh\n"
        "from optsc.viewers.drawing import save_figure\n"
        "from optsc.viewers.figure_approach import SelectedGrasps, StrategyPath, approach_figure\n"
        "assert 'matplotlib' not in sys.modules\n"
        "mesh = TriangleMesh([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], [[0, 2, 1], [0, 1, 3]])\n"
        "scene = {'corner': (mesh, Pose.identity())}\n"
        "selections = [SelectedGrasps('', Pose.identity(), {})]\n"
        "path = StrategyPath('a', np.zeros((2, 3)) + [[0], [1]], [False, True])\n"
        "figure = approach_figure(scene, np.zeros((0, 2, 3)), selections, [path])\n"
        f"save_figure(figure, {str(tmp_path / 'a.png')!r})\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    environment = {"PYTHONPATH": ":".join(sys.path), "HOME": str(tmp_path), "PATH": ""}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "a.png").stat().st_size > 1000


def test_what_cannot_be_drawn_is_refused():
    with pytest.raises(InvalidValue, match="at least one"):
        approach_figure(OBJECTS, BOXES, [], PATHS)
    with pytest.raises(InvalidValue, match="box, crate"):
        approach_figure(OBJECTS, BOXES, [SelectedGrasps("", X_WG, {"can": X_WG})], PATHS)
    with pytest.raises(InvalidValue, match="modes"):
        StrategyPath("a", np.zeros((5, 3)), np.zeros(4))
    with pytest.raises(InvalidValue, match="path 'a'"):
        StrategyPath("a", np.full((5, 3), np.nan), np.zeros(5))


def test_a_box_is_closed_and_seen_from_outside():
    triangles = shapes.box_triangles(np.array([[[1.0, 2.0, 3.0], [2.0, 4.0, 6.0]]]), Pose.identity())
    outward = np.sum(shapes.normals(triangles) * (triangles.mean(axis=1) - [1.5, 3.0, 4.5]), axis=1)
    assert np.all(outward > 0.0)
    volume = np.sum(np.linalg.det(triangles)) / 6.0
    assert volume == pytest.approx(6.0)


def test_cutting_triangles_small_keeps_the_surface():
    triangles = shapes.mesh_triangles(CUBE, Pose.identity())
    small = shapes.refined(triangles, 0.02)

    def area(faces):
        return 0.5 * np.linalg.norm(np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]), axis=1).sum()

    assert np.linalg.norm(np.roll(small, 1, axis=1) - small, axis=2).max() <= 0.02
    assert area(small) == pytest.approx(area(triangles))
    np.testing.assert_allclose(np.linalg.det(small).sum(), np.linalg.det(triangles).sum())
