"""Contract tests of a follower: an arm, simulated or real, that takes joint commands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, ClassVar

import numpy as np

from optsc.errors import Closed, InvalidValue
from optsc.followers import Follower, FollowerState
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.robot import RobotModel, load_robot
from optsc.testing.contract import Contract, refused

PERIOD = 1 / 500.0
"""Period of the commands [s]."""


class FollowerContract(Contract):
    """What `optsc.followers.Follower` promises: it follows, keeps time, refuses wrong commands by name, and closes.

    ::

        class TestMyArm(FollowerContract):
            tolerance = 1e-3  # [rad]

            def make_follower(self, robot):
                return MyArm(robot)

    Attributes:
        tolerance: how far the joints may be from a command at its end, along a smooth motion [rad].
        repeats: whether the same commands give the same states, bit for bit; not so for a real arm.
        jaw_speed: rate of the opening, where it is known [m/s].
    """

    tolerance: ClassVar[float] = 1e-4
    repeats: ClassVar[bool] = True
    jaw_speed: ClassVar[float | None] = None

    def make_robot(self) -> RobotModel:
        """Return the arm; a Panda unless overridden."""
        return load_robot("panda")

    def make_follower(self, robot: RobotModel) -> Follower:
        """Return a new follower of ``robot``; to be overridden."""
        raise NotImplementedError

    def expected_objects(self, robot: RobotModel) -> Mapping[str, Pose] | None:
        """Return where a new follower's objects stand; None where that is not known."""
        return None

    @contextmanager
    def opened(self) -> Iterator[tuple[Follower, RobotModel]]:
        """Make a follower and close it afterwards."""
        robot = self.make_robot()
        with self.make_follower(robot) as follower:
            yield follower, robot

    def test_reset_puts_the_arm_where_asked_at_rest_with_open_jaws(self) -> None:
        with self.opened() as (follower, robot):
            play(follower, robot, 20)
            q = robot.home + 0.1
            state = follower.reset(q)
            np.testing.assert_array_equal(state.q, q)
            np.testing.assert_array_equal(state.v, 0.0)
            assert state.time == 0.0, f"time is {state.time} s after a reset"
            np.testing.assert_allclose(state.opening, widest(robot), rtol=0.0, atol=1e-12)
            assert as_bytes(state) == as_bytes(follower.state()), "reset() and state() differ"

    def test_it_goes_on_from_a_state_that_it_was_put_at_or_says_that_it_cannot(self) -> None:
        with self.opened() as (follower, robot):
            q, v = swing(robot, 0.4)
            asked = FollowerState(0.4, q, v, 0.5 * widest(robot))
            before = as_bytes(follower.state())
            try:
                placed = follower.at(asked)
            except InvalidValue:
                assert as_bytes(follower.state()) == before, "it refused and yet moved"
                return
            assert placed is follower, "at() does not return the follower"
            found = follower.state()
            for name, tolerance in (("time", 1e-9), ("q", 1e-9), ("v", 1e-9), ("opening", 1e-6)):
                np.testing.assert_allclose(getattr(found, name), getattr(asked, name), rtol=0.0, atol=tolerance)
            for tick in range(1, 51):
                q, v = swing(robot, 0.4 + tick * PERIOD)
                state = follower.apply(q, v, asked.opening, PERIOD)
                np.testing.assert_allclose(state.time, 0.4 + tick * PERIOD, rtol=0.0, atol=1e-9)
                np.testing.assert_allclose(state.q, q, rtol=0.0, atol=self.tolerance)
            for wrong in (asked._replace(q=q[:-1]), asked._replace(v=v * np.nan)):
                with refused(InvalidValue, "v" if wrong.q is asked.q else "q"):
                    follower.at(wrong)

    def test_a_new_follower_stands_at_home(self) -> None:
        with self.opened() as (follower, robot):
            np.testing.assert_array_equal(follower.state().q, robot.home)
            assert follower.state().time == 0.0, "the time of a new follower is not 0"

    def test_apply_follows_a_smooth_motion_at_full_speed(self) -> None:
        with self.opened() as (follower, robot):
            for tick in range(1, 401):
                q, v = swing(robot, tick * PERIOD)
                state = follower.apply(q, v, widest(robot), PERIOD)
                np.testing.assert_allclose(state.q, q, rtol=0.0, atol=self.tolerance)

    def test_a_held_command_keeps_the_arm_still(self) -> None:
        with self.opened() as (follower, robot):
            for _ in range(100):
                state = follower.apply(robot.home, 0.0 * robot.home, widest(robot), PERIOD)
                np.testing.assert_allclose(state.q, robot.home, rtol=0.0, atol=self.tolerance)
            assert np.abs(state.v).max() < 1e-3, f"the arm still moves by {state.v} rad/s"

    def test_time_advances_by_the_period(self) -> None:
        with self.opened() as (follower, robot):
            for period, expected in ((0.002, 0.002), (0.004, 0.006), (0.001, 0.007)):
                state = follower.apply(robot.home, 0.0 * robot.home, widest(robot), period)
                np.testing.assert_allclose(state.time, expected, rtol=0.0, atol=1e-12)

    def test_the_jaws_take_their_time_and_arrive(self) -> None:
        with self.opened() as (follower, robot):
            goal = 0.25 * widest(robot)
            command = robot.home, 0.0 * robot.home, goal, PERIOD
            early = [follower.apply(*command).opening for _ in range(50)][-1]
            if self.jaw_speed is not None:
                expected = max(goal, widest(robot) - 0.1 * self.jaw_speed)
                np.testing.assert_allclose(early, expected, rtol=0.0, atol=2e-3)
            late = [follower.apply(*command).opening for _ in range(400)][-1]
            np.testing.assert_allclose(late, goal, rtol=0.0, atol=5e-4)

    def test_what_a_follower_hands_out_is_not_its_memory(self) -> None:
        with self.opened() as (follower, robot):
            q, v = robot.home + 0.0, 0.0 * robot.home
            state = follower.apply(q, v, widest(robot), PERIOD)
            before = as_bytes(follower.state())
            state.q[:] = q[:] = v[:] = 7.0
            assert as_bytes(follower.state()) == before, "writing into a state or a command moved the arm"
            after = follower.apply(robot.home, 0.0 * robot.home, widest(robot), PERIOD)
            np.testing.assert_allclose(after.q, robot.home, rtol=0.0, atol=max(1e-4, self.tolerance))

    def test_the_same_commands_give_the_same_bytes_after_reset_and_in_another_follower(self) -> None:
        if not self.repeats:
            return
        with self.opened() as (follower, robot):
            first = play(follower, robot)
            follower.reset(robot.home + 0.05)
            assert play(follower, robot, 30, opening=0.0) != first, "other commands give the same states"
            follower.reset(robot.home)
            assert play(follower, robot) == first, "after a reset the same commands give other states"
        with self.opened() as (another, robot):
            assert play(another, robot) == first, "in another follower the same commands give other states"

    def test_a_wrong_command_is_refused_by_name_and_leaves_everything_as_it_was(self) -> None:
        with self.opened() as (follower, robot):
            play(follower, robot, 5)
            before, poses = as_bytes(follower.state()), str(follower.objects())
            for field, command in wrong_commands(robot):
                with refused(InvalidValue, field):
                    follower.apply(*command)
            for q in (robot.home * np.nan, robot.home[:-1], robot.home[None]):
                with refused(InvalidValue, "q"):
                    follower.reset(q)
            assert as_bytes(follower.state()) == before, "a refused command changed the state"
            assert str(follower.objects()) == poses, "a refused command moved an object"
            # Nor has it become the start of the next motion.
            q, v = swing(robot, 6 * PERIOD)
            state = follower.apply(q, v, min(0.03, widest(robot)), PERIOD)
            np.testing.assert_allclose(state.q, q, rtol=0.0, atol=self.tolerance)

    def test_objects_stand_where_the_world_put_them(self) -> None:
        with self.opened() as (follower, robot):
            found, expected = follower.objects(), self.expected_objects(robot)
            for name, X_WO in found.items():
                assert X_WO.shape == (), f"{name} stands at a batch of poses"
                assert np.all(np.isfinite([*X_WO.quaternion, *X_WO.translation])), f"{name} stands nowhere"
            if expected is not None:
                assert list(found) == list(expected), f"objects are {list(found)}, not {list(expected)}"
                for name, X_WO in found.items():
                    assert X_WO.almost_equal(expected[name], 1e-9), f"{name} stands elsewhere"

    def test_closing_twice_is_harmless_and_use_after_closing_is_a_clear_error(self) -> None:
        robot = self.make_robot()
        follower = self.make_follower(robot)
        follower.close()
        follower.close()
        for use in (
            follower.state,
            follower.objects,
            lambda: follower.reset(robot.home),
            lambda: follower.apply(robot.home, robot.home, widest(robot), PERIOD),
            follower.__enter__,
        ):
            with refused(Closed, "closed"):
                use()

    def test_leaving_the_with_block_closes(self) -> None:
        with self.opened() as (follower, _):
            pass
        with refused(Closed, "closed"):
            follower.state()


def widest(robot: RobotModel) -> float:
    """Return the greatest opening of the jaws [m]; 0 without a gripper."""
    return robot.gripper.max_opening if robot.gripper else 0.0


def swing(robot: RobotModel, t: float, speed: float = 1.5, rate: float = 6.0) -> tuple[Array, Array]:
    """Return positions and velocities (n,) of sines about home that start from rest, within the arm's limits."""
    limits = robot.limits
    room = np.minimum(robot.home - limits.lower, limits.upper - robot.home)
    size = np.minimum(np.minimum(speed, 0.7 * limits.velocity) / rate, 0.9 * room)
    amplitude = size * (-1.0) ** np.arange(robot.n)
    s = min(t / 0.3, 1.0)
    fade, fading = s**3 * (10 - 15 * s + 6 * s**2), (30 * s**2 - 60 * s**3 + 30 * s**4) / 0.3
    q = robot.home + amplitude * fade * np.sin(rate * t)
    v = amplitude * (fade * rate * np.cos(rate * t) + fading * np.sin(rate * t))
    return q, v


def play(follower: Follower, robot: RobotModel, ticks: int = 100, opening: float = 0.03) -> bytes:
    """Return all states along a smooth motion, and where the objects are in the end."""
    jaws = min(opening, widest(robot))
    states = [follower.apply(*swing(robot, k * PERIOD), jaws, PERIOD) for k in range(1, ticks + 1)]
    poses = [np.append(X.translation, X.quaternion).tobytes() for X in follower.objects().values()]
    return b"".join([*map(as_bytes, states), *poses])


def as_bytes(state: FollowerState) -> bytes:
    """Return the numbers of a state."""
    return np.concatenate([[state.time], state.q, state.v, [state.opening]]).tobytes()


def wrong_commands(robot: RobotModel) -> Iterator[tuple[str, tuple[Any, Any, float, float]]]:
    """Return commands that a follower refuses, each after the name of the field that is wrong."""
    q, still, jaws, nan = robot.home + 0.2, 0.0 * robot.home, widest(robot), float("nan")
    yield from (("q", (bad, still, jaws, PERIOD)) for bad in (q * nan, q + np.inf, q[:-1], q[None]))
    yield from (("v", (q, bad, jaws, PERIOD)) for bad in (q * nan, np.append(q, 0.0)))
    openings = (nan, -0.01, jaws + 0.01) if robot.gripper else (nan,)
    yield from (("opening", (q, still, bad, PERIOD)) for bad in openings)
    yield from (("period", (q, still, jaws, bad)) for bad in (0.0, -PERIOD, nan))
