import math

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import rotation
from optsc.metrics import path_length, rotation_path, straightness


def test_a_broken_line_is_as_long_as_its_pieces():
    assert path_length([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [3.0, 4.0, 2.0]]) == pytest.approx(7.0)


def test_length_does_not_depend_on_the_frame_it_is_measured_in():
    rng = np.random.default_rng(0)
    p, q = rng.normal(size=(50, 3)), rotation.random(rng)
    assert path_length(np.array([1.0, 2.0, 3.0]) + rotation.rotate(q, p)) == pytest.approx(path_length(p))


def test_joint_space_has_as_many_axes_as_joints():
    assert path_length(np.eye(7)) == pytest.approx(6 * math.sqrt(2))


def test_turning_there_and_back_adds_up():
    angles = np.array([0.0, 1.0, 2.5, 2.0])
    assert rotation_path(rotation.exp(angles[:, None] * [0.0, 0.6, 0.8])) == pytest.approx(3.0)


def test_the_sign_of_a_quaternion_is_no_rotation():
    q = rotation.random(np.random.default_rng(1), (20,))
    assert rotation_path(np.repeat(q, 2, axis=0) * np.tile([[1.0], [-1.0]], (20, 1))) == pytest.approx(rotation_path(q))


def test_straightness_is_one_on_a_line_and_zero_on_a_round_trip():
    line = np.outer(np.linspace(0, 1, 20) ** 2, [1.0, 2.0, 3.0])
    assert straightness(line) == pytest.approx(1.0)
    assert straightness(np.concatenate([line, line[::-1]])) == 0.0
    angle = np.linspace(0, np.pi, 2001)
    half_circle = np.column_stack([np.cos(angle), np.sin(angle)])
    assert straightness(half_circle) == pytest.approx(2 / np.pi, rel=1e-6)


@pytest.mark.parametrize("count", [0, 1])
def test_no_way_has_no_length_and_no_straightness(count):
    assert path_length(np.ones((count, 3))) == 0.0
    assert rotation_path(np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))) == 0.0
    assert math.isnan(straightness(np.ones((count, 3))))
    assert math.isnan(straightness(np.ones((5, 3))))


@pytest.mark.parametrize("measure", [path_length, straightness, rotation_path])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_number_that_is_none_is_refused_with_its_row(measure, bad):
    values = np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
    values[2, 1] = bad
    with pytest.raises(InvalidValue, match="row 2"):
        measure(values)


def test_a_wrong_shape_is_refused():
    with pytest.raises(InvalidValue):
        path_length(np.zeros(4))
    with pytest.raises(InvalidValue):
        rotation_path(np.zeros((5, 3)))
    with pytest.raises(InvalidValue):
        rotation_path(np.ones((5, 4)))
