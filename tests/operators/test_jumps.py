"""A jump is not a wish: what no hand does neither moves nor turns the tool, and hands are not taken for jumps."""

import numpy as np
import pytest

from optsc.control.activities import Coupling
from optsc.geometry import rotation, scalar
from optsc.operators import ClutchSettings, HandRecording, Slerp
from optsc.operators.clutch import Hand
from optsc.operators.jumps import TrackedHand

RATES = (50.0, 90.0, 500.0)
REST = ((0.3, 0.1, 0.5), (1.0, 0.0, 0.0, 0.0))


class Hands:
    """A coupled hand at a rate, and the tool that it leads; what the tool turned is added up."""

    def __init__(self, rng, rate, settings=None):
        self.rate, self.rng = rate, rng
        # What fades, fades at once: the more a jump could turn.
        self.coupling = Coupling(settings or ClutchSettings(R_WS=tuple(rotation.random(rng)), slerp=Slerp(0.05, 1e3)))
        self.p, self.q = rng.uniform(-0.3, 0.3, 3), rotation.random(rng)
        self.tool = tuple(rng.uniform(-0.3, 0.3, 3)), tuple(rotation.random(rng))
        self.stamp, self.turned, self.reasons = 0.0, 0.0, []

    def sample(self, p=None, q=None):
        hand = Hand(tuple(self.p if p is None else p), tuple(self.q if q is None else q), self.stamp)
        before = self.tool[1]
        self.coupling, coupled = self.coupling.after(hand, self.tool, 0.1)
        self.tool = coupled.p, coupled.q
        self.turned += rotation.angle(before, coupled.q)
        self.reasons.append(coupled.reason)
        self.stamp += 1.0 / self.rate

    def rest(self, seconds, p=None, q=None):
        for _ in range(round(seconds * self.rate)):
            self.sample(p, q)

    def settle(self):
        """Wait until what engaging has left to fade is gone, and count from there."""
        self.rest(1.2)
        self.turned, self.at = 0.0, self.tool[0]

    def moved(self):
        return float(np.linalg.norm(np.subtract(self.tool[0], self.at)))


@pytest.mark.parametrize("rate", RATES)
def test_a_tracker_that_reports_identity_when_it_is_lost_does_not_turn_the_tool(rate):
    for seed in range(5):
        hands = Hands(np.random.default_rng(seed), rate)
        hands.settle()
        hands.rest(0.3, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
        hands.rest(2.0)
        assert sum("jumped" in reason for reason in hands.reasons) == 2
        assert hands.turned < 1e-6
        assert hands.moved() < 1e-9


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("degrees", [10.0, 30.0, 90.0, 150.0, 180.0])
def test_axes_that_jump_do_not_turn_the_tool(rate, degrees):
    for seed in range(3):
        rng = np.random.default_rng(seed)
        hands = Hands(rng, rate)
        hands.settle()
        axis = rotation.rotate(rotation.random(rng), [0.0, 0.0, 1.0])
        hands.q = rotation.multiply(rotation.exp(np.radians(degrees) * axis), hands.q)
        hands.rest(1.0)
        assert hands.turned < 1e-6
        assert hands.moved() < 1e-9


@pytest.mark.parametrize("rate", RATES)
def test_a_hand_that_comes_back_after_any_pause_turned_by_any_angle_turns_nothing(rate):
    rng = np.random.default_rng(7)
    for _ in range(8):
        hands = Hands(rng, rate)
        hands.settle()
        if rng.random() < 0.5:
            hands.coupling = hands.coupling.lost()
        hands.stamp += rng.uniform(0.11, 10.0)
        hands.q, hands.p = rotation.random(rng), rng.uniform(-0.3, 0.3, 3)
        hands.rest(1.0)
        assert hands.turned < 1e-6
        assert hands.moved() < 1e-9


@pytest.mark.parametrize("rate", RATES)
def test_after_a_jump_the_tool_turns_and_moves_as_the_hand_does(rate):
    rng = np.random.default_rng(8)
    for orientation in ("absolute", "relative"):
        hands = Hands(rng, rate, ClutchSettings(orientation=orientation, slerp=Slerp(0.05, 1e3)))
        hands.settle()
        hands.q = rotation.multiply(rotation.exp([0.0, 1.5, 0.0]), hands.q)
        hands.rest(1.0)
        before, start = np.array(hands.tool[1]), np.array(hands.tool[0])
        for _ in range(round(rate)):
            hands.q = rotation.multiply(rotation.exp([0.6 / rate, 0.0, 0.0]), hands.q)
            hands.p = hands.p + [0.2 / rate, 0.0, 0.0]
            hands.sample()
        turn = rotation.log(rotation.multiply(hands.tool[1], rotation.conjugate(before)))
        np.testing.assert_allclose(turn, [0.6, 0.0, 0.0], atol=1e-6)
        np.testing.assert_allclose(hands.tool[0] - start, [0.2, 0.0, 0.0], atol=1e-9)


def test_engaging_again_lets_the_offset_of_a_jump_fade():
    rng = np.random.default_rng(9)
    hands = Hands(rng, 90.0)
    hands.settle()
    hands.q = rotation.multiply(rotation.exp([0.0, 1.5, 0.0]), hands.q)
    hands.rest(0.5)
    assert hands.turned < 1e-6
    hands.coupling = hands.coupling.released()
    hands.rest(1.2)
    expected = rotation.multiply(hands.coupling.settings.R_WS, hands.q)
    assert rotation.angle(hands.tool[1], expected) < 1e-6


def test_the_papers_filter_goes_on_after_a_jump_without_turning_the_tool():
    hands = Hands(np.random.default_rng(10), 90.0, ClutchSettings(slerp=Slerp.paper(0.1, 90.0)))
    hands.settle()
    hands.q = rotation.multiply(rotation.exp([0.0, 1.5, 0.0]), hands.q)
    hands.rest(1.0)
    assert hands.turned < 1e-6


@pytest.mark.parametrize(("shift", "turn"), [(0.08, 0.0), (0.0, np.radians(30.0)), (0.02, 0.0), (0.0, 0.07)])
def test_what_no_hand_can_do_between_two_quick_samples_is_a_jump(shift, turn):
    hand = TrackedHand(Hand(*REST, 1.0), interval=0.002)
    q = tuple(rotation.exp([turn, 0.0, 0.0]))
    after = Hand((REST[0][0] + shift, REST[0][1], REST[0][2]), q, 1.002)
    assert hand.jumps(ClutchSettings(), after)
    assert not hand.jumps(ClutchSettings(), after._replace(stamp=1.05)) or max(shift, turn) > 0.5


@pytest.mark.parametrize("rate", [*RATES, 1000.0])
def test_a_quick_trembling_hand_with_irregular_samples_is_no_jump(rate):
    rng = np.random.default_rng(11)
    settings = ClutchSettings()
    for _ in range(5):
        speed, turning = rng.uniform(0.5, 1.5), rng.uniform(1.0, 5.0)
        frequency = rng.uniform(0.5, 3.0)
        true = np.arange(0.0, 4.0, 1.0 / rate)
        # Samples come in bunches: their stamps say little of how far they are apart.
        stamps = np.maximum.accumulate(true + rng.uniform(0.0, 2.0, len(true)) / rate)
        hand = None
        for t, stamp in zip(true, stamps, strict=True):
            p = np.array([speed * np.sin(2 * np.pi * frequency * t) / (2 * np.pi * frequency), 0.0, 0.0])
            angle = turning * np.sin(2 * np.pi * frequency * t) / (2 * np.pi * frequency)
            q = rotation.exp(np.array([angle, 0.0, 0.0]) + 2e-3 * rng.normal(size=3))
            sample = Hand(tuple(p + 3e-4 * rng.normal(size=3)), tuple(q), float(stamp))
            assert hand is None or not hand.jumps(settings, sample)
            hand = TrackedHand(sample) if hand is None else hand.after(sample)


def test_of_two_thousand_samples_of_a_quick_hand_only_a_leap_of_its_tracker_is_a_jump():
    """It turns by 15 degrees within one period of 20 ms, and at less than half that speed before and after."""
    recording = HandRecording.example()
    settings, hand, jumps = ClutchSettings(), None, []
    for stamp, p, q in zip(recording.time, recording.X_SH.translation, recording.X_SH.quaternion, strict=True):
        sample = Hand(tuple(p.tolist()), scalar.normalised(tuple(q.tolist())), float(stamp))
        if hand is not None and hand.jumps(settings, sample):
            jumps.append(scalar.angle(scalar.multiply(sample.q, scalar.conjugate(hand.hand.q))))
            hand = None
        hand = TrackedHand(sample) if hand is None else hand.after(sample)
    assert len(jumps) == 1
    assert jumps[0] > 0.26
