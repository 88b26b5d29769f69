import math

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.metrics import agreement, intervention_ratio, operator_effort, switch_count, time_in_mode


def test_the_times_in_all_modes_add_up_to_the_whole():
    mode = ["manual"] * 30 + ["automatic"] * 60 + ["manual"] * 10
    times = time_in_mode(mode, 50.0)
    assert times == {"manual": pytest.approx(0.8), "automatic": pytest.approx(1.2)}
    assert time_in_mode([], 50.0) == {}


def test_only_changes_of_mode_are_counted():
    assert switch_count(["manual", "manual", "automatic", "hold", "hold", "manual"]) == 3
    assert switch_count(["manual"]) == 0
    assert switch_count([]) == 0


def test_intervention_is_the_share_of_time_the_hand_moves():
    velocity = np.zeros((100, 3))
    velocity[20:45, 1] = -0.3
    velocity[50:, 0] = 0.01
    assert intervention_ratio(velocity, deadband=0.02) == pytest.approx(0.25)
    assert intervention_ratio(np.linalg.norm(velocity, axis=1), deadband=0.0) == pytest.approx(0.75)
    assert math.isnan(intervention_ratio([], deadband=0.0))


def test_effort_is_the_path_of_the_hand_at_any_rate():
    for rate in (50, 500):
        angle = np.arange(4 * rate) / rate
        circling = 0.2 * np.column_stack([-np.sin(angle), np.cos(angle), 0 * angle])
        assert operator_effort(circling, rate) == pytest.approx(0.8)
    assert operator_effort([], 50.0) == 0.0


def test_equal_wishes_agree_opposite_ones_disagree_and_crossing_ones_do_neither():
    u = np.random.default_rng(0).normal(size=(20, 3))
    assert agreement(u, 3.0 * u) == pytest.approx((1.0, 0.0, 1.0))
    assert agreement(u, -u) == pytest.approx((-1.0, 1.0, 1.0))
    across = np.cross(u, [1.0, 0.0, 0.0])
    assert agreement(u, across).agreement == pytest.approx(0.0, abs=1e-15)


def test_directions_are_compared_only_while_both_wish_to_move():
    u = np.tile([0.1, 0.0], (10, 1))
    w = np.zeros((10, 2))
    w[:4] = [0.2, 0.0]
    w[4] = [-0.2, 0.0]
    assert agreement(u, w) == pytest.approx((0.6, 0.2, 0.5))
    assert agreement(u, w, deadband=0.15).share == 0.0
    assert math.isnan(agreement(u, 0 * w).agreement)


def test_numbers_that_are_none_and_shapes_that_do_not_fit_are_refused():
    with pytest.raises(InvalidValue, match="row 1"):
        operator_effort([0.0, np.nan], 50.0)
    with pytest.raises(InvalidValue, match="deadband"):
        intervention_ratio([1.0], deadband=-1.0)
    with pytest.raises(InvalidValue, match="rate"):
        time_in_mode(["manual"], 0.0)
    with pytest.raises(InvalidValue, match="as the operator's"):
        agreement(np.zeros((3, 2)), np.zeros((4, 2)))
