import math

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.metrics import limit_violations

LIMITS = {
    "lower": [-1.0, -2.0],
    "upper": [1.0, 2.0],
    "velocity": [1.0, 2.0],
    "acceleration": [10.0, 20.0],
    "jerk": [100.0, 200.0],
}
RATE = 100.0


def still(count=50):
    return tuple(np.zeros((count, 2)) for _ in range(3))


def test_on_a_limit_is_within_it():
    q, v, a = still()
    q[:25], q[25:] = LIMITS["lower"], LIMITS["upper"]
    v[:], a[:] = LIMITS["velocity"], LIMITS["acceleration"]
    found = limit_violations(RATE, q, v, a, **LIMITS)
    assert found.total == 0
    assert (found.position_margin, found.velocity_ratio, found.acceleration_ratio) == (0.0, 1.0, 1.0)
    assert found.jerk_ratio == 0.0


@pytest.mark.parametrize(("beyond", "counts"), [(0.5e-9, 0), (2e-9, 1)])
def test_rounding_is_forgiven_and_no_more(beyond, counts):
    q, v, a = still()
    q[3, 1], v[4, 0], a[5, 1] = -2.0 - beyond, -1.0 - beyond, 20.0 + beyond
    found = limit_violations(RATE, q, v, a, **{**LIMITS, "jerk": [1e9, 1e9]})
    assert (found.position, found.velocity, found.acceleration) == (counts, counts, counts)


def test_a_sample_counts_once_however_many_joints_are_beyond():
    q, v, a = still()
    v[10:13] = 5.0
    found = limit_violations(RATE, q, v, a, **LIMITS)
    assert found.velocity == found.total == 3
    assert found.velocity_ratio == 5.0


def test_jerk_is_the_change_of_acceleration_in_one_sample():
    q, v, a = still()
    a[20:] = [1.1, -2.3]
    found = limit_violations(RATE, q, v, a, **LIMITS)
    assert found.jerk == found.total == 1
    assert found.jerk_ratio == pytest.approx(1.15)


def test_how_far_beyond_a_position_limit_is_a_negative_margin():
    q, v, a = still()
    q[7, 0] = 1.25
    found = limit_violations(RATE, q, v, a, **LIMITS)
    assert found.position == 1
    assert found.position_margin == pytest.approx(-0.25)


def test_a_limit_may_be_infinite():
    q, v, a = still()
    v[:] = 1e6
    found = limit_violations(RATE, q, v, a, **{**LIMITS, "velocity": [math.inf, math.inf]})
    assert found.total == 0
    assert found.velocity_ratio == 0.0


def test_no_samples_have_no_violations():
    found = limit_violations(RATE, *still(0), **LIMITS)
    assert found.total == 0
    assert found.position_margin == math.inf
    assert limit_violations(RATE, *still(1), **LIMITS).jerk == 0


def test_numbers_that_are_none_and_shapes_that_do_not_fit_are_refused():
    q, v, a = still()
    with pytest.raises(InvalidValue, match="one shape"):
        limit_violations(RATE, q, v, a[:-1], **LIMITS)
    with pytest.raises(InvalidValue, match="jerk limits"):
        limit_violations(RATE, q, v, a, **{**LIMITS, "jerk": [1.0, 0.0]})
    with pytest.raises(InvalidValue, match="upper limits"):
        limit_violations(RATE, q, v, a, **{**LIMITS, "upper": [1.0]})
    v[8, 0] = np.nan
    with pytest.raises(InvalidValue, match="row 8"):
        limit_violations(RATE, q, v, a, **LIMITS)
