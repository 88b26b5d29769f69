"""What every follower has to do, tried on each of them."""

import numpy as np
import pytest

from optsc.errors import Closed, InvalidValue
from optsc.followers import IdealFollower
from optsc.robot import load_robot
from optsc.sim import tabletop
from optsc.sim.follower import PyBulletFollower

RATE = 500.0
TOLERANCE = {"ideal": 1e-12, "bullet": 2e-5}  # [rad]


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


def make(kind, robot):
    world = tabletop(robot, ("mug", "can"), seed=1)
    return IdealFollower(robot, world.X_WO) if kind == "ideal" else PyBulletFollower(world)


@pytest.fixture(params=["ideal", "bullet"])
def kind(request):
    return request.param


@pytest.fixture
def follower(kind, robot):
    with make(kind, robot) as follower:
        yield follower


def swing(robot, t, speed=1.5, rate=6.0):
    """Return a smooth posture and its velocity: sines that start from rest."""
    amplitude = speed / rate * (-1.0) ** np.arange(robot.n)
    s = min(t / 0.3, 1.0)
    fade, fading = s**3 * (10 - 15 * s + 6 * s**2), (30 * s**2 - 60 * s**3 + 30 * s**4) / 0.3
    q = robot.home + amplitude * fade * np.sin(rate * t)
    v = amplitude * (fade * rate * np.cos(rate * t) + fading * np.sin(rate * t))
    return q, v


def run(follower, robot, ticks=100, opening=0.03):
    states = [follower.apply(*swing(robot, k / RATE), opening, 1 / RATE) for k in range(1, ticks + 1)]
    numbers = [np.concatenate([[s.time], s.q, s.v, [s.opening]]) for s in states]
    poses = [np.append(X.translation, X.quaternion) for X in follower.objects().values()]
    return np.concatenate([*numbers, *poses]).tobytes()


def as_bytes(state):
    return np.concatenate([[state.time], state.q, state.v, [state.opening]]).tobytes()


def test_reset_puts_the_arm_where_asked_at_rest_with_open_jaws(follower, robot):
    run(follower, robot, 20)
    q = robot.home + 0.1
    state = follower.reset(q)
    np.testing.assert_array_equal(state.q, q)
    np.testing.assert_array_equal(state.v, 0.0)
    assert state.time == 0.0
    assert state.opening == pytest.approx(robot.gripper.max_opening, abs=1e-12)
    assert as_bytes(state) == as_bytes(follower.state())


def test_a_new_follower_stands_at_home(follower, robot):
    np.testing.assert_array_equal(follower.state().q, robot.home)
    assert follower.state().time == 0.0


def test_apply_follows_a_smooth_motion_at_full_speed(follower, robot, kind):
    errors = []
    for tick in range(1, 401):
        q, v = swing(robot, tick / RATE)
        errors.append(np.abs(follower.apply(q, v, 0.08, 1 / RATE).q - q).max())
    assert max(errors) <= TOLERANCE[kind]


def test_a_held_command_keeps_the_arm_still(follower, robot, kind):
    for _ in range(100):
        state = follower.apply(robot.home, 0.0 * robot.home, 0.08, 1 / RATE)
        assert np.abs(state.q - robot.home).max() <= TOLERANCE[kind]
    assert np.abs(state.v).max() < 1e-3


def test_time_advances_by_the_period(follower, robot):
    for period, expected in ((0.002, 0.002), (0.004, 0.006), (0.001, 0.007)):
        state = follower.apply(robot.home, 0.0 * robot.home, 0.08, period)
        assert state.time == pytest.approx(expected, abs=1e-12)


def test_the_jaws_take_their_time_and_arrive(follower, robot):
    still = 0.0 * robot.home
    early = [follower.apply(robot.home, still, 0.02, 0.002) for _ in range(50)][-1].opening
    assert early == pytest.approx(0.08 - 0.1 * 0.1, abs=2e-3)  # 0.1 m/s during 0.1 s
    late = [follower.apply(robot.home, still, 0.02, 0.002) for _ in range(400)][-1].opening
    assert late == pytest.approx(0.02, abs=5e-4)


def test_what_a_follower_hands_out_is_not_its_memory(follower, robot):
    q, v = robot.home + 0.0, 0.0 * robot.home
    state = follower.apply(q, v, 0.08, 0.002)
    before = as_bytes(follower.state())
    state.q[:] = q[:] = v[:] = 7.0
    assert as_bytes(follower.state()) == before
    after = follower.apply(robot.home, 0.0 * robot.home, 0.08, 0.002)
    np.testing.assert_allclose(after.q, robot.home, atol=1e-4)


def test_the_same_commands_give_the_same_bytes_after_reset_and_in_another_follower(follower, robot, kind):
    first = run(follower, robot)
    follower.reset(robot.home + 0.05)
    other = run(follower, robot, 30, opening=0.0)
    follower.reset(robot.home)
    assert run(follower, robot) == first != other
    with make(kind, robot) as another:
        assert run(another, robot) == first


WRONG = {
    "q holds nan": lambda q: (q * np.nan, 0 * q, 0.08, 0.002),
    "q is infinite": lambda q: (q + np.inf, 0 * q, 0.08, 0.002),
    "q is too short": lambda q: (q[:-1], 0 * q, 0.08, 0.002),
    "q is a batch": lambda q: (q[None], 0 * q, 0.08, 0.002),
    "v holds nan": lambda q: (q, q * np.nan, 0.08, 0.002),
    "v is too long": lambda q: (q, np.append(q, 0.0), 0.08, 0.002),
    "opening is nan": lambda q: (q, 0 * q, float("nan"), 0.002),
    "opening is negative": lambda q: (q, 0 * q, -0.01, 0.002),
    "opening is too wide": lambda q: (q, 0 * q, 0.09, 0.002),
    "period is zero": lambda q: (q, 0 * q, 0.08, 0.0),
    "period is negative": lambda q: (q, 0 * q, 0.08, -0.002),
    "period is nan": lambda q: (q, 0 * q, 0.08, float("nan")),
}


def test_a_wrong_command_is_refused_by_name_and_leaves_everything_as_it_was(follower, robot):
    run(follower, robot, 5)
    before, poses = as_bytes(follower.state()), str(follower.objects())
    for what, command in WRONG.items():
        with pytest.raises(InvalidValue, match=what.split()[0]):
            follower.apply(*command(robot.home + 0.2))
    for q in (robot.home * np.nan, robot.home[:-1], robot.home[None]):
        with pytest.raises(InvalidValue, match="q"):
            follower.reset(q)
    assert as_bytes(follower.state()) == before
    assert str(follower.objects()) == poses
    # The refused commands have not become the start of the next motion either.
    q, v = swing(robot, 6 / RATE)
    np.testing.assert_allclose(follower.apply(q, v, 0.03, 1 / RATE).q, q, atol=2e-5)


def test_objects_stand_where_the_world_put_them(follower, robot):
    expected = tabletop(robot, ("mug", "can"), seed=1).X_WO
    found = follower.objects()
    assert list(found) == list(expected)
    for name, X_WO in found.items():
        assert X_WO.almost_equal(expected[name], 1e-9)


def test_closing_twice_is_harmless_and_use_after_closing_is_a_clear_error(kind, robot):
    follower = make(kind, robot)
    follower.close()
    follower.close()
    for use in (
        follower.state,
        follower.objects,
        lambda: follower.reset(robot.home),
        lambda: follower.apply(robot.home, robot.home, 0.08, 0.002),
        follower.__enter__,
    ):
        with pytest.raises(Closed, match="closed"):
            use()


def test_leaving_the_with_block_closes(kind, robot):
    with make(kind, robot) as follower:
        pass
    with pytest.raises(Closed):
        follower.state()
