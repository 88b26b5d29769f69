from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose, rotation
from optsc.operators.sample import OperatorView
from optsc.people.motor import BandNoise, Movement, WanderingNoise, minimum_jerk
from optsc.people.parameters import AimParameters, HumanParameters, Intention
from optsc.people.ready_pose import Aim
from optsc.people.simulated import R_WS_DEFAULT, Simulated

X_WT_START = Pose.from_quaternion([0.0, 1.0, 0.0, 0.0], [0.35, 0.0, 0.45])
OBJECTS = {
    "can": Pose.from_translation([0.5, 0.25, 0.0]),
    "mug": Pose.from_rotation_vector([0.0, 0.0, 1.0], [0.55, -0.2, 0.0]),
}
STEADY = HumanParameters(
    motor_noise=0.0,
    tremor=0.0,
    tremor_rotation=0.0,
    drift=0.0,
    drift_rotation=0.0,
    tracker_noise=0.0,
    tracker_noise_rotation=0.0,
)


class Trial(NamedTuple):
    stamps: np.ndarray
    X_SH: Pose
    trigger: np.ndarray
    presses: list[float]
    X_WT: list[Pose]  # of the tool at each press


def act_out(operator, duration, *, rate=180.0, robot_works_for=np.inf, robot_starts=True, finish_after=np.inf):
    """A tool that follows the hand at once in the paper's mapping, and stands still while automatic."""
    X_WT, automatic, finished, pressed_before, since = X_WT_START, False, False, False, 0.0
    samples, presses, tools, origin = [], [], [], None
    for tick in range(round(duration * rate)):
        time = tick / rate
        sample = operator.read(OperatorView(time, X_WT, automatic, finished, OBJECTS))
        if sample is not None:
            samples.append(sample)
            pressed, pressed_before = sample.trigger and not pressed_before, sample.trigger
            if pressed:
                presses.append(time)
                tools.append(X_WT)
                automatic, since = robot_starts and not automatic, time
            if automatic or origin is None or pressed:
                origin = (X_WT.translation, sample.X_SH.translation)
            if not automatic:
                moved = rotation.rotate(operator.R_WS, sample.X_SH.translation - origin[1])
                X_WT = Pose(rotation.multiply(operator.R_WS, sample.X_SH.quaternion), origin[0] + moved)
        if automatic:
            finished = finished or time - since >= finish_after
            automatic = time - since < robot_works_for
    return Trial(
        np.array([s.stamp for s in samples]),
        Pose.stack([s.X_SH for s in samples]),
        np.array([s.trigger for s in samples]),
        presses,
        tools,
    )


def test_the_same_seed_gives_the_same_samples_bit_for_bit():
    first, second, other = (act_out(Simulated(seed=seed), 3.0) for seed in (4, 4, 5))
    assert first.X_SH.translation.tobytes() == second.X_SH.translation.tobytes()
    assert first.X_SH.quaternion.tobytes() == second.X_SH.quaternion.tobytes()
    assert first.stamps.tobytes() == second.stamps.tobytes()
    assert first.X_SH.translation.tobytes() != other.X_SH.translation.tobytes()


@pytest.mark.parametrize("rate", [90.0, 125.0, 1000.0])
def test_samples_come_at_the_trackers_rate_whatever_the_control_rate(rate):
    trial = act_out(Simulated(seed=0, human=STEADY), 0.4, rate=rate)
    assert len(trial.stamps) == 36
    np.testing.assert_allclose(np.diff(trial.stamps), 1 / 90, rtol=1e-9)


def test_no_sample_is_handed_in_twice_or_before_its_time():
    operator = Simulated(seed=0)
    view = OperatorView(7.0, X_WT_START, False, False, OBJECTS)
    assert operator.read(view).stamp == 7.0
    assert operator.read(view) is None
    assert operator.read(view._replace(time=7.0 + 0.9 / 90)) is None
    assert operator.read(view._replace(time=7.0 + 1.1 / 90)).stamp == pytest.approx(7.0 + 1 / 90)


def test_who_is_asked_late_hands_in_the_newest_sample_only():
    operator = Simulated(seed=0)
    view = OperatorView(0.0, X_WT_START, False, False, OBJECTS)
    operator.read(view)
    assert operator.read(view._replace(time=0.2555)).stamp == pytest.approx(22 / 90)
    assert operator.read(view._replace(time=0.2556)).stamp == pytest.approx(23 / 90)


def test_the_hand_starts_as_the_tool_is_turned_but_for_a_natural_misalignment():
    human = HumanParameters()
    for seed in range(5):
        operator = Simulated(seed=seed, human=STEADY)
        sample = operator.read(OperatorView(0.0, X_WT_START, False, False, OBJECTS))
        R_WH = rotation.multiply(R_WS_DEFAULT, sample.X_SH.quaternion)
        off = float(rotation.angle(R_WH, X_WT_START.quaternion))
        assert 0.5 * human.misalignment - 1e-9 <= off <= human.misalignment + 1e-9


def test_the_hand_rests_before_its_first_movement():
    trial = act_out(Simulated(seed=2, human=STEADY), 1.0)
    moved = np.linalg.norm(trial.X_SH.translation - trial.X_SH.translation[0], axis=-1)
    assert np.all(moved[trial.stamps <= 0.3] == 0.0)
    assert moved[-1] > 0.01


@pytest.mark.parametrize("seed", range(6))
def test_the_trigger_is_pressed_at_a_pose_a_person_would_like(seed):
    human, aims = HumanParameters(), AimParameters()
    trial = act_out(Simulated(seed=seed, plan=[Intention("can")]), 6.0)
    tool = trial.X_WT[0]
    to_middle = OBJECTS["can"].apply([0.0, 0.0, aims.middle]) - tool.translation
    distance = np.linalg.norm(to_middle)
    _, y, z = tool.rotation_matrix().T
    slack = human.rotation_tolerance + human.position_tolerance / distance
    assert aims.distance[0] - 0.02 <= distance <= aims.distance[1] + 0.02
    assert np.arccos(to_middle @ z / distance) <= slack
    elevation = np.arcsin(-z[2])
    assert elevation >= aims.elevation[0] - slack
    assert abs(y[2]) <= np.sin(aims.roll + slack)
    if elevation < np.radians(75.0):
        bearing = np.arctan2(z[1], z[0]) - np.arctan2(0.25, 0.5)
        assert abs(bearing) <= aims.azimuth + slack / np.cos(elevation)


def test_a_press_is_short_and_single():
    trial = act_out(Simulated(seed=0), 6.0, finish_after=1.0)
    assert len(trial.presses) == 1
    assert trial.trigger.sum() / 90 == pytest.approx(HumanParameters().press, abs=2 / 90)


def test_the_hand_rests_while_the_robot_works_and_after_the_task_is_finished():
    trial = act_out(Simulated(seed=0, human=STEADY), 8.0, finish_after=1.0)
    after = trial.X_SH.translation[trial.stamps > trial.presses[0]]
    assert len(after) > 300
    assert np.ptp(after, axis=0).max() < 1e-12


def test_resting_hands_tremble_and_drift_by_less_than_a_centimetre():
    trial = act_out(Simulated(seed=0), 8.0, finish_after=1.0)
    after = trial.X_SH.translation[trial.stamps > trial.presses[0]]
    assert after.std(axis=0).min() > 0.2e-3
    assert np.ptp(after, axis=0).max() < 10e-3


def test_a_planned_take_over_comes_when_planned_and_leads_to_the_next_object():
    plan = [Intention("can", then_take_over_after=0.8), Intention("mug")]
    trial = act_out(Simulated(seed=3, plan=plan), 9.0)
    assert len(trial.presses) == 3
    assert trial.presses[1] - trial.presses[0] == pytest.approx(0.8, abs=2 / 90)
    for tool, name in ((trial.X_WT[0], "can"), (trial.X_WT[2], "mug")):
        middle = OBJECTS[name].apply([0.0, 0.0, 0.05])
        assert 0.1 <= np.linalg.norm(tool.translation - middle) <= 0.22


def test_a_take_over_before_the_first_press_has_ended_waits_until_the_trigger_was_released():
    trial = act_out(Simulated(seed=3, plan=[Intention("can", 0.01), Intention("mug")]), 4.5)
    assert len(trial.presses) == 2
    between = (trial.stamps > trial.presses[0]) & (trial.stamps < trial.presses[1])
    assert np.count_nonzero(~trial.trigger[between]) >= 5


def test_after_the_last_planned_take_over_the_hand_rests():
    trial = act_out(Simulated(seed=3, plan=[Intention("can", 0.5)], human=STEADY), 9.0)
    assert len(trial.presses) == 2
    rest = trial.X_SH.translation[trial.stamps > trial.presses[1]]
    assert np.ptp(rest, axis=0).max() < 1e-12


@pytest.mark.parametrize("robot", [{"robot_works_for": 0.6}, {"robot_starts": False}])
def test_when_the_robot_gives_up_or_never_starts_the_person_aims_anew_and_triggers_again(robot):
    trial = act_out(Simulated(seed=6, plan=[Intention("can")]), 7.5, **robot)
    assert len(trial.presses) >= 2
    lost = trial.presses[0] + robot.get("robot_works_for", HumanParameters().retrigger)
    assert trial.presses[1] - lost >= HumanParameters().retrigger - 0.02
    first, second = trial.X_WT[:2]
    assert 0.0 < np.linalg.norm(first.translation - second.translation) < 0.12


def test_a_miss_is_seen_and_corrected():
    aims = AimParameters(elevation=(1.0, 1.0), azimuth=0.0, distance=(0.15, 0.15), roll=0.0)
    goal = Aim(elevation=1.0, azimuth=0.0, distance=0.15, roll=0.0).pose(OBJECTS["can"], aims.middle)
    worst = {}
    for corrections in (0, 6):
        human = HumanParameters(motor_noise=0.4, corrections=corrections, attempts=0)
        trials = [act_out(Simulated(seed, [Intention("can")], human=human, aims=aims), 9.0) for seed in range(4)]
        worst[corrections] = max(np.linalg.norm(t.X_WT[0].translation - goal.translation) for t in trials)
    # What drifts and trembles after the last observation comes on top of the tolerance.
    assert worst[6] <= human.position_tolerance + 0.008 < worst[0]


def test_the_hand_reaches_its_goal_along_a_minimum_jerk_profile():
    trial = act_out(Simulated(seed=2, human=STEADY), 3.0)
    p = trial.X_SH.translation
    speed = np.linalg.norm(np.diff(p, axis=0), axis=1) * 90
    moving = np.flatnonzero(speed > 1e-9)
    first = moving[: np.argmax(np.diff(np.append(moving, 10**6)) > 1) + 1]
    duration, length = len(first) / 90, np.sum(speed[first]) / 90
    assert speed[first].max() == pytest.approx(1.875 * length / duration, rel=0.03)
    line = p[first[-1]] - p[first[0]]
    off = np.cross(p[first] - p[first[0]], line / np.linalg.norm(line))
    assert np.abs(off).max() < 1e-9


def test_movements_take_longer_the_further_and_the_finer():
    human = HumanParameters()
    assert human.movement_time(0.4, 0.0) > human.movement_time(0.2, 0.0)
    assert human.movement_time(0.2, 1.0) > human.movement_time(0.2, 0.0)
    fine = HumanParameters(position_tolerance=0.005)
    assert fine.movement_time(0.2, 0.0) > human.movement_time(0.2, 0.0)
    doubling = human.movement_time(2 * 0.04 * 1023, 0.0) - human.movement_time(0.04 * 1023, 0.0)
    assert doubling == pytest.approx(human.fitts_slope, rel=1e-3)


def test_minimum_jerk_starts_and_ends_at_rest_and_is_antisymmetric():
    assert [minimum_jerk(s) for s in (-1.0, 0.0, 0.5, 1.0, 2.0)] == [0.0, 0.0, 0.5, 1.0, 1.0]
    s = np.linspace(0, 1, 11)
    share = np.array([minimum_jerk(v) for v in s])
    np.testing.assert_allclose(share + share[::-1], 1.0, atol=1e-15)
    step = 1e-4
    assert minimum_jerk(step) < 20 * step**3


def test_the_pieces_of_a_movement_add_up_to_the_whole():
    for duration in (0.7, 0.0):
        movement = Movement(0.2, duration, np.ones(3), np.zeros(3))
        edges = np.linspace(0.0, 2.0, 181)
        pieces = [movement.share_between(a, b) for a, b in pairwise(edges)]
        assert sum(pieces) == pytest.approx(1.0)


def test_tremor_has_the_amplitude_and_the_band_it_is_given():
    noise = BandNoise(np.random.default_rng(0), np.array([2e-4, 1.0]), 10.0, 2.5, 90.0)
    x = np.array([noise.next() for _ in range(9000)])
    np.testing.assert_allclose(x.std(axis=0), [2e-4, 1.0], rtol=0.1)
    power = np.abs(np.fft.rfft(x[:, 1])) ** 2
    frequency = np.fft.rfftfreq(len(x), 1 / 90)
    assert power[(frequency > 8) & (frequency < 12)].sum() > 0.55 * power.sum()
    assert power[frequency < 4].sum() < 0.1 * power.sum()


def test_wandering_noise_has_the_amplitude_and_the_memory_it_is_given():
    noise = WanderingNoise(np.random.default_rng(0), np.array([3.0]), 0.1, 0.01)
    x = np.array([noise.next() for _ in range(20000)])[:, 0]
    assert x.std() == pytest.approx(3.0, rel=0.1)
    assert np.corrcoef(x[:-10], x[10:])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.08)


def test_an_object_that_is_hidden_is_remembered():
    operator = Simulated(seed=0, plan=[Intention("can")], human=STEADY)
    operator.read(OperatorView(0.0, X_WT_START, False, False, OBJECTS))
    samples = [operator.read(OperatorView(k / 90, X_WT_START, False, False, {})) for k in range(1, 200)]
    assert np.linalg.norm(samples[-1].X_SH.translation - samples[0].X_SH.translation) > 0.1


def test_an_object_that_is_not_there_is_refused_at_the_first_view():
    view = OperatorView(0.0, X_WT_START, False, False, OBJECTS)
    with pytest.raises(UnknownName, match="can, mug"):
        Simulated(seed=0, plan=[Intention("drill")]).read(view)
    with pytest.raises(InvalidValue, match="at least one object"):
        Simulated(seed=0).read(view._replace(objects={}))


@pytest.mark.parametrize(
    "make",
    [
        lambda: Simulated(seed=0, plan=[]),
        lambda: Simulated(seed=0, R_WS=[1.0, 1.0, 0.0, 0.0]),
        lambda: Intention("can", then_take_over_after=0.0),
        lambda: Intention("can", then_take_over_after=float("nan")),
        lambda: HumanParameters(sample_rate=0.0),
        lambda: HumanParameters(tremor=-1.0),
        lambda: HumanParameters(drift=float("nan")),
        lambda: HumanParameters(sample_rate=20.0),
        lambda: HumanParameters(press=0.001),
        lambda: HumanParameters(hand_start=(0.0, float("inf"), 0.0)),
        lambda: AimParameters(elevation=(1.0, 0.5)),
        lambda: AimParameters(azimuth=-0.1),
        lambda: AimParameters(draws=0),
    ],
)
def test_habits_out_of_range_are_refused(make):
    with pytest.raises(InvalidValue):
        make()


def test_a_person_tries_another_side_where_the_arm_does_not_get_to():
    tool = Pose.from_quaternion([0.0, 1.0, 0.0, 0.0], [0.3, 0.0, 0.5])

    def stuck_view(k):
        return OperatorView(k / 500.0, tool, False, False, OBJECTS)

    human = HumanParameters(corrections=1, attempts=2, patience=0.3)
    operator = Simulated(0, [Intention("can")], human=human)
    pressed = []
    for k in range(500 * 20):
        sample = operator.read(stuck_view(k))
        if sample is not None and sample.trigger:
            pressed.append(sample.stamp)
    # The trigger comes only after the first aim and two others were abandoned.
    assert pressed[0] > 3 * human.patience
