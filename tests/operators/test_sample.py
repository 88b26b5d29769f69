import math

import numpy as np
import pytest

from optsc.geometry import Pose
from optsc.operators.sample import DEVICE_UNIT_TOLERANCE, POSITION_RANGE, OperatorSample, fault_of

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
PLACE = np.array([0.3, -0.2, 1.1])


def sample(stamp=1.0, quaternion=UPRIGHT, position=PLACE):
    return OperatorSample(stamp, Pose(np.asarray(quaternion, dtype=float), np.asarray(position, dtype=float)))


def test_a_sound_sample_has_no_fault():
    assert fault_of(sample(), None) is None
    assert fault_of(sample(stamp=1.0), 0.5) is None
    assert fault_of(sample(quaternion=-UPRIGHT), 0.5) is None


def test_a_tracker_that_stands_still_is_no_fault():
    assert fault_of(sample(stamp=1.0), 1.0) is None


def test_a_sample_starts_coupled_and_with_the_trigger_released():
    assert sample().clutch is True
    assert sample().trigger is False


@pytest.mark.parametrize("stamp", [math.nan, math.inf, -math.inf])
def test_a_stamp_that_is_no_time_is_named(stamp):
    assert "stamp" in fault_of(sample(stamp=stamp), None)


def test_a_stamp_before_the_previous_one_is_named_with_both_times():
    fault = fault_of(sample(stamp=1.0), 1.000001)
    assert "1.000000" in fault
    assert "1.000001" in fault


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300, 2 * POSITION_RANGE])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_position_that_is_no_place_is_named(bad, axis):
    position = PLACE.copy()
    position[axis] = bad
    assert "position" in fault_of(sample(position=position), None)


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e300, 0.0])
def test_an_orientation_that_is_none_is_named(bad):
    assert "quaternion" in fault_of(sample(quaternion=[bad, 0.0, 0.0, 0.0]), None)


@pytest.mark.parametrize(
    ("norm", "good"), [(1 + 0.9 * DEVICE_UNIT_TOLERANCE, True), (1 + 1.1 * DEVICE_UNIT_TOLERANCE, False)]
)
def test_the_norm_of_a_quaternion_is_held_to_the_tolerance(norm, good):
    assert (fault_of(sample(quaternion=[0.0, norm, 0.0, 0.0]), None) is None) == good
    assert (fault_of(sample(quaternion=[0.0, 2 - norm, 0.0, 0.0]), None) is None) == good


def test_a_batch_of_poses_is_no_hand():
    fault = fault_of(OperatorSample(0.0, Pose.identity((3,))), None)
    assert "batch" in fault
