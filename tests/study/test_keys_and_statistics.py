import math
import subprocess
import sys

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.robot.manipulability import DEFINITIONS
from optsc.selection import Cascade, WeightedSum
from optsc.selection.costs import OrientationDistance, PositionDistance
from optsc.study.conditions import MANIPULABILITY_ONLY, PAPER, Condition, OperatorSpec
from optsc.study.fingerprint import canonical_json, fingerprint
from optsc.study.stability import perturbed
from optsc.study.statistics import (
    averages,
    bootstrap,
    kendall_tau,
    paired_difference,
    pareto_front,
    rank_biserial,
    share_interval,
)


def test_a_key_is_the_same_in_every_process():
    code = (
        "from optsc.study.conditions import PAPER, OperatorSpec; from optsc.study.fingerprint import fingerprint;"
        "print(PAPER.key, fingerprint(OperatorSpec('hasty', 3).describe()))"
    )
    found = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
        for _ in range(2)
    ]
    assert found[0] == found[1] == [PAPER.key, fingerprint(OperatorSpec("hasty", 3).describe())]


def test_whatever_changes_the_choice_changes_the_key_and_the_name_does_not():
    keys = {PAPER.with_measure(name).key for name in DEFINITIONS} | {MANIPULABILITY_ONLY.key}
    keys |= {Condition("", Cascade.paper(position=7)).key}
    weighted = [(OrientationDistance(), 1.0), (PositionDistance(), 0.5)]
    keys |= {
        Condition("", WeightedSum(tuple(weighted))).key,
        Condition("", WeightedSum(tuple(weighted[::-1]))).key,
    }
    assert len(keys) == len(DEFINITIONS) + 4
    assert Condition("other", PAPER.rule, about={"at": 1}).key == PAPER.key


def test_nothing_goes_into_a_key_by_its_address():
    with pytest.raises(InvalidValue, match="part of a fingerprint"):
        fingerprint(object())
    with pytest.raises(InvalidValue, match="finite"):
        fingerprint([math.nan])
    assert canonical_json({"b": 1, "a": np.float64(0.1)}) == '{"a":0.1,"b":1}'


def test_paired_differences_are_those_of_the_textbook():
    rng = np.random.default_rng(0)
    a, b = np.array([1.0, 2.0, 4.0, np.nan]), np.array([2.0, 2.0, 1.0, 5.0])
    found = paired_difference(a, b, rng)
    assert found.pairs == 3
    assert found.mean.value == pytest.approx(2 / 3)
    assert found.median.value == 0.0
    assert found.d_z == pytest.approx((2 / 3) / np.std([-1.0, 0.0, 3.0], ddof=1))
    assert (found.less, found.more) == pytest.approx((1 / 3, 1 / 3))
    # Ranks of |-1| and |3| are 1 and 2: (2 - 1) / 3.
    assert found.rank_biserial == pytest.approx(1 / 3)
    assert found.relative == pytest.approx((2 / 3) / (5 / 3))
    assert paired_difference([math.nan], [1.0], rng).pairs == 0


def test_the_bootstrap_interval_covers_the_mean_as_often_as_it_says():
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(200):
        found = bootstrap(rng.normal(1.0, 2.0, 60), rng)
        inside += found.low <= 1.0 <= found.high
    assert 0.88 <= inside / 200 <= 0.99


def test_the_bootstrap_interval_of_a_mean_is_the_normal_one_for_many_values():
    x = np.random.default_rng(2).normal(0.0, 1.0, 2000)
    found = bootstrap(x, np.random.default_rng(3))
    half = 1.96 * np.std(x) / math.sqrt(2000)
    assert found.low == pytest.approx(np.mean(x) - half, abs=0.1 * half)
    assert found.high == pytest.approx(np.mean(x) + half, abs=0.1 * half)


def test_repetitions_within_a_case_are_one_number_for_it():
    groups = ["a", "b", "a", "a", "c"]
    a, b = averages(groups, [1.0, 5.0, 3.0, 9.0, math.nan], [2.0, 6.0, 4.0, math.nan, 1.0])
    assert (a, b) == ([2.0, 5.0], [3.0, 6.0])
    with pytest.raises(InvalidValue, match="as many"):
        averages(groups, [1.0], [1.0])


def test_repeated_cases_do_not_make_the_interval_narrower():
    rng = np.random.default_rng(4)
    scenes = rng.normal(0.0, 1.0, 30)
    rows = np.repeat(scenes, 10) + rng.normal(0.0, 0.01, 300)
    x, y = averages(np.repeat(np.arange(30), 10).tolist(), rows.tolist(), [0.0] * 300)
    of_scenes = paired_difference(x, y, rng).mean
    of_rows = paired_difference(rows, np.zeros(300), rng).mean
    assert of_scenes.value == pytest.approx(of_rows.value)
    assert (of_scenes.high - of_scenes.low) > 2.5 * (of_rows.high - of_rows.low)


def test_rank_correlation_is_one_sided_when_all_differences_are():
    assert rank_biserial([0.1, 0.5, 2.0]) == 1.0
    assert rank_biserial([-0.1, -0.5, 0.0]) == -1.0
    assert rank_biserial([0.0]) == 0.0


def test_a_share_has_wilson_s_interval():
    # Wilson 1927 for 8 of 10 at 95 %.
    found = share_interval(8, 10)
    assert (found.low, found.high) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    assert share_interval(0, 10).low == 0.0
    assert math.isnan(share_interval(0, 0).value)


def test_the_front_is_what_nothing_beats():
    costs = np.array([[1.0, 4.0], [2.0, 2.0], [2.0, 2.0], [3.0, 2.0], [4.0, 1.0], [np.nan, 0.0]])
    assert pareto_front(costs).tolist() == [True, True, True, False, True, False]
    brute = np.random.default_rng(0).integers(0, 6, (60, 3)).astype(float)
    beaten = [any(np.all(r <= x) and np.any(r < x) for r in brute) for x in brute]
    assert (~pareto_front(brute)).tolist() == beaten


def test_kendall_s_tau_counts_exchanged_pairs():
    order = list(range(6))
    assert kendall_tau(order, order) == pytest.approx(1.0)
    assert kendall_tau(order, order[::-1]) == pytest.approx(-1.0)
    # One neighbouring exchange among 15 pairs.
    assert kendall_tau(order, [1, 0, 2, 3, 4, 5]) == pytest.approx(1 - 2 / 15)
    assert kendall_tau([0, 1, 9], [1, 0, 5]) == pytest.approx(-1.0)
    assert math.isnan(kendall_tau([1], [1]))


def test_a_perturbation_of_nothing_changes_nothing():
    rng = np.random.default_rng(0)
    weighted = WeightedSum(((OrientationDistance(), 1.0), (PositionDistance(), 0.5)))
    assert perturbed(weighted, 0.0, rng) == weighted
    assert perturbed(PAPER.rule, 0.0, rng) == PAPER.rule
    changed = perturbed(PAPER.rule, 0.5, rng)
    assert changed.steps[-1].keep == 1
    assert changed != PAPER.rule
