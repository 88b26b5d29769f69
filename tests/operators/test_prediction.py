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
    rng, settings = np.random.default_rng(0), PredictionSettings(alpha=0.5)
    track, out = at_rest((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), 0.0), []
    noise = rng.normal(size=(500, 3)) * 1e-3
    for k, n in enumerate(noise, 1):
        track = updated(settings, track, tuple(n), (1.0, 0.0, 0.0, 0.0), k / 90)
        out.append(track.p)
    assert np.std(out) < 0.8 * np.std(noise)


def test_a_long_gap_starts_afresh_at_rest():
    settings = PredictionSettings()
    track = updated(settings, at_rest((0.0,) * 3, (1.0, 0, 0, 0), 0.0), (0.01, 0, 0), (1.0, 0, 0, 0), 0.01)
    assert track.v[0] > 0
    late = updated(settings, track, (5.0, 0, 0), (1.0, 0, 0, 0), 1.0)
    assert late.v == (0.0, 0.0, 0.0)
    assert late.p == (5.0, 0, 0)


def test_a_clock_that_stands_still_gives_no_speed():
    settings = PredictionSettings()
    track = updated(settings, at_rest((0.0,) * 3, (1.0, 0, 0, 0), 1.0), (0.5, 0, 0), (1.0, 0, 0, 0), 1.0)
    assert track.v == (0.0, 0.0, 0.0)


def test_impossible_settings_are_refused():
    for wrong in ({"alpha": 0.0}, {"alpha": 1.1}, {"horizon": -1.0}):
        with pytest.raises(InvalidValue):
            PredictionSettings(**wrong)
