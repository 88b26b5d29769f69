"""Real time: ticks on an absolute schedule, time that is lost is counted, and the controller knows how late it is."""

import numpy as np
import pytest

from optsc import session
from optsc.control.modes import Mode
from optsc.control.status import Status
from optsc.followers import IdealFollower
from optsc.geometry import Pose
from optsc.metrics.interaction import interaction_measures
from optsc.metrics.motion import Motion
from optsc.operators import Mailbox, OperatorSample
from optsc.real_time import RealTime
from optsc.records import load_inputs
from optsc.robot import load_robot
from optsc.session import RunCancelled, RunInterrupted
from optsc.testing.loop import PLACES, StraightOperator, controller, scene

PERIOD = 0.002


class Clock:
    """A clock that goes on by sleeping, and by what is said to take time."""

    def __init__(self, time=100.0):
        self.time, self.slept = time, []

    def __call__(self):
        return self.time

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.time += seconds


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


def test_a_late_tick_does_not_move_the_next_and_what_is_lost_is_counted_and_not_caught_up():
    clock = Clock()
    pace = RealTime(clock, clock.sleep)
    start = pace.wait(PERIOD)
    clock.time += 1.5 * PERIOD  # late by half a period: no cycle is lost
    pace.wait(PERIOD)
    assert pace.late == pytest.approx(0.5 * PERIOD)
    pace.wait(PERIOD)
    assert clock.time == pytest.approx(start + 2 * PERIOD)
    assert pace.lost == 0.0
    clock.time += 1.0
    pace.wait(PERIOD)
    assert pace.lost == pytest.approx(1.0 - PERIOD)
    assert pace.late_ticks == 1
    before = clock.time
    pace.wait(PERIOD)
    assert clock.time == pytest.approx(before + PERIOD)


class Hand:
    """A device on the clock of the loop, in a thread of its own: it samples at 100 Hz whatever the loop does."""

    def __init__(self, clock, stall=(), offset=0.0):
        self.clock, self.stall, self.offset = clock, dict(stall), offset
        self.X_SH, self.seen, self.reads = None, -1, 0
        self.start = clock()

    def read(self, view):
        self.clock.time += self.stall.get(self.reads, 0.0)
        self.reads += 1
        index = int((self.clock() - self.start) / 0.01)
        if index == self.seen:
            return None
        self.seen = index
        time = 0.01 * index
        turn = view.X_WT.quaternion if self.X_SH is None else self.X_SH.quaternion
        self.X_SH = Pose(turn, np.array([0.0, 0.05 * np.sin(2.0 * time), 0.0]))
        return OperatorSample(self.start + time + self.offset, self.X_SH, clutch=True)


def run(robot, operator, clock, **options):
    pace = RealTime(clock, clock.sleep)
    follower = IdealFollower(robot)
    return session.run(controller(robot), operator=operator, follower=follower, clock=pace, **options), pace


def test_a_run_in_real_time_goes_at_the_pace_of_the_clock_and_says_how_late_it_is(robot):
    clock = Clock()
    done, pace = run(robot, Hand(clock, {200: 0.05}), clock, duration=1.0)
    assert done[-1].now - done[0].now == pytest.approx(1.0 - PERIOD, abs=2 * PERIOD)
    assert len(done) == pytest.approx(475, abs=3)
    assert pace.lost == pytest.approx(0.05 - PERIOD, abs=PERIOD)
    late = [tick.step.command.late for tick in done]
    assert max(late) == pytest.approx(0.05, abs=2 * PERIOD)
    assert done[201].step.command.status is Status.LATE
    np.testing.assert_allclose(np.diff(done.times), np.diff([tick.now for tick in done]), atol=1e-9)


def tool_over_time(robot, done):
    """Return the clock and the tool's position at the end of each tick after a second."""
    kept = [tick for tick in done if tick.time > 1.0]
    times = np.array([tick.now for tick in kept])
    return times, robot.forward(np.array([tick.step.command.q for tick in kept])).translation


@pytest.mark.parametrize("offset", [0.0, 1.7e9, -30.0])
def test_stalls_of_the_loop_leave_the_tool_where_the_hand_is(robot, offset):
    tools = []
    for stalls in ({}, dict.fromkeys(range(200, 1500, 60), 0.02)):
        clock = Clock()
        tools.append(tool_over_time(robot, run(robot, Hand(clock, stalls, offset), clock, duration=3.0)[0]))
    (times, calm), (late_times, late) = tools
    gap = [late[:, k] - np.interp(late_times, times, calm[:, k]) for k in range(3)]
    assert np.linalg.norm(gap, axis=0).max() < 0.004  # the hand goes 2 mm in a stall


def test_a_run_in_real_time_is_replayed_bit_for_bit_also_from_a_file(robot, tmp_path):
    clock = Clock()
    done, _ = run(robot, Hand(clock, {100: 0.03, 300: 0.2}, 1.7e9), clock, duration=1.0)
    done.save(tmp_path / "run.npz")
    inputs = load_inputs(tmp_path / "run.npz")
    assert inputs.now == tuple(tick.now for tick in done)
    again = session.replay(controller(robot), inputs)
    assert again.commands.tobytes() == done.commands.tobytes()
    assert [tick.step.command.late for tick in again] == [tick.step.command.late for tick in done]


class Failing:
    """An operator who leads the arm and fails in the middle of a motion."""

    def __init__(self, error, at):
        self.error, self.at, self.reads = error, at, 0
        self.hand = StraightOperator(np.array(PLACES["middle"]) + [0, 0, 0.1])

    def read(self, view):
        self.reads += 1
        if self.reads == self.at:
            raise self.error
        return self.hand.read(view)


class FailingArm(IdealFollower):
    """An arm that refuses one command."""

    commands, at, error = 0, 400, OSError("no answer")

    def apply(self, q, v, opening, period):
        self.commands += 1
        if self.commands == self.at:
            raise self.error
        return super().apply(q, v, opening, period)


def interrupted(robot, part, error):
    """Return the error that a run ends with in which a part fails while the arm moves."""
    operator = Failing(error, 400) if part == "operator" else Failing(error, -1)
    follower = FailingArm(robot) if part == "follower" else IdealFollower(robot)
    follower.error = error

    def fails(*args):
        if part in ("sink", "watch") and operator.reads >= 400 and not done:
            done.append(True)
            raise error

    done = []
    hooks = {"on_tick": fails} if part == "sink" else {"watch": fails, "watch_period": 0.1}
    with pytest.raises((RunInterrupted, RunCancelled)) as caught:
        session.run(controller(robot), operator=operator, follower=follower, candidates=scene(), duration=3.0, **hooks)
    return caught.value


@pytest.mark.parametrize("part", ["operator", "follower", "watch", "sink"])
@pytest.mark.parametrize("error", [ValueError("broken"), KeyboardInterrupt()], ids=["an error", "Ctrl-C"])
def test_whatever_interrupts_a_run_the_arm_comes_to_rest_within_its_limits_and_what_was_recorded_is_handed_back(
    robot, part, error, tmp_path
):
    raised = interrupted(robot, part, error)
    done = raised.run
    if isinstance(error, KeyboardInterrupt):
        assert isinstance(raised, KeyboardInterrupt)
    else:
        assert raised.__cause__ is error
    moving = np.abs(done.v).max(axis=1)
    assert moving[380:398].max() > 1e-3
    assert not done.v[-1].any()
    assert done.modes[-1] is Mode.HOLD
    assert "interrupted" in done[-1].step.reason
    a = np.diff(done.v, axis=0, prepend=0.0) / PERIOD
    assert (np.abs(a) <= robot.limits.acceleration * (1 + 1e-9)).all()
    assert (np.abs(np.diff(a, axis=0)) / PERIOD <= robot.limits.jerk * (1 + 1e-6)).all()
    done.save(tmp_path / "run.npz")
    again = session.replay(controller(robot), load_inputs(tmp_path / "run.npz"), scene())
    assert again.commands.tobytes() == done.commands.tobytes()


def test_where_the_follower_takes_no_command_any_more_the_first_error_is_what_is_raised(robot, caplog):
    class Dead(IdealFollower):
        commands = 0

        def apply(self, *command):
            self.commands += 1
            if self.commands > 100:
                raise OSError("gone")
            return super().apply(*command)

    hand = StraightOperator(np.array(PLACES["middle"]))
    with pytest.raises(RunInterrupted, match="gone") as caught:
        session.run(controller(robot), operator=hand, follower=Dead(robot), duration=1.0)
    assert len(caught.value.run) == 100
    assert "could not be brought to rest" in caplog.text


def test_what_is_no_sample_is_saved_as_one_that_is_refused(robot, tmp_path):
    class Odd:
        count = 0

        def read(self, view):
            self.count += 1
            good = OperatorSample(view.time, Pose.identity(), lost=self.count == 300)
            return (
                good
                if self.count % 2
                else [np.eye(4), good._replace(stamp="x"), good._replace(buttons=None)][self.count % 3]
            )

    done = session.run(controller(robot), operator=Odd(), follower=IdealFollower(robot), duration=0.8)
    done.save(tmp_path / "run.npz")
    inputs = load_inputs(tmp_path / "run.npz")
    again = session.replay(controller(robot), inputs)
    assert again.commands.tobytes() == done.commands.tobytes()
    assert [t.mode for t in again] == [t.mode for t in done]


@pytest.mark.parametrize("offset", [0.0, 1.7e9, -30.0])
def test_measures_of_the_hand_do_not_depend_on_the_clock_that_it_was_stamped_by(robot, offset):
    clock = Clock()
    done, _ = run(robot, Hand(clock, {300: 0.2}, offset), clock, duration=2.0)
    motion = Motion.of_run(done, robot)
    times = np.arange(len(done)) * PERIOD
    assert len(motion.hand.stamp) > 150
    assert motion.hand.stamp[0] >= -0.01
    assert motion.hand.stamp[-1] <= times[-1]
    assert len(motion.part(0, 500).hand.stamp) == pytest.approx(100, abs=12)
    # 50 mm there, 88 mm back.
    assert interaction_measures(motion)["effort_m"] == pytest.approx(0.138, abs=0.01)


def test_samples_of_a_mailbox_need_no_restamping(robot):
    clock, box = Clock(), Mailbox()
    device = Hand(clock)

    class Device:
        def read(self, view):
            sample = device.read(view)
            if sample is not None:
                box.post(sample)
            return box.read(view)

    done, _ = run(robot, Device(), clock, duration=0.5)
    assert done.modes[-1] is Mode.MANUAL
    assert done[-1].step.command.status is Status.FOLLOWING
