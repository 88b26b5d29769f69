"""The formulas of the arbitration policies, against values worked out separately."""

import numpy as np
import pytest

from optsc.control.approach import Approach
from optsc.control.arbitration import HAND_ALONE, Goal, GraspPose, Moment, Trigger, ramp, towards
from optsc.control.policies import (
    POLICIES,
    Alternating,
    Automatic,
    Continuous,
    Hindsight,
    LinearBlending,
    Manual,
    ProductOfExperts,
    VirtualFixture,
    make_policy,
)
from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import rotation

I4 = (1.0, 0.0, 0.0, 0.0)
APPROACH = Approach()


def goal(p, probability=1.0, q=I4, best=None, name="a"):
    return Goal(name, probability, GraspPose(tuple(p), tuple(q), 0), GraspPose(tuple(best or p), tuple(q), 1))


def moment(*goals, hand=(0,) * 6, gap=1.0, last=HAND_ALONE, period=10.0):
    return Moment((0, 0, 0), I4, np.array(hand, dtype=float), goals, gap, last, period, APPROACH)


def carried_out(policy, now):
    blend = policy.blend(now)
    return blend.hand @ now.hand + blend.robot


HAND = (0.02, -0.05, 0.01, 0.1, 0.0, -0.2)


def test_towards_goes_straight_at_the_approachs_speed_and_slows_down_at_the_end():
    q = tuple(rotation.exp([0.0, 0.0, 0.1]))
    far, near = GraspPose((0.3, 0, 0.4), q, 0), GraspPose((0.003, 0, 0), I4, 0)
    np.testing.assert_allclose(towards(moment(), far)[:3], [0.06, 0, 0.08])
    # Half a metre takes 5 s, and so does the turn.
    np.testing.assert_allclose(towards(moment(), far)[3:], [0, 0, 0.02])
    np.testing.assert_allclose(towards(moment(), near)[:3], [0.01, 0, 0])


def test_the_ramp_has_two_ends_and_is_a_step_where_they_meet():
    assert [ramp(x, 0.4, 0.8) for x in (0.0, 0.4, 0.5, 0.8, 1.0)] == pytest.approx([0, 0, 0.25, 1, 1])
    assert [ramp(x, 0.4, 0.4) for x in (0.4, 0.41)] == [0.0, 1.0]


@pytest.mark.parametrize(("gap", "alpha"), [(0.3, 0.0), (0.4, 0.0), (0.6, 0.3), (0.8, 0.6), (1.0, 0.6)])
def test_linear_blending_weighs_both_wishes_by_the_confidence(gap, alpha):
    now = moment(goal((1, 0, 0), 0.9), goal((0, 1, 0), 0.1, name="b"), hand=HAND, gap=gap)
    u_r = np.array([0.1, 0, 0, 0, 0, 0])
    expected = (1 - alpha) * np.array(HAND) + alpha * u_r
    np.testing.assert_allclose(carried_out(LinearBlending(), now), expected, atol=1e-12)
    assert LinearBlending().blend(now).share == pytest.approx(alpha)


def test_the_confidence_of_linear_blending_changes_no_quicker_than_its_rate():
    now = moment(goal((1, 0, 0)), period=0.002)
    first = LinearBlending(rate=2.0).blend(now)
    assert first.share == pytest.approx(0.004)
    assert LinearBlending(rate=2.0).blend(now._replace(last=first)).share == pytest.approx(0.008)


def test_continuous_blending_goes_to_the_grasp_of_greatest_manipulability_and_helps_more_when_near():
    now = moment(goal((0.1, 0, 0), best=(0, 0.15, 0)), hand=HAND)
    # Half of the reach away: alpha is half of 0.6.
    expected = 0.7 * np.array(HAND) + 0.3 * np.array([0, 0.1, 0, 0, 0, 0])
    np.testing.assert_allclose(carried_out(Continuous(), now), expected, atol=1e-12)
    assert Continuous().blend(moment(goal((0.1, 0, 0), best=(0, 0.4, 0)))).share == 0.0


def test_hindsight_adds_the_expected_descent_of_the_cost_to_go():
    turn = tuple(rotation.exp([0.0, 0.0, 1.0]))
    now = moment(goal((0.5, 0, 0), 0.7, turn), goal((0, 0.05, 0), 0.3, name="b"), hand=HAND)
    # 2.45 / 40 far away; (2.25 * 0.05 / 0.07 + 0.2) / 40 at 5 cm; 0.07 * 0.21 / 0.05 about z.
    r = [0.7 * 0.06125, 0.3 * (2.25 * 0.05 / 0.07 + 0.2) / 40, 0, 0, 0, 0.7 * 0.294]
    np.testing.assert_allclose(carried_out(Hindsight(), now), np.array(HAND) + r, atol=1e-12)


def test_hindsight_falls_to_zero_at_a_grasp():
    slope = (2.25 * 0.01 / 0.07 + 0.2) / 40
    np.testing.assert_allclose(Hindsight().blend(moment(goal((0.01, 0, 0)))).robot[0], 0.5 * slope)
    assert not Hindsight().blend(moment(goal((0, 0, 0)))).robot.any()


def test_hindsight_cancels_between_two_equal_grasps():
    now = moment(goal((0.2, 0, 0), 0.5), goal((-0.2, 0, 0), 0.5, name="b"))
    np.testing.assert_allclose(Hindsight().blend(now).robot, 0.0, atol=1e-15)


def test_the_product_of_experts_is_the_most_likely_velocity():
    policy = ProductOfExperts(hand=(0.05, 0.25), across=(0.05, 0.25), along=(0.1, 0.5))
    now = moment(goal((1, 0, 0)), hand=HAND)
    # Along the way the hand's precision 400 meets the goal's 100, across it 400; without a turn, 16 meets 16.
    u = [(400 * 0.02 + 100 * 0.1) / 500, -0.025, 0.005, 0.05, 0.0, -0.1]
    np.testing.assert_allclose(carried_out(policy, now), u, atol=1e-12)


def test_experts_who_know_nothing_have_no_say():
    now = moment(goal((1, 0, 0), 0.5), goal((0, 1, 0), 0.5, name="b"), hand=HAND, gap=0.0)
    np.testing.assert_allclose(carried_out(ProductOfExperts(), now), HAND, atol=1e-12)


def test_linear_blending_is_a_product_of_experts_with_equal_precisions():
    # With both standard deviations the same along and across, alpha = Lambda_r / (Lambda_h + Lambda_r).
    policy = ProductOfExperts(hand=(0.1, 0.1), across=(0.05, 0.05), along=(0.05, 0.05))
    now = moment(goal((1, 0, 0)), hand=HAND)
    u_r = np.array([0.1, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(carried_out(policy, now), 0.2 * np.array(HAND) + 0.8 * u_r, atol=1e-12)


def test_the_fixture_lets_through_the_line_and_the_axis_to_the_grasp_and_a_share_of_the_rest():
    q = tuple(rotation.exp([0.0, 0.0, 1.0]))
    now = moment(goal((1, 0, 0), q=q), hand=HAND)
    expected = [0.02, 0.3 * -0.05, 0.3 * 0.01, 0.3 * 0.1, 0.0, -0.2]
    np.testing.assert_allclose(carried_out(VirtualFixture(k_tau=0.3), now), expected, atol=1e-12)
    assert not VirtualFixture().blend(now).robot.any()


def test_the_fixture_is_open_without_confidence_and_at_the_grasp_and_never_amplifies():
    np.testing.assert_allclose(VirtualFixture().blend(moment(goal((1, 0, 0)), gap=0.4)).hand, np.eye(6))
    np.testing.assert_allclose(VirtualFixture().blend(moment(goal((0, 0, 0)))).hand, np.eye(6))
    rng = np.random.default_rng(0)
    for _ in range(20):
        A = VirtualFixture(k_tau=0.0).blend(moment(goal(rng.normal(size=3), q=rotation.random(rng)))).hand
        assert np.linalg.norm(A, 2) <= 1 + 1e-12
        assert np.linalg.eigvalsh(A).min() >= -1e-12


@pytest.mark.parametrize("name", POLICIES)
def test_without_anything_in_reach_the_hand_is_alone(name):
    assert carried_out(make_policy(name), moment(hand=HAND, gap=0.0)) == pytest.approx(np.array(HAND))


def test_what_the_trigger_means_and_who_begins():
    hands_over = {name for name, policy in POLICIES.items() if policy.trigger is Trigger.HANDS_OVER}
    assert hands_over == {"alternating", "automatic"}
    assert {name for name, policy in POLICIES.items() if not policy.assists} == hands_over | {"manual"}
    assert Automatic(0.5).begins(0.5)
    assert not Automatic(0.5).begins(0.49)
    assert not Alternating().begins(1e9)
    assert not Manual().begins(1e9)


def test_an_unknown_policy_is_refused_with_the_names_there_are():
    with pytest.raises(UnknownName, match="hindsight"):
        make_policy("telepathy")


@pytest.mark.parametrize(
    ("policy", "bad"),
    [
        (LinearBlending, {"low": 0.9, "high": 0.8}),
        (LinearBlending, {"most": -0.1}),
        (LinearBlending, {"rate": 0.0}),
        (Continuous, {"reach": 0.0}),
        (Continuous, {"most": 1.1}),
        (Continuous, {"rate": -1.0}),
        (Hindsight, {"dampings": (40.0, 0.0)}),
        (ProductOfExperts, {"hand": (0.05,)}),
        (VirtualFixture, {"k_tau": 1.5}),
        (VirtualFixture, {"near": (0.0, 0.1)}),
        (VirtualFixture, {"low": -0.1}),
        (VirtualFixture, {"rate": 0.0}),
        (Automatic, {"dwell": -1.0}),
    ],
)
def test_settings_out_of_range_of_a_policy_are_refused(policy, bad):
    with pytest.raises(InvalidValue):
        policy(**bad)


@pytest.mark.parametrize("policy", [LinearBlending, VirtualFixture])
@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (0.0, 0.0), (0.5, 0.5), (1.0, 1.0)])
def test_the_lead_at_which_help_begins_may_be_anything_from_none_to_certain(policy, low, high):
    made = policy(low=low, high=high)
    assert (made.low, made.high) == (low, high)
