"""Measures of whole motions, each against a value that was worked out in another way."""

import math

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import Pose
from optsc.metrics import (
    HandMotion,
    Motion,
    hand_velocity,
    interaction_measures,
    jump_measures,
    limit_margins,
    motion_measures,
    path_clearance,
    smoothness_measures,
    stretch_smoothness,
    worst_jumps,
)

RATE = 200.0


class Arm:
    """Two sliders along x and y, as far as the measures need an arm."""

    class limits:  # noqa: N801
        lower = np.array([-1.0, -2.0])
        upper = np.array([1.0, 2.0])
        velocity = np.array([0.5, 1.0])


def minimum_jerk(duration=1.0, length=0.4, rate=RATE):
    s = np.arange(round(duration * rate) + 1) / (duration * rate)
    return length * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def motion(x, modes=None, hand=None, y=None):
    q = np.column_stack([x, np.zeros_like(x) if y is None else y])
    v = np.gradient(q, axis=0) * RATE
    p = np.column_stack([q, np.zeros(len(q))])
    X_WT = Pose(np.tile([1.0, 0.0, 0.0, 0.0], (len(q), 1)), p)
    return Motion(RATE, 0.0, tuple(modes or ["approach"] * len(q)), q, v, 0 * v, X_WT, hand or HandMotion.none())


def test_lengths_times_and_margins_are_those_of_the_curve():
    row = motion_measures(motion(minimum_jerk(2.0)), Arm, lambda q: 0.3 - q[:, 0])
    assert row["path_length_m"] == pytest.approx(0.4)
    assert row["joint_path_rad"] == pytest.approx(0.4)
    assert row["rotation_rad"] == 0.0
    assert row["straightness"] == pytest.approx(1.0)
    assert row["duration_s"] == pytest.approx(401 / RATE)
    assert row["limit_margin_rad"] == pytest.approx(0.6)
    assert row["limit_margin_share"] == pytest.approx(0.6)
    # A minimum-jerk movement is fastest in its middle: 15/8 of length over duration.
    assert row["velocity_share"] == pytest.approx(1.875 * 0.4 / 2.0 / 0.5, rel=1e-3)
    assert row["clearance_m"] == pytest.approx(-0.1)
    assert row["mean_clearance_m"] == pytest.approx(0.1, abs=2e-3)


def test_smoothness_of_a_minimum_jerk_movement_is_the_published_value_in_tool_and_joints():
    row = smoothness_measures(motion(minimum_jerk()))
    # Sampled at 100 Hz: LDLJ -5.224 and SPARC -1.4058; the continuous values are -5.322 and about -1.40.
    for space in ("tool", "joint"):
        assert row[f"ldlj_{space}"] == pytest.approx(-5.22, abs=0.05)
        assert row[f"sparc_{space}"] == pytest.approx(-1.405, abs=0.01)
    assert math.isnan(row["ldlj_turn"])


@pytest.mark.parametrize("measure", [smoothness_measures, stretch_smoothness])
@pytest.mark.parametrize("rest", [0.5, 2.0, 5.0])
def test_a_rest_before_or_after_does_not_make_a_movement_less_smooth(measure, rest):
    x, still = minimum_jerk(), np.zeros(round(rest * RATE))
    bare, row = measure(motion(x)), measure(motion(np.concatenate([still, x, still + x[-1]])))
    for space in ("tool", "joint"):
        assert row[f"ldlj_{space}"] == pytest.approx(bare[f"ldlj_{space}"], abs=0.15)
        assert row[f"sparc_{space}"] == pytest.approx(bare[f"sparc_{space}"], abs=0.005)


def test_a_dwell_between_two_movements_counts_in_the_whole_and_not_in_the_stretches():
    x = minimum_jerk()
    dwelling = motion(np.concatenate([x, np.full(400, x[-1]), x[-1] + x]))
    assert smoothness_measures(dwelling)["ldlj_tool"] < -8.0
    row = stretch_smoothness(dwelling)
    assert row["ldlj_tool"] == pytest.approx(-5.22, abs=0.15)
    assert row["sparc_joint"] == pytest.approx(-1.405, abs=0.01)
    assert row["stretches"] == 2
    assert row["moving_s"] == pytest.approx(2.0, abs=0.05)


def test_stretches_are_weighed_by_how_long_they_take():
    slow, quick = minimum_jerk(3.0), minimum_jerk(1.0)
    wiggly = quick + 0.004 * np.sin(2 * np.pi * 6.0 * np.arange(len(quick)) / RATE)
    both = motion(np.concatenate([slow, np.full(200, slow[-1]), slow[-1] + wiggly]))
    one, other = (stretch_smoothness(motion(x))["ldlj_tool"] for x in (slow, wiggly))
    assert stretch_smoothness(both)["ldlj_tool"] == pytest.approx(0.75 * one + 0.25 * other, abs=0.15)


def test_a_short_tremble_does_not_spoil_what_the_robot_goes_on_with():
    slow = minimum_jerk(5.0)
    t = np.arange(len(slow)) / RATE
    trembling = slow + np.where(t < 1.2, 0.3e-3 * np.sin(2 * np.pi * 10.0 * t), 0.0)
    whole, cut = (stretch_smoothness(motion(trembling), cuts) for cuts in ((), (240,)))
    assert cut["stretches"] == whole["stretches"] + 1
    assert cut["moving_s"] == pytest.approx(whole["moving_s"])
    assert cut["ldlj_tool"] > whole["ldlj_tool"] + 3.0
    # A cut outside of every stretch, or one that leaves too little, changes nothing.
    assert stretch_smoothness(motion(slow), [0, len(slow) + 5])["ldlj_tool"] == pytest.approx(-5.31, abs=0.02)


def test_joints_that_go_on_moving_about_a_tool_at_rest_are_not_measured_then():
    x, still = minimum_jerk(), np.zeros(400)
    m = motion(np.concatenate([x, still + x[-1], x[-1] + x]))
    elbow = np.column_stack([m.q, 0.3 * np.arange(len(m)) / RATE])
    drifting = Motion(RATE, 0.0, m.modes, elbow, m.v, m.a, m.X_WT, m.hand)
    assert smoothness_measures(drifting)["ldlj_joint"] < -8.0
    assert stretch_smoothness(drifting)["ldlj_joint"] == pytest.approx(-5.0, abs=0.5)


def test_where_nothing_moves_there_is_no_smoothness_and_no_stretch():
    for still in (motion(np.zeros(100)), motion(np.zeros(100)).part(0, 1), motion(np.zeros(100)).part(0, 0)):
        row = stretch_smoothness(still)
        assert (row["stretches"], row["moving_s"]) == (0.0, 0.0)
        assert math.isnan(row["ldlj_tool"])
        assert math.isnan(smoothness_measures(still)["sparc_joint"])


def test_smoothness_does_not_depend_on_the_control_rate():
    def at(rate):
        m = motion(minimum_jerk(rate=rate))
        return smoothness_measures(Motion(rate, 0.0, m.modes, m.q, m.v, m.a, m.X_WT, m.hand))

    slow, fast = at(250.0), at(1000.0)
    assert slow["ldlj_tool"] == pytest.approx(fast["ldlj_tool"], abs=0.02)
    assert slow["sparc_joint"] == pytest.approx(fast["sparc_joint"], abs=0.002)


def test_a_bend_at_constant_speed_shows_in_the_vector_jerk():
    time = np.arange(401) / RATE
    straight = motion(0.1 * time)
    bend = motion(0.1 * np.minimum(time, 1.0), y=0.1 * np.maximum(time - 1.0, 0.0))
    assert smoothness_measures(bend)["ldlj_tool"] < smoothness_measures(straight)["ldlj_tool"] - 5.0


def test_signs_of_quaternions_do_not_count_as_turns():
    m = motion(minimum_jerk())
    angle = minimum_jerk(length=1.0) / 2.0
    q = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle, 0 * angle])
    flipped = q * np.where(np.arange(len(q)) % 3, 1.0, -1.0)[:, None]
    rows = [
        smoothness_measures(Motion(RATE, 0.0, m.modes, m.q, m.v, m.a, Pose(x, m.X_WT.translation), m.hand))
        for x in (q, flipped)
    ]
    assert rows[0]["ldlj_turn"] == pytest.approx(-5.22, abs=0.05)
    assert rows[1] == pytest.approx(rows[0])


def test_effort_is_the_way_of_the_hand_without_its_trembling():
    rng = np.random.default_rng(0)
    stamp = np.arange(3 * 90) / 90.0
    p = np.zeros((len(stamp), 3))
    p[:, 1] = np.interp(stamp, [0.0, 1.0, 2.0, 3.0], [0.0, 0.0, 0.3, 0.3])
    clean = interaction_measures(motion(np.zeros(600), hand=HandMotion(stamp, p)))
    noisy = interaction_measures(motion(np.zeros(600), hand=HandMotion(stamp, p + rng.normal(0.0, 0.3e-3, p.shape))))
    assert clean["effort_m"] == pytest.approx(0.3, rel=0.02)
    assert noisy["effort_m"] == pytest.approx(0.3, rel=0.03)
    # A third of the time, and 0.083 s about it: a line fitted over 0.25 s reaches 0.02 of 0.3 m/s that early.
    assert clean["intervention"] == pytest.approx(1 / 3 + 2 * 0.083 / 3.0, abs=0.004)
    # Neighbouring differences would have made ten times as much of it.
    assert np.linalg.norm(np.diff(rng.normal(0.0, 0.3e-3, p.shape), axis=0), axis=1).sum() > 0.15


def test_the_hand_s_velocity_is_that_of_a_parabola_exactly():
    stamp = np.arange(90) / 90.0
    p = np.column_stack([0.2 * stamp**2, 0.1 * stamp, 0 * stamp])
    v = hand_velocity(HandMotion(stamp, p))
    assert v[:, 0] == pytest.approx(0.4 * stamp, abs=1e-9)
    assert v[:, 1] == pytest.approx(0.1, abs=1e-9)
    assert hand_velocity(HandMotion.none()).shape == (0, 3)


def test_agreement_is_the_cosine_between_hand_and_tool_in_the_world():
    stamp = np.arange(180) / 90.0
    hand = HandMotion(stamp, np.column_stack([0 * stamp, 0.1 * stamp, 0 * stamp]))
    moving = motion(0.1 * np.arange(400) / RATE, hand=hand)
    assert interaction_measures(moving)["agreement"] == pytest.approx(0.0, abs=1e-9)
    quarter = [math.sqrt(0.5), 0.0, 0.0, -math.sqrt(0.5)]
    assert interaction_measures(moving, quarter)["agreement"] == pytest.approx(1.0)
    assert interaction_measures(moving, quarter)["disagreement"] == 0.0


def test_a_jump_at_the_switch_is_the_worst_of_the_motion():
    x = 0.1 * np.arange(400) / RATE
    x[200:] += 0.02
    modes = ["manual"] * 200 + ["approach"] * 200
    row = {**interaction_measures(motion(x, modes)), **worst_jumps(motion(x, modes))}
    assert row["jump_position_m"] == pytest.approx(0.02 + 0.1 / RATE)
    assert row["jump_velocity_m_s"] == pytest.approx(0.0, abs=1e-9)
    assert row["switches"] == 1
    assert row["time_manual_s"] == row["time_approach_s"] == pytest.approx(1.0)
    assert math.isnan(worst_jumps(motion(x))["jump_position_m"])
    assert jump_measures(motion(x, modes), 200)["jump_position_m"] == row["jump_position_m"]


def test_the_distance_to_the_target_is_that_at_the_first_tick_of_the_new_mode():
    x = 0.1 * np.arange(400) / RATE
    modes = ["manual"] * 150 + ["approach"] * 150 + ["close"] * 100
    here, there = (Pose.from_translation([x[i] + d, 0.0, 0.0]) for i, d in ((150, 0.3), (300, 0.01)))
    targets = [None] * 150 + [here] * 150 + [there] * 100
    m = motion(x, modes)
    assert worst_jumps(m, targets)["jump_target_distance_m"] == pytest.approx(0.3)
    assert worst_jumps(m, [None] * 200 + targets[200:])["jump_target_distance_m"] == pytest.approx(0.01)
    assert math.isnan(worst_jumps(m)["jump_target_chord"])
    with pytest.raises(InvalidValue, match="one for each tick"):
        worst_jumps(m, targets[1:])


def test_margins_count_the_nearest_joint_and_share_only_where_there_is_a_range():
    q = np.array([[0.0, 0.0], [0.9, 5.0]])
    found = limit_margins(q, [-1.0, -np.inf], [1.0, np.inf])
    assert found.least == pytest.approx(0.1)
    assert found.least_share == pytest.approx(0.1)
    assert found.mean_share == pytest.approx(0.55)
    assert limit_margins(np.zeros((0, 2)), [-1.0, -1.0], [1.0, 1.0]).least == math.inf
    assert limit_margins([[1.25, 0.0]], [-1.0, -1.0], [1.0, 1.0]).least == pytest.approx(-0.25)


def test_the_narrowest_place_is_found_with_its_time():
    q = np.linspace(0.0, 2.0, 401)[:, None]
    found = path_clearance(lambda rows: np.abs(rows[:, 0] - 1.5) + 0.02, q, RATE, every=0.02)
    assert found.least == pytest.approx(0.02, abs=1e-3)
    assert found.time == pytest.approx(1.5, abs=0.011)
    assert found.mean == pytest.approx(np.mean(np.abs(q[::4] - 1.5)) + 0.02, abs=1e-9)
    assert path_clearance(lambda rows: rows[:, 0], np.zeros((0, 1)), RATE).least == math.inf
    with pytest.raises(InvalidValue, match="one for each configuration"):
        path_clearance(lambda rows: rows, q, RATE)


def test_a_part_of_a_motion_has_its_own_ticks_and_hand_samples():
    stamp = np.arange(180) / 90.0
    hand = HandMotion(stamp, np.zeros((180, 3)))
    whole = motion(minimum_jerk(2.0), hand=hand)
    part = whole.part(100, 200)
    assert len(part) == 100
    assert part.time == pytest.approx(0.5)
    assert part.hand.stamp[0] == pytest.approx(0.5)
    assert part.hand.stamp[-1] < 1.0
    assert np.array_equal(part.q, whole.q[100:200])
    with pytest.raises(InvalidValue, match="equal"):
        Motion(RATE, 0.0, ("manual",), whole.q, whole.v, whole.a, whole.X_WT, hand)
