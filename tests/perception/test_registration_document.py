"""What the second half of docs/perception.md says: its formulas, its numbers and its code."""

import re
from pathlib import Path

import numpy as np
import pytest
from perception_cases import drawn, segment_of, upright

from benchmarks.pose_errors import surface_distance, surface_tail
from optsc.geometry import PointCloud, Pose
from optsc.perception import RegistrationSettings, SearchSettings, catalogue_template, complete_cloud
from optsc.perception.pose_hypotheses import PoseHypotheses
from optsc.perception.refinement import normal_equations
from optsc.perception.scoring import fit, free_space

PAGE = (Path(__file__).parents[2] / "docs" / "perception.md").read_text()


def at(*poses):
    return PoseHypotheses.of(Pose.stack(poses))


def test_the_settings_are_those_of_the_page():
    search, settings = SearchSettings(), RegistrationSettings()
    for number, text in (
        (search.voxel, "cubes of 4 mm"),
        (search.tolerance, "τ = 5 mm"),
        (settings.through, "at least 8 mm behind"),
        (settings.largest_residual, "exceeds 2 mm"),
    ):
        assert f"{1e3 * number:g} mm" in text
        assert text in PAGE
    for number, text in (
        (search.yaw_angles, "24 yaw angles"),
        (search.rough, "best 100,"),
        (search.fine, "best 32,"),
        (search.free_rotations, "120 rotations"),
        (search.behind, "0.35 is abandoned"),
    ):
        assert str(number) in text
        assert re.sub(r"\s+", " ", text) in re.sub(r"\s+", " ", PAGE)
    assert f"{100 * settings.least_inliers:.0f} % of the seen points are on" in PAGE
    assert f"more than {100 * settings.largest_violations:.0f} % of it is seen through" in PAGE
    assert f"{settings.margin} + {settings.margin_of_few}/√" in PAGE
    assert search.method == "gicp"


def test_the_field_is_a_first_order_expansion_about_the_cells_centre():
    field = catalogue_template("can").field
    cell = np.array([4, 20, 17])
    centre, offset = field.corner + field.step * cell, np.array([0.001, -0.0012, 0.0005])
    d, g = field.distance[tuple(cell)], field.gradient[tuple(cell)]
    assert field.lookup(centre + offset)[0] == pytest.approx(d + g @ offset, abs=1e-6)
    assert field.step**2 / (8 * 0.03) == pytest.approx(0.04e-3, abs=5e-6)


def test_the_score_is_the_formula_of_the_page():
    box = catalogue_template("box")
    X_WO = upright(0.4)
    image, owner = drawn([(box.mesh, X_WO)], noise=1e-3)
    points, space = segment_of(image, owner).cloud.points, free_space(image)
    off = upright(0.45, 0.004, 0.012)
    found = fit(at(off), points, box, space, tolerance=0.005, table_height=0.0, count=len(box.points))
    d = box.field.lookup(off.inverse().apply(points))[0]
    through, seen = (int(mask.sum()) for mask in space.classify(off.apply(box.points)))
    assert through > 0
    expected = np.maximum(0.0, 1.0 - (d / 0.005) ** 2).mean() - through / (through + seen)
    assert found.score[0] == pytest.approx(expected, abs=1e-9)


def test_steps_weigh_points_as_the_page_says():
    box = catalogue_template("box")
    points = np.array([[0.029, 0.01, 0.06]])  # 3 mm in front of the side that faces x
    H, b = normal_equations(at(Pose.identity()), points, box.field, 0.012, np.zeros(3))
    w, row = (1 - (0.003 / 0.012) ** 2) ** 2, np.array([1.0, 0.0, 0.0, 0.0, 0.06, -0.01])
    np.testing.assert_allclose(H[0], w * np.outer(row, row), atol=1e-6)
    np.testing.assert_allclose(b[0], w * 0.003 * row, atol=1e-6)


def test_a_mugs_handle_shows_in_the_tail_alone():
    mug = catalogue_template("mug")
    for degrees, low in ((20.0, 0.8e-3), (90.0, 1.3e-3)):
        turned = upright(np.radians(degrees))
        assert low < surface_distance(mug, Pose.identity(), turned) < 1.5e-3
    assert surface_tail(mug, Pose.identity(), upright(0.5 * np.pi)) == pytest.approx(0.025, abs=0.002)


def test_filled_in_points_keep_the_distances_of_the_page():
    page = re.sub(r"\s+", " ", PAGE)
    assert "no seen point is within 4 mm" in page
    assert "over its mesh 2.5 mm apart" in page
    can = catalogue_template("can")
    one = PointCloud(can.points[:1], can.normals[:1])
    whole = complete_cloud(one, can, Pose.identity())
    added = whole.select(~whole.seen)
    d = np.linalg.norm(added.points - can.points[0], axis=1)
    turned = np.linalg.norm(added.normals - can.normals[0], axis=1)
    assert np.sqrt(d**2 + 0.5 * 0.004**2 * turned**2).min() > 0.004
    everywhere = complete_cloud(PointCloud(np.zeros((0, 3))), can, Pose.identity())
    area = len(can.points) * can.spacing**2
    assert np.sqrt(area / len(everywhere)) == pytest.approx(0.0025, rel=0.25)


def test_the_code_of_the_page_finds_what_is_there():
    (code,) = (b for b in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL) if "register_scene" in b)
    exec(code, scope := {})
    X_WO = scope["world"].X_WO[scope["result"].template]
    assert np.linalg.norm(scope["result"].X_WO.translation - X_WO.translation) < 0.005
    assert scope["cloud"].seen.any()
    assert not scope["cloud"].seen.all()
