import math
from itertools import pairwise

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import rotation
from optsc.metrics import (
    angular_velocity,
    dimensionless_jerk,
    log_dimensionless_jerk,
    movement_window,
    moving_stretches,
    resample,
    sparc,
)


def bell():
    """The example of the measures' authors: a Gaussian speed profile at 100 Hz."""
    return np.exp(-5.0 * (np.arange(200) / 100.0 - 1.0) ** 2)


def minimum_jerk_speed(rate, duration=1.0):
    s = np.arange(round(duration * rate)) / (duration * rate)
    return 30.0 * s**2 * (1.0 - s) ** 2 / duration


def minimum_jerk_position(rate):
    s = np.arange(rate) / rate
    return 10 * s**3 - 15 * s**4 + 6 * s**5


def test_the_authors_example_has_the_authors_numbers():
    assert sparc(bell(), 100.0) == pytest.approx(-1.41403, abs=1e-5)
    assert dimensionless_jerk(bell(), 100.0) == pytest.approx(-335.74684, abs=1e-5)
    assert log_dimensionless_jerk(bell(), 100.0) == pytest.approx(-5.81636, abs=1e-5)


@pytest.mark.parametrize(("rate", "arc", "jerk"), [(100, -1.4058, -5.224), (500, -1.4024, -5.302)])
def test_a_minimum_jerk_movement_has_its_known_smoothness(rate, arc, jerk):
    assert sparc(minimum_jerk_speed(rate), rate) == pytest.approx(arc, abs=5e-5)
    assert log_dimensionless_jerk(minimum_jerk_speed(rate), rate) == pytest.approx(jerk, abs=5e-4)


def test_the_time_enters_to_the_third_power():
    assert dimensionless_jerk(minimum_jerk_speed(100), 100) == pytest.approx(-185.7012, abs=1e-4)


def test_a_finely_sampled_minimum_jerk_movement_tends_to_the_continuous_value():
    assert dimensionless_jerk(minimum_jerk_speed(20000), 20000) == pytest.approx(-204.8, rel=1e-3)
    assert log_dimensionless_jerk(minimum_jerk_position(5000), 5000, "position") == pytest.approx(-5.322, abs=5e-3)


def test_smoothness_depends_on_neither_the_size_nor_the_speed_of_a_movement():
    v = minimum_jerk_speed(400)
    slow = minimum_jerk_speed(100, duration=4.0)
    assert log_dimensionless_jerk(7.0 * v, 400) == pytest.approx(log_dimensionless_jerk(v, 400))
    assert log_dimensionless_jerk(slow, 100) == pytest.approx(log_dimensionless_jerk(v, 400))
    assert sparc(7.0 * v, 400) == pytest.approx(sparc(v, 400))


def test_the_vector_form_along_a_line_equals_the_scalar_form():
    v = minimum_jerk_speed(200)
    along = np.outer(v, [0.6, 0.0, 0.8])
    assert log_dimensionless_jerk(along, 200) == pytest.approx(log_dimensionless_jerk(v, 200))
    p = np.outer(minimum_jerk_position(200), [0.6, 0.0, 0.8])
    assert log_dimensionless_jerk(p, 200, "position") == pytest.approx(
        log_dimensionless_jerk(minimum_jerk_position(200), 200, "position")
    )


def test_the_vector_form_does_not_depend_on_the_frame():
    rng = np.random.default_rng(0)
    v, q = np.cumsum(rng.normal(size=(100, 3)), axis=0), rotation.random(rng)
    assert dimensionless_jerk(rotation.rotate(q, v), 50.0) == pytest.approx(dimensionless_jerk(v, 50.0))


def test_a_corner_at_constant_speed_shows_in_the_vector_form_only():
    corner = np.zeros((200, 2))
    corner[:100, 0] = corner[100:, 1] = 0.1
    straight = np.tile([0.1, 0.0], (200, 1))
    assert sparc(np.linalg.norm(corner, axis=1), 100) == sparc(np.linalg.norm(straight, axis=1), 100)
    assert log_dimensionless_jerk(straight, 100) == math.inf
    assert log_dimensionless_jerk(corner, 100) < -10.0


def test_ripples_make_a_movement_less_smooth_by_every_measure():
    v = minimum_jerk_speed(200)
    rippled = v * (1.0 + 0.3 * np.sin(2 * np.pi * 6.0 * np.arange(200) / 200))
    assert sparc(rippled, 200) < sparc(v, 200) - 0.1
    assert log_dimensionless_jerk(rippled, 200) < log_dimensionless_jerk(v, 200) - 1.0
    x, y = np.cumsum(v) / 200, np.cumsum(rippled) / 200
    joints = np.outer(x, np.arange(1.0, 8.0))
    rippled_joints = np.outer(y, np.arange(1.0, 8.0))
    assert log_dimensionless_jerk(rippled_joints, 200, "position") < log_dimensionless_jerk(joints, 200, "position")


def test_a_pause_between_two_movements_is_seen_by_the_spectrum():
    v = minimum_jerk_speed(500)
    assert sparc(np.concatenate([v, np.zeros(250), v]), 500) == pytest.approx(-3.15, abs=5e-3)


def test_the_window_cuts_a_dwell_off_and_keeps_the_whole_movement():
    v = minimum_jerk_speed(500)
    dwelling = np.concatenate([np.zeros(300), v, np.zeros(700)])
    assert movement_window(dwelling) == slice(300, 801)
    bare = log_dimensionless_jerk(v, 500)
    assert log_dimensionless_jerk(dwelling[300:801], 500) == pytest.approx(bare, abs=0.1)
    assert log_dimensionless_jerk(dwelling, 500) < bare - 3.0


def test_the_window_leaves_a_trembling_rest_out():
    rng = np.random.default_rng(0)
    v = minimum_jerk_speed(500)
    dwelling = np.abs(np.concatenate([np.zeros(300), v, np.zeros(700)]) + rng.normal(0.0, 0.01, 1500))
    window = movement_window(dwelling)
    # Five per cent of the peak are reached after 6 % of the time.
    assert 300 <= window.start <= 335
    assert 765 <= window.stop <= 801


def test_stretches_of_motion_are_those_between_rests():
    v = minimum_jerk_speed(100)
    pause = np.zeros(50)
    found = moving_stretches(np.concatenate([pause, v, pause, 0.3 * v, v, pause]), 100.0)
    assert [(part.start, part.stop) for part in found] == [(50, 151), (200, 401)]
    assert moving_stretches(np.zeros(100), 100.0) == []
    assert moving_stretches([], 100.0) == []


def test_a_short_burst_is_no_movement_and_stretches_never_overlap():
    burst = np.concatenate([minimum_jerk_speed(100), np.zeros(40), np.full(5, 1.0), np.zeros(40)])
    assert moving_stretches(burst, 100.0) == [slice(0, 101)]
    valley = 1.0 + np.cos(np.linspace(0.0, 6.0 * np.pi, 900))
    found = moving_stretches(valley, 100.0, rest=0.1)
    assert len(found) == 4
    assert all(a.stop <= b.start for a, b in pairwise(found))


def test_a_hand_that_trembles_at_rest_is_no_movement():
    rng = np.random.default_rng(0)
    t = np.arange(600) / 100.0
    v = np.zeros((600, 3))
    v[100:200, 0] = v[350:450, 1] = 0.1 * minimum_jerk_speed(100)
    # Tremor of 0.2 mm at 10 Hz has speeds of 1.3 cm/s, seven per cent of the peak.
    v += 0.018 * np.sin(2 * np.pi * 10.0 * t + 1.0)[:, None] * [1.0, 0.0, 0.0] + rng.normal(0.0, 0.002, v.shape)
    found = moving_stretches(v, 100.0)
    assert len(found) == 2
    assert [part.start for part in found] == pytest.approx([100, 350], abs=12)
    assert [part.stop for part in found] == pytest.approx([200, 450], abs=12)


@pytest.mark.parametrize(("ramp", "published"), [(0.5, -11.6), (0.2, -13.4), (0.05, -16.2)])
def test_at_constant_speed_the_jerk_is_that_of_the_ramps(ramp, published):
    # 0.1 m/s for 4 s in all, a sample of rest before and after, at 100 Hz.
    t = np.arange(-1, 402) / 100.0
    v = 0.1 * np.clip(np.minimum(t, 4.0 - t) / ramp, 0.0, 1.0)
    found = log_dimensionless_jerk(v, 100.0)
    assert found == pytest.approx(published, abs=0.05)
    # Four kinks of the speed, each a jerk of v / ramp within one sample.
    assert found == pytest.approx(-math.log(4.0 * 100.0 * 4.03**3 / ramp**2), abs=1e-6)


def test_accelerations_have_a_measure_of_their_own():
    a = np.sin(2 * np.pi * np.arange(1000) / 1000)
    # One period of unit amplitude: peak 1, T = 1 s, integral of (2 pi cos)^2 = 2 pi^2.
    assert dimensionless_jerk(a, 1000.0, "acceleration") == pytest.approx(-2 * np.pi**2, rel=3e-3)


@pytest.mark.parametrize("measure", [sparc, dimensionless_jerk, log_dimensionless_jerk])
@pytest.mark.parametrize("speed", [[], [0.3], np.zeros(100)])
def test_no_movement_is_neither_smooth_nor_jerky(measure, speed):
    assert math.isnan(measure(speed, 100.0))


def test_nothing_moving_has_an_empty_window():
    assert movement_window(np.zeros(10)) == slice(0, 0)
    assert movement_window([]) == slice(0, 0)


@pytest.mark.parametrize("measure", [sparc, dimensionless_jerk, log_dimensionless_jerk])
def test_numbers_that_are_none_are_refused(measure):
    speed = bell()
    speed[17] = np.nan
    with pytest.raises(InvalidValue, match="row 17"):
        measure(speed, 100.0)
    with pytest.raises(InvalidValue, match="rate"):
        measure(bell(), 0.0)


def test_an_unknown_derivative_is_refused_with_the_known_ones():
    with pytest.raises(InvalidValue, match="position, velocity, acceleration"):
        dimensionless_jerk(bell(), 100.0, given="jerk")


def test_resampling_an_uneven_recording_recovers_its_smoothness():
    rng = np.random.default_rng(3)
    s = np.sort(np.concatenate([[0.0, 1.0], rng.random(150)]))
    p = np.outer(10 * s**3 - 15 * s**4 + 6 * s**5, [1.0, 2.0, 2.0])
    time, even = resample(4.0 + s, p, 100.0)
    assert time[0] == 4.0
    np.testing.assert_allclose(np.diff(time), 0.01, atol=1e-12)
    np.testing.assert_allclose(even[:, 0], 10 * (u := time - 4.0) ** 3 - 15 * u**4 + 6 * u**5, atol=1e-4)
    speed = np.linalg.norm(np.diff(even, axis=0), axis=1) * 100
    assert sparc(speed, 100.0) == pytest.approx(-1.40, abs=0.02)


def test_resampling_never_leaves_the_recording():
    for count in (1, 2, 3, 4, 9):
        t = np.linspace(0.0, 0.1 * (count - 1), count)
        time, x = resample(t, 3.0 * t, 10.0)
        np.testing.assert_allclose(time, t, atol=1e-12)
        np.testing.assert_allclose(x, 3.0 * t, atol=1e-12)
    assert resample([0.0, 1.0], [0.0, 1.0], 0.7)[0].tolist() == [0.0]


@pytest.mark.parametrize(("time", "values"), [([0.0, 0.0], [1.0, 2.0]), ([0.0], [1.0, 2.0]), ([], [])])
def test_times_that_do_not_increase_or_do_not_fit_are_refused(time, values):
    with pytest.raises(InvalidValue):
        resample(time, values, 10.0)


def test_angular_velocity_is_that_of_a_steady_turn_whatever_the_signs():
    w = np.array([0.3, -1.0, 0.5])
    q = rotation.multiply(rotation.exp(0.01 * np.arange(50)[:, None] * w), [0.5, 0.5, 0.5, 0.5])
    q[::2] *= -1.0
    np.testing.assert_allclose(angular_velocity(q, 100.0), np.tile(w, (49, 1)), atol=1e-9)
