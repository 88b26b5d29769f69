import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import rotation
from optsc.operators.clutch import ClutchSettings, Hand, recentred
from optsc.operators.jumps import TrackedHand
from optsc.operators.smoothing import Smoothing, begin, smoothed

RATE = 90.0


def literal_one_euro(x, rate, cutoff, slope, speed_cutoff):
    """The filter as its authors print it, for one number."""

    def alpha(fc):
        tau = 1 / (2 * np.pi * fc)
        return 1 / (1 + tau * rate)

    out, dx = [x[0]], 0.0
    for value in x[1:]:
        dx += alpha(speed_cutoff) * ((value - out[-1]) * rate - dx)
        a = alpha(cutoff + slope * abs(dx))
        out.append(a * value + (1 - a) * out[-1])
    return np.array(out)


def run(settings, p, q=None):
    hands = [Hand(tuple(p[k]), (1.0, 0.0, 0.0, 0.0) if q is None else tuple(q[k]), k / RATE) for k in range(len(p))]
    state = begin(hands[0])
    states = [state]
    for hand in hands[1:]:
        state = smoothed(settings, state, hand)
        states.append(state)
    return states


def test_it_is_the_published_filter_for_motion_along_one_axis():
    rng = np.random.default_rng(0)
    x = np.cumsum(rng.normal(size=300)) * 1e-3
    states = run(Smoothing(1.2, 7.0, 5.0, 0.9), np.outer(x, [1, 0, 0]))
    np.testing.assert_allclose([s.hand.p[0] for s in states], literal_one_euro(x, RATE, 1.2, 7.0, 0.9), atol=1e-12)


def test_rotations_about_one_axis_obey_the_same_law():
    rng = np.random.default_rng(1)
    x = np.cumsum(rng.normal(size=300)) * 1e-2
    states = run(Smoothing(1.2, 7.0, 5.0, 0.9), np.zeros((300, 3)), rotation.exp(np.outer(x, [0, 0, 1])))
    turned = [rotation.log(s.hand.q)[2] for s in states]
    np.testing.assert_allclose(turned, literal_one_euro(x, RATE, 1.2, 5.0, 0.9), atol=1e-9)


def test_a_low_pass_has_the_time_constant_that_is_asked_for():
    p = np.zeros((200, 3))
    p[1:, 0] = 1.0
    states = run(Smoothing.low_pass(0.2), p)
    reached = np.argmax([s.hand.p[0] > 1 - np.exp(-1) for s in states]) / RATE
    assert reached == pytest.approx(0.2, abs=2 / RATE)


def test_a_clock_that_stands_still_changes_nothing():
    state = begin(Hand((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), 1.0))
    assert smoothed(Smoothing(), state, Hand((1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), 1.0)) == state


def test_a_jump_is_told_from_a_motion():
    settings = ClutchSettings(R_WS=tuple(rotation.exp([0, 0, 1.0])))
    hand = Hand((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), 0.0)
    motion = TrackedHand(hand)
    later = hand._replace(stamp=0.03)
    assert not motion.jumps(settings, later._replace(p=(0.05, 0.0, 0.0)))
    assert motion.jumps(settings, later._replace(p=(0.5, 0.0, 0.0)))
    assert motion.jumps(settings, later._replace(q=tuple(rotation.exp([1.0, 0, 0]))))


def test_after_recentring_the_hand_heads_where_the_tool_does():
    rng = np.random.default_rng(2)
    for _ in range(20):
        settings = ClutchSettings(R_WS=tuple(rotation.random(rng)))
        tool = rotation.exp([0, 0, rng.uniform(-3, 3)])
        hand_q = rotation.multiply(rotation.conjugate(settings.R_WS), rotation.exp([0, 0, rng.uniform(-3, 3)]))
        new = recentred(settings, Hand((0, 0, 0), tuple(hand_q), 0.0), tuple(tool))
        assert rotation.angle(rotation.multiply(new.R_WS, hand_q), tool) < 1e-6


def test_impossible_settings_are_refused():
    for wrong in ({"cutoff": 0.0}, {"slope": -1.0}, {"speed_cutoff": np.nan}):
        with pytest.raises(InvalidValue):
            Smoothing(**wrong)
    with pytest.raises(InvalidValue):
        Smoothing.low_pass(0.0)
    with pytest.raises(InvalidValue):
        ClutchSettings(largest_step=(0.0, 1.0))
