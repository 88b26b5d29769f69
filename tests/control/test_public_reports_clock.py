"""Public reports of arms that moved, or did not stop, because of a clock, a late packet or a slow loop, in small."""

import numpy as np
import pytest

from optsc.control.servo import Servo
from optsc.control.status import Status
from optsc.geometry import Pose
from optsc.real_time import RealTime
from optsc.robot import load_robot

PERIOD = 0.002
SPEED = 0.1


@pytest.fixture
def servo():
    return Servo(load_robot("panda"))


def follow(servo, packets, seconds, now=None, ticks=None):
    """Feed packets (arrival, true time, stamp) of a hand at `SPEED` to a servo; return times, tool, commands."""
    home, packets = servo.X_WT, sorted(packets)
    times, tools, commands = [], [], []
    for t in np.arange(0.0, seconds, PERIOD) if ticks is None else ticks:
        arrived = [packets.pop(0) for _ in range(sum(p[0] <= t for p in packets))]
        options = {} if now is None else {"now": now(t)}
        if arrived:
            _, true, stamp = arrived[-1]
            target = Pose(home.quaternion, home.translation + [0.0, SPEED * true, 0.0])
            command = servo.step(target, stamp, **options)
        else:
            command = servo.step(**options)
        times.append(t)
        tools.append(servo.X_WT.translation[1])
        commands.append(command)
    return np.array(times), np.array(tools), commands


def hand(seconds, stamp=lambda t: t, delay=lambda t: 0.001, rate=100):
    return [(t + delay(t), t, stamp(t)) for t in np.arange(0.0, seconds, 1.0 / rate).tolist()]


def lag(times, tools):
    """How far the tool is behind the hand [s], after it has caught up."""
    return (times - tools / SPEED)[times > 0.6]


@pytest.mark.parametrize("simulated", [-1.7e9, 1.7e9, 120.0])
def test_moveit2_772_a_command_stamped_by_another_clock_times_out_all_the_same(servo, simulated):
    """moveit/moveit2#772: "When there is a miss match in the JointJog time stamp, the joint doesn't time out [...]
    I found this problem when I hadn't set the command line publisher to use sim time. [...] Expected: the joint moves
    for 0.1 sec then stops. Actual: the joint continues moving for ever."
    """
    times, _, commands = follow(servo, hand(1.0, lambda t: t + simulated), 2.0)
    stale = next(k for k, command in enumerate(commands) if command.status is Status.STALE and times[k] > 0.5)
    assert times[stale] < 0.99 + servo.settings.timeout + 3 * PERIOD
    assert not commands[-1].v.any()


@pytest.mark.parametrize("delay", [0.05, 0.15, 0.4])
def test_jog_arm_15_a_delay_between_the_device_and_the_arm_is_no_time_out(servo, delay):
    """UTNuclearRoboticsPublic/jog_arm#15: "the timestamp from the incoming message has been reused for the trajectory.
    This leads to timeouts when there is a delay between joy command source and jog_arm."
    """
    _, _, commands = follow(servo, hand(2.0, delay=lambda t: delay), 2.0)
    statuses = {command.status for command in commands[round((delay + 0.1) / PERIOD) :]}
    assert statuses == {Status.FOLLOWING}


def test_udp_bridge_32_old_packets_that_are_delivered_again_do_not_turn_the_motion_back(servo):
    """rolker/udp_bridge#32: "the operator saw old packets republished after newer ones on many topics, so the topic
    stamp jumped backward — the resend protocol delivering a late-requested packet out of order."
    """
    packets = hand(2.0)
    again = [(arrival + 0.037 + 0.2 * (k % 2), true, stamp) for k, (arrival, true, stamp) in enumerate(packets[::5])]
    times, tools, commands = follow(servo, packets + again, 2.0)
    # Some arrive in the same tick as a newer one, and are never seen.
    assert servo.state.stream.counts.late > 20
    assert np.ptp(lag(times, tools)) < 0.002
    assert {command.status for command in commands[10:]} == {Status.FOLLOWING}


def test_udp_bridge_32_a_device_that_restarts_is_not_taken_for_old_packets(servo):
    """The same: the gate "clears on remote-restart detection (so a post-restart packet #0 isn't wrongly dropped)";
    without that "the link goes silent".
    """
    times, tools, commands = follow(servo, hand(3.0, lambda t: t if t < 1.5 else t - 1.5), 3.0)
    assert servo.state.stream.clock.restarts == 1
    assert {command.status for command in commands[10:]} == {Status.FOLLOWING}
    assert np.ptp(lag(times, tools)) < 0.004


def test_ros2_control_2529_a_tick_that_is_a_little_late_costs_no_cycle_and_the_schedule_does_not_drift():
    """ros-controls/ros2_control#2529: "that means that we lose 1 complete cycle because it will then sleep until
    x.0 ms + 2 ms"; "the loop can start e.g. at 1 then 2 then 3.1 then 4.1 then 5.3, aka it can drift. With humble it
    was just 1, 2, 3, 4, 5."
    """
    time, began = [50.0], []
    rng = np.random.default_rng(0)

    def sleep(seconds):
        time[0] += seconds

    pace = RealTime(lambda: time[0], sleep)
    for _ in range(1000):
        began.append(pace.wait(0.001) - 50.0)
        time[0] += 0.0009 + 0.0003 * rng.random() * (rng.random() < 0.3)
    off = np.array(began) - 0.001 * np.arange(1000)
    assert pace.lost == 0.0
    assert off.min() >= -1e-9
    assert off.max() < 0.001
    assert off[-1] < 0.001


def test_ros2_control_644_a_loop_that_misses_its_rate_by_six_percent_stays_with_the_hand_and_says_so(servo):
    """ros-controls/ros2_control#644: "1000 Hz update_rate: 10.5889 s for 1000 iterations. Missed the update_rate by
    5.9 %"; "the main loop spin rate diverges with increasing control rate".
    """
    ticks = np.arange(0.0, 6.0, 1.059 * PERIOD)
    times, tools, commands = follow(servo, hand(6.0), 6.0, lambda t: t + 1e5, ticks)
    assert np.abs(lag(times, tools) - lag(times, tools)[0]).max() < 0.004
    assert commands[-1].status is Status.LATE
    assert commands[-1].missing == pytest.approx(6.0 - len(ticks) * PERIOD, abs=0.01)


@pytest.mark.parametrize("step", [-3600.0, -0.5, -0.003])
def test_ros2_control_2324_a_system_clock_that_is_set_back_stops_nothing(servo, step):
    """ros-controls/ros2_control#2324: "When the system time changes backwards (e.g. due to NTP sync), the write()
    callback of a hardware interface seems to be delayed [...] when network connection was established".
    """

    def clock(t):
        return 1.7e9 + t + (step if t > 1.0 else 0.0)

    times, tools, commands = follow(servo, hand(2.0, clock), 2.0, clock)
    assert {command.status for command in commands[10:]} == {Status.FOLLOWING}
    assert np.ptp(lag(times, tools)) < 0.005
    # A hand that falls silent is noticed, too.
    silent = [servo.step(now=clock(2.0 + k * PERIOD)) for k in range(100)]
    assert silent[-1].status is Status.STALE


def test_xr_teleoperate_247_samples_that_have_waited_for_seconds_are_not_followed(servo):
    """unitreerobotics/xr_teleoperate#247: the arm is 2.5 s behind the person, as samples queue up. Old samples that
    come late and at once are no motion of the hand.
    """

    def delay(t):
        return 4.0 - t + 0.1 * (t - 1.0) if 1.0 < t < 4.3 else 0.001

    times, _, commands = follow(servo, hand(5.0, delay=delay), 5.0, lambda t: t)
    waiting = (times > 1.15) & (times < 4.0)
    assert {command.status for command, w in zip(commands, waiting, strict=True) if w} == {Status.STALE}
    drained = [command for command, t in zip(commands, times, strict=True) if 4.01 < t < 4.25]
    assert all(command.status is not Status.FOLLOWING for command in drained)
    assert "late" in drained[0].reason
    assert commands[-1].status in (Status.FOLLOWING, Status.CATCHING_UP)
