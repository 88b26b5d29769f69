import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import rotation
from optsc.operators.prediction import PredictionSettings, at_rest, predicted, updated


def pose(t, v, w):
    return tuple(np.multiply(v, t)), tuple(rotation.exp(np.multiply(w, t)))


def test_a_steady_motion_is_predicted_exactly_once_it_is_known():
    settings, v, w = PredictionSettings(), (0.3, -0.1, 0.2), (0.5, 0.2, -1.0)
    track = at_rest(*pose(0.0, v, w), 0.0)
    for k in range(1, 60):
        track = updated(settings, track, *pose(k / 90, v, w), k / 90)
    p, q = predicted(track, 0.02)
    expected_p, expected_q = pose(59 / 90 + 0.02, v, w)
    np.testing.assert_allclose(p, expected_p, atol=1e-6)
    assert rotation.angle(q, expected_q) < 1e-4


def test_noise_is_smaller_after_the_filter_than_before():
    rng, settings = np.random.default_rng(0), PredictionSettings()
    track, out = at_rest((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), 0.0), []
    noise = rng.normal(size=(500, 3)) * 1e-3
    for k, n in enumerate(noise, 1):
        track = updated(settings, track, tuple(n), (1.0, 0.0, 0.0, 0.0), k / 90)
        out.append(track.p)
    assert np.std(out) < 0.8 * np.std(noise)


@pytest.mark.parametrize("rate", [50.0, 90.0, 1000.0])
def test_a_steady_acceleration_is_known_exactly_before_and_carried_on_after_the_newest_sample(rate):
    settings, a = PredictionSettings(), np.array([0.8, -0.3, 0.5])
    track = at_rest((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), 0.0)
    for k in range(1, int(rate)):
        p = 0.5 * a * (k / rate) ** 2
        track = updated(settings, track, tuple(p), (1.0, 0.0, 0.0, 0.0), k / rate)
    now = track.stamp
    np.testing.assert_allclose(predicted(track, -0.02)[0], 0.5 * a * (now - 0.02) ** 2, atol=1e-6)
    np.testing.assert_allclose(predicted(track, 0.01)[0], 0.5 * a * (now + 0.01) ** 2, atol=1e-5)


def test_the_estimate_is_the_quadratic_that_fits_all_samples_best_with_weights_that_fade():
    rng, settings, rate = np.random.default_rng(1), PredictionSettings(), 50.0
    y = 1e-2 * rng.normal(size=200)
    track = at_rest((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), 0.0)
    for k in range(1, 200):
        track = updated(settings, track, (y[k], 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), k / rate)
    t = (np.arange(200) - 199) / rate
    weight = np.exp(0.5 * t / settings.memory)  # the root of it: polyfit squares
    fit = np.polyfit(t, y, 2, w=weight)
    assert track.p[0] == pytest.approx(fit[2], rel=1e-6)
    assert track.v[0] == pytest.approx(fit[1], rel=1e-6)
    assert track.a[0] == pytest.approx(2 * fit[0], rel=1e-6)


def test_irregular_samples_are_followed_as_well_as_regular_ones():
    rng, settings, worst = np.random.default_rng(2), PredictionSettings(), []
    for irregular in (False, True):
        gaps = rng.uniform(0.001, 0.039, 500) if irregular else np.full(500, 0.02)
        track, off = at_rest((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), 0.0), []
        for t in np.cumsum(gaps):
            track = updated(settings, track, (0.05 * np.sin(8 * t), 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), t)
            off.append(abs(predicted(track, -0.02)[0][0] - 0.05 * np.sin(8 * (t - 0.02))))
        worst.append(np.sqrt(np.mean(np.square(off[25:]))))
    assert worst[1] < 1.5 * worst[0]
    assert worst[0] < 5e-4


def test_a_long_gap_starts_afresh_at_rest():
    settings = PredictionSettings()
    track = updated(settings, at_rest((0.0,) * 3, (1.0, 0, 0, 0), 0.0), (0.01, 0, 0), (1.0, 0, 0, 0), 0.01)
    assert track.v[0] > 0
    late = updated(settings, track, (5.0, 0, 0), (1.0, 0, 0, 0), 1.0)
    assert late.v == (0.0, 0.0, 0.0)
    assert late.p == (5.0, 0, 0)


def test_a_jump_starts_afresh_at_rest():
    settings, track = PredictionSettings(), at_rest((0.0,) * 3, (1.0, 0, 0, 0), 0.0)
    for far in (((0.15, 0, 0), (1.0, 0, 0, 0)), ((0.0, 0, 0), tuple(rotation.exp([0, 0, 0.7])))):
        after = updated(settings, track, *far, 0.02)
        assert after.p == far[0]
        assert after.v == after.w == after.a == (0.0, 0.0, 0.0)


def test_a_clock_that_stands_still_gives_no_speed():
    settings = PredictionSettings()
    track = updated(settings, at_rest((0.0,) * 3, (1.0, 0, 0, 0), 1.0), (0.5, 0, 0), (1.0, 0, 0, 0), 1.0)
    assert track.v == (0.0, 0.0, 0.0)


def test_impossible_settings_are_refused():
    for wrong in ({"memory": 0.0}, {"memory": np.nan}, {"horizon": -1.0}):
        with pytest.raises(InvalidValue):
            PredictionSettings(**wrong)
