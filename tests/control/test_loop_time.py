"""Time of the loop: what it says is believed, what cannot be is refused, and what is lost is counted."""

import math

import numpy as np
import pytest

from optsc.control.loop_time import LATE, LoopTime
from optsc.control.servo import Servo
from optsc.control.status import Status
from optsc.geometry import Pose
from optsc.robot import load_robot

PERIOD = 0.002


def told(times, loop=None, ticks=0):
    """Return the loop's time after ticks that began at ``times``, and the time of each."""
    loop, seen = loop or LoopTime(), []
    for now in times:
        loop = loop.begun(ticks, PERIOD, now)
        seen.append(loop.time(ticks, PERIOD))
        ticks += 1
    return loop, seen


def test_a_loop_that_says_nothing_is_counted_in_ticks():
    loop, seen = told([None] * 500)
    assert loop == LoopTime()
    assert seen == [k * PERIOD for k in range(500)]


@pytest.mark.parametrize("origin", [0.0, 1.7e9, -35.0])
def test_the_origin_of_the_clock_does_not_matter(origin):
    loop, seen = told([origin + k * PERIOD for k in range(100)])
    np.testing.assert_allclose(seen, [k * PERIOD for k in range(100)], atol=1e-6)
    assert loop.lateness == ""


def test_what_the_loop_says_takes_over_in_the_middle_of_a_run():
    loop, seen = told([None] * 10 + [7.0, 7.002, 7.104] + [None] * 2)
    np.testing.assert_allclose(seen[10:], [0.02, 0.022, 0.124, 0.126, 0.128], atol=1e-12)
    assert loop.missing == pytest.approx(0.1)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, "noon", None, [1.0, 2.0], 5.0, 4.0, -1e6])
def test_a_time_that_cannot_be_counts_as_one_period_and_the_clock_goes_on_from_there(bad):
    loop, seen = told([5.0, bad, 5.004 if bad not in (5.0, 4.0, -1e6) else bad + 0.002])
    np.testing.assert_allclose(seen, [0.0, 0.002, 0.004], atol=1e-9)
    assert loop.refused == (bad is not None)


@pytest.mark.parametrize("stuck", [0.0, 5.0])
def test_a_clock_that_stands_still_does_not_stop_the_time(stuck):
    loop, seen = told([stuck] * 100)
    np.testing.assert_allclose(seen, [k * PERIOD for k in range(100)], atol=1e-12)
    assert loop.refused == 99


@pytest.mark.parametrize(("slower", "late"), [(1.0, False), (1.01, False), (1.03, True), (1.3, True), (0.9, False)])
def test_a_loop_is_late_where_it_is_slower_by_more_than_a_few_percent(slower, late):
    loop, _ = told([k * PERIOD * slower for k in range(2000)])
    assert bool(loop.lateness) == late
    assert loop.missing == pytest.approx(1999 * PERIOD * (slower - 1.0), abs=1e-9)


def test_one_stall_is_late_for_a_while_and_jitter_that_is_made_up_for_is_not():
    rng = np.random.default_rng(0)
    loop, _ = told([k * PERIOD + rng.uniform(0.0, 0.0019) for k in range(500)])
    assert not loop.lateness
    stalled, _ = told([k * PERIOD for k in range(100)] + [0.2 + 1.5 * LATE])
    assert stalled.lateness
    assert stalled.late == pytest.approx(1.5 * LATE)
    after, _ = told([0.2 + 1.5 * LATE + k * PERIOD for k in range(1, 500)], stalled, 101)
    assert not after.lateness
    assert after.late == pytest.approx(0.0, abs=1e-9)


def test_lateness_is_in_the_command_and_past_a_threshold_in_its_status():
    robot = load_robot("panda")
    servo = Servo(robot)
    target = servo.X_WT
    first = [servo.step(target, now=k * PERIOD) for k in range(20)]
    assert all(command.status is Status.FOLLOWING and command.late < 1e-12 for command in first)
    stalled = servo.step(target, now=0.04 + 0.03)
    assert stalled.status is Status.LATE
    assert "30 ms" in stalled.reason
    assert (stalled.late, stalled.missing) == pytest.approx((0.03, 0.03))
    assert np.abs(stalled.v).max() < 1e-6


def test_lateness_does_not_hide_what_else_holds_the_motion_back():
    servo = Servo(load_robot("panda"))
    home = servo.X_WT
    far = Pose(home.quaternion, home.translation + [2.0, 0.0, 0.0])
    seen = [servo.step(far, now=0.1 * k).status for k in range(1500)]
    assert Status.LATE in seen[:100]
    assert set(seen[-20:]) == {Status.UNREACHABLE}


@pytest.mark.parametrize("wrong", [4.0, -1e6, 7.0, 1e300])
def test_after_a_single_wrong_time_the_clock_is_what_it_was(wrong):
    loop, seen = told([5.0, 5.002, wrong, 5.006, 5.008])
    np.testing.assert_allclose(seen, [0.0, 0.002, 0.004, 0.006, 0.008], atol=1e-9)
    assert (loop.refused, loop.zero) == (1, 5.0)


def test_after_a_clock_that_stood_still_the_time_is_what_it_was():
    loop, seen = told([5.0, *[5.002] * 50, 5.102, 5.104])
    np.testing.assert_allclose(seen, 0.002 * np.arange(53), atol=1e-9)
    assert loop.zero == 5.0


def test_a_loop_that_stood_still_for_long_is_believed_when_its_next_time_goes_on_from_there():
    _, seen = told([5.0, 5.002, 8.002, 8.004, 8.006])
    np.testing.assert_allclose(seen, [0.0, 0.002, 0.004, 3.004, 3.006], atol=1e-9)
