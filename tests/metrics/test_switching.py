import math

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.metrics import switch_jump

RATE = 100.0


def steady(count=200, velocity=(0.1, 0.0, 0.0), turn=(0.0, 0.0, 0.5)):
    t = np.arange(count) / RATE
    return t[:, None] * velocity, rotation.exp(t[:, None] * turn), np.outer(t, np.ones(7))


def test_steady_motion_has_no_jump_but_that_of_one_tick():
    p, r, q = steady()
    jump = switch_jump(100, RATE, Pose(r, p), q)
    assert jump.position_step == pytest.approx(0.1 / RATE)
    assert jump.rotation_step == pytest.approx(0.5 / RATE)
    assert jump.velocity_step == pytest.approx(0.0, abs=1e-12)
    assert jump.angular_velocity_step == pytest.approx(0.0, abs=1e-12)
    assert jump.peak_acceleration == pytest.approx(0.0, abs=1e-9)
    assert jump.joint_step == pytest.approx(1.0 / RATE)
    assert not jump.branch_flip


def test_a_step_of_the_pose_is_not_counted_as_one_of_the_velocity():
    p, r, q = steady()
    p[100:] += [0.0, 0.02, 0.0]
    r[100:] = rotation.multiply(rotation.exp([0.3, 0.0, 0.0]), r[100:])
    jump = switch_jump(100, RATE, Pose(r, p), q)
    assert jump.position_step == pytest.approx(math.hypot(0.02, 0.1 / RATE))
    assert jump.rotation_step == pytest.approx(0.3, abs=1e-2)
    assert jump.velocity_step == pytest.approx(0.0, abs=1e-12)
    assert jump.peak_acceleration == pytest.approx(0.02 * RATE**2)
    assert jump.peak_jerk == pytest.approx(2 * 0.02 * RATE**3, rel=1e-6)


def test_a_step_of_the_velocity_is_measured_in_size_and_direction():
    p, r, q = steady(turn=(0.0, 0.0, 0.0))
    t = np.arange(100) / RATE
    p[100:] = p[99] + (t + 1 / RATE)[:, None] * [0.0, 0.1, 0.0]
    r[100:] = rotation.exp((t + 1 / RATE)[:, None] * [0.7, 0.0, 0.0])
    jump = switch_jump(100, RATE, Pose(r, p), q)
    assert jump.velocity_step == pytest.approx(0.1 * math.sqrt(2))
    assert jump.angular_velocity_step == pytest.approx(0.7)


def test_peaks_outside_the_window_do_not_count():
    p, r, q = steady()
    p[160:] += [0.0, 0.02, 0.0]
    q[160:] += 1.0
    far = switch_jump(100, RATE, Pose(r, p), q, window=0.5)
    assert far.peak_acceleration == pytest.approx(0.0, abs=1e-9)
    assert not far.branch_flip
    near = switch_jump(100, RATE, Pose(r, p), q, window=0.7)
    assert near.peak_acceleration == pytest.approx(0.02 * RATE**2)
    assert near.branch_flip


def test_another_branch_of_the_inverse_kinematics_is_noticed():
    p, r, q = steady()
    q[100:, 3] -= 2.0
    jump = switch_jump(100, RATE, Pose(r, p), q)
    assert jump.branch_flip
    assert jump.joint_step == pytest.approx(2.0 - 1.0 / RATE)


def test_the_distance_to_the_target_is_the_papers():
    p, r, q = steady()
    target = Pose(rotation.multiply(r[100], rotation.exp([0.0, 1.0, 0.0])), p[100] + [0.0, 0.3, 0.4])
    jump = switch_jump(100, RATE, Pose(r, p), q, target)
    assert jump.target_distance == pytest.approx(0.5)
    assert jump.target_chord == pytest.approx(2 * math.sin(0.25))
    opposite = switch_jump(100, RATE, Pose(-r, p), q, target)
    assert opposite == pytest.approx(jump)
    assert math.isnan(switch_jump(100, RATE, Pose(r, p), q).target_distance)


@pytest.mark.parametrize("index", [-1, 0, 1, 199, 200])
def test_a_switch_too_near_an_end_is_refused(index):
    p, r, q = steady()
    with pytest.raises(InvalidValue, match="2 to 198"):
        switch_jump(index, RATE, Pose(r, p), q)


def test_numbers_that_are_none_and_shapes_that_do_not_fit_are_refused():
    p, r, q = steady()
    with pytest.raises(InvalidValue, match="one row for each"):
        switch_jump(100, RATE, Pose(r, p), q[:-1])
    q[3, 2] = np.nan
    with pytest.raises(InvalidValue, match="row 3"):
        switch_jump(100, RATE, Pose(r, p), q)
