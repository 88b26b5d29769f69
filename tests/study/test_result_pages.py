"""Tables in the pages are those of the stored results, number by number."""

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results"
STUDY = (ROOT / "docs" / "study.md").read_text()


def results(name):
    return json.loads((RESULTS / f"{name}.json").read_text())


def estimate(three, digits, sign=""):
    mean, low, high = (f"{value:{sign}.{digits}f}" for value in three)
    return f"{mean} ({low} to {high})"


def test_the_table_of_the_papers_experiment_is_the_stored_one():
    for found in results("study_approach")["comparisons"]:
        d = found["differences"]
        cells = [f"{found['robot']}, {found['measure']}", d["path_length_m"]["pairs"]]
        cells += [estimate(d["path_length_m"]["mean"], 3, "+"), f"{100 * d['path_length_m']['less']:.0f} %"]
        cells += [
            estimate(d[name]["mean"], 2, "+") for name in ("duration_s", "rotation_rad", "ldlj_tool", "ldlj_joint")
        ]
        assert f"| {' | '.join(map(str, cells))} |" in STUDY


def test_no_interval_of_the_claim_touches_zero_as_the_page_says():
    for found in results("study_approach")["comparisons"]:
        for name in ("path_length_m", "duration_s", "rotation_rad", "ldlj_tool", "ldlj_joint"):
            _, low, high = found["differences"][name]["mean"]
            assert low * high > 0.0


def test_the_counts_of_failing_cases_are_the_stored_ones():
    stored = results("study_approach")
    assert f"{stored['failures']:,}".replace(",", " ") in STUDY
    for why in {*stored["reasons"]["panda"], *stored["reasons"]["ur5"]}:
        counts = [stored["reasons"][robot].get(why, 0) for robot in ("panda", "ur5")]
        assert f"| {why} | {counts[0]} | {counts[1]} |" in STUDY


@pytest.mark.parametrize("page", ["README.md", "benchmarks/README.md"])
def test_the_table_of_scenes_is_the_stored_one(page):
    text = (ROOT / page).read_text()
    stored = results("scenes")
    for name, digits in (
        ("path_length_m", 3),
        ("rotation_rad", 2),
        ("duration_s", 2),
        ("sparc", 2),
        ("ldlj", 2),
    ):
        found = stored["paired"][name]
        cells = [f"{found['paper_mean']:.{digits}f}", f"{found['manipulability_mean']:.{digits}f}"]
        cells += [
            estimate(found["difference_mean_low_high"], digits, "+"),
            f"{100 * found['paper_less']:.0f} %",
        ]
        assert f"| {' | '.join(cells)} |" in text
    lifted = [round(stored["lifted_share"][name] * stored["grasps"]) for name in ("paper", "manipulability")]
    said = re.search(r"lifted (\d+) of (\d+) under the paper's strategy and (\d+) of \d+", text)
    assert said is not None
    assert [int(number) for number in said.groups()] == [lifted[0], stored["grasps"], lifted[1]]


def test_the_table_of_policies_is_the_stored_one():
    for name, found in results("study_arbitration")["policies"].items():
        share = [f"{100 * value:.0f}" for value in found["success"]]
        cells = [name, f"{share[0]} % ({share[1]} to {share[2]})"]
        cells += [
            estimate(found[column], digits)
            for column, digits in (("grasp_s", 1), ("effort_m", 2), ("intervention", 2), ("path_length_m", 2))
        ]
        assert f"| {' | '.join(cells)} |" in STUDY
