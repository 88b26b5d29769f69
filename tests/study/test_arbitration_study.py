"""The study of arbitration policies: what a row says, who is averaged, and user-defined policies."""

import pickle
import subprocess
import sys

import numpy as np
import pytest

from optsc.cli import main
from optsc.cli.study import BUILT_IN
from optsc.control.modes import Mode
from optsc.control.policies import POLICIES, Manual
from optsc.errors import DamagedFile, InvalidValue, Mismatch, UnknownName
from optsc.study.arbitration import (
    REPORTED,
    TIMES,
    PolicyCondition,
    do_policies,
    policy_condition,
    policy_conditions,
)
from optsc.study.arbitration_report import (
    JUMP_TITLES,
    MEASURE_TITLES,
    MODE_TITLES,
    SMOOTHNESS_TITLES,
    build,
    summary_of,
    text_table,
)
from optsc.study.cases import Cases
from optsc.study.loading import absolute, load_named
from optsc.study.outcomes import scene_means
from optsc.study.statistics import bootstrap
from optsc.study.sweep.runner import run_jobs
from optsc.study.sweep.store import RowStore

OWN = """
from dataclasses import dataclass

from optsc.control.arbitration import HAND_ALONE, Arbitration

MOST = 0.5


@dataclass(frozen=True)
class Mine(Arbitration):
    share: float = MOST
    name = "mine"

    def blend(self, moment):
        return HAND_ALONE._replace(share=helped(self.share))


def helped(share):
    return share


def quarter():
    return Mine(0.25)


half = Mine(0.5)
"""


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "policies_of_mine.py"
    path.write_text(OWN)
    return path


def row(scene, condition, *, robot="panda", person=0, success=True, **values):
    numbers = dict.fromkeys((*REPORTED, *TIMES), 1.0)
    labels = {"scene": scene, "condition": condition, "robot": robot, "person": "typical"}
    return {**numbers, **labels, "person_seed": person, "success": success, "whole_s": 8.0, **values}


def test_a_scene_counts_once_however_many_people_try_it():
    rows = [row("a", "manual", person=k, effort_m=x) for k, x in enumerate([1.0, 2.0, 6.0])]
    rows += [row("b", "manual", effort_m=5.0), row("b", "manual", person=1, effort_m=None)]
    found = scene_means(rows, ["effort_m", "success"])
    assert list(found[["scene", "rows", "effort_m"]].itertuples(index=False, name=None)) == [
        ("a", 3, 3.0),
        ("b", 2, 5.0),
    ]
    policy = summary_of(rows)["policies"]["manual"]
    assert (policy["cases"], policy["scenes"]) == (5, 2)
    assert policy["effort_m"].value == pytest.approx(4.0)
    assert (policy["effort_m"].low, policy["effort_m"].high) == (3.0, 5.0)


def test_differences_are_of_scenes_in_which_the_same_people_succeeded():
    rows = []
    for person, (a, b) in enumerate([(1.0, 3.0), (1.0, 5.0), (1.0, 90.0)]):
        rows += [row("a", "alternating", person=person, grasp_s=a)]
        rows += [row("a", "manual", person=person, grasp_s=b, success=b < 50.0)]
    rows += [row("b", "alternating", grasp_s=2.0), row("b", "manual", grasp_s=4.0)]
    rows += [row("c", "alternating", grasp_s=2.0), row("c", "manual", grasp_s=float("nan"))]
    time = summary_of(rows)["policies"]["manual"]["minus_alternating"]["grasp_s"]
    assert time["pairs"] == 2
    assert time["mean"].value == pytest.approx((3.0 + 2.0) / 2.0)


def test_success_is_a_share_of_scenes_with_wilson_s_interval_where_each_has_it_or_not():
    rows = [row(scene, "manual", success=scene != "a") for scene in "abcde" for _ in range(4)]
    found = summary_of(rows)["policies"]["manual"]["success"]
    assert found.value == pytest.approx(0.8)
    # Of 5 scenes, not of 20 runs: Wilson's interval for 4 of 5.
    assert (found.low, found.high) == pytest.approx((0.3755, 0.9638), abs=1e-4)
    halves = [row(scene, "manual", person=k, success=k == 0) for scene in "ab" for k in (0, 1)]
    assert summary_of(halves)["policies"]["manual"]["success"].value == 0.5


def test_arms_are_never_mixed(tmp_path):
    arms = {"panda": 1.0, "ur5": 3.0}
    rows = [
        row(f"{robot} {k}", name, robot=robot, effort_m=x, grasp_s=x, key="", success=False)
        for robot, x in arms.items()
        for name in ("alternating", "manual")
        for k in (1, 2)
    ]
    summary = summary_of(rows)
    assert "policies" not in summary
    for robot, x in arms.items():
        assert summary["robots"][robot]["policies"]["manual"]["effort_m"].value == x
    assert summary_of(rows[:4])["policies"] == summary["robots"]["panda"]["policies"]
    first = [line.split()[0] for line in text_table(rows).splitlines()]
    assert first == ["panda", "alternating", "manual", "ur5", "alternating", "manual"]
    page = build(rows, "a command").save(tmp_path).read_text()
    for title in ("Jumps at changes of mode, panda", "Time in each mode, ur5", "Smoothness, ur5"):
        assert title in page


def test_everything_that_is_reported_is_in_a_row():
    assert set(MEASURE_TITLES) | set(SMOOTHNESS_TITLES) | set(JUMP_TITLES) <= set(REPORTED)
    assert tuple(MODE_TITLES) == TIMES
    assert len(TIMES) == len(Mode)
    assert {"jump_target_distance_m", "jump_target_chord"} <= set(JUMP_TITLES)
    assert {"sparc_joint", "sparc_turn", "ldlj_turn"} <= set(SMOOTHNESS_TITLES)


@pytest.fixture(scope="module")
def computed(tmp_path_factory):
    """Rows of the paper's policy and of a user-defined one in one scene, from a worker process."""
    folder = tmp_path_factory.mktemp("arbitration")
    (folder / "policies_of_mine.py").write_text(OWN)
    conditions = policy_conditions(["alternating", f"{folder / 'policies_of_mine.py'}:quarter"])
    # A scene that both solve in seconds: where the jaws close in the last moment, rounding decides on success.
    jobs = Cases(scenes=1, seed=1, objects=2).policy_jobs(conditions)
    rows = run_jobs(jobs, RowStore(folder / "rows"), workers=1, work=do_policies)
    assert all(row["success"] and row["grasp_s"] < 10.0 for row in rows)
    return {row["condition"]: row for row in rows}


def test_a_user_defined_policy_is_computed_in_a_worker_process(computed):
    assert set(computed) == {"alternating", "mine"}
    assert computed["mine"]["effort_m"] > computed["alternating"]["effort_m"]


def test_a_row_has_the_time_in_every_mode_the_distance_at_the_hand_over_and_all_smoothness(computed):
    for r in computed.values():
        assert sum(r[name] for name in TIMES) == pytest.approx(r["whole_s"])
        assert 0.0 < r["moving_s"] < r["grasp_s"]
        assert r["stretches"] >= 1.0
        assert np.isfinite([r[name] for name in (*SMOOTHNESS_TITLES, *JUMP_TITLES)]).all()
    paper, mine = computed["alternating"], computed["mine"]
    assert paper["time_approach_s"] > 0.5
    assert mine["time_approach_s"] == 0.0
    # The robot is given the motion at the ready pose, the jaws at the grasp.
    assert 0.03 < paper["jump_target_distance_m"] < 0.4
    assert mine["jump_target_distance_m"] < 0.031


def test_a_class_a_function_and_a_policy_are_taken_by_name(own):
    found = [policy_condition(f"{own}:{name}") for name in ("Mine", "quarter", "half")]
    assert [condition.policy.share for condition in found] == [0.5, 0.25, 0.5]
    assert {condition.name for condition in found} == {"mine"}
    assert found[0].key == found[2].key != found[1].key
    assert policy_condition("optsc.control.policies:Manual").policy == Manual()
    with pytest.raises(InvalidValue, match="each once"):
        policy_conditions([f"{own}:Mine", f"{own}:quarter"])


def test_what_a_policy_says_and_what_it_calls_determines_its_rows(own):
    before = policy_condition(f"{own}:Mine").key
    assert policy_condition(f"{own}:Mine").key == before
    for old, new in (("return share", "return 0.5 * share"), ("MOST = 0.5", "MOST = 0.6")):
        own.write_text(OWN.replace(old, new))
        assert policy_condition(f"{own}:Mine").key != before
    own.write_text(OWN)
    assert policy_condition(f"{own}:Mine").key == before


def test_another_process_finds_the_policy_and_the_key_again(own, tmp_path, monkeypatch):
    monkeypatch.chdir(own.parent)
    condition = policy_condition(f"{own.name}:quarter")
    (job,) = Cases(scenes=1).policy_jobs([condition, PolicyCondition("manual", Manual())])
    path = tmp_path / "job.pkl"
    path.write_bytes(pickle.dumps(job))
    code = f"import pickle; job = pickle.load(open({str(path)!r}, 'rb')); print(*job.keys())"
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    done = subprocess.run([sys.executable, "-c", code], cwd=elsewhere, capture_output=True, text=True, check=True)
    assert done.stdout.split() == job.keys()
    own.write_text(OWN.replace("return share", "return 0.0"))
    with pytest.raises(Mismatch, match="quarter"):
        pickle.loads(path.read_bytes())


@pytest.mark.parametrize(
    ("text", "error", "answer"),
    [
        ("anarchy", UnknownName, "alternating.*FILE.py:NAME|FILE.py:NAME.*alternating"),
        ("missing.py:Mine", DamagedFile, "cannot be loaded"),
        ("no_such_module:Mine", DamagedFile, "cannot be loaded"),
        ("json:Mine", UnknownName, "loads"),
        ("json:JSONEncoder", InvalidValue, "it has no name, trigger"),
        ("json:loads", InvalidValue, "without arguments"),
        (":Mine", DamagedFile, "cannot be loaded"),
    ],
)
def test_a_word_that_names_no_policy_is_answered(text, error, answer, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=answer):
        policy_condition(text)


def test_a_file_that_cannot_be_read_as_python_is_named_and_not_kept(tmp_path):
    path = tmp_path / "broken.py"
    path.write_text("def (:\n")
    with pytest.raises(DamagedFile, match="broken"):
        load_named(f"{path}:anything")
    assert not [name for name in sys.modules if name.startswith("own_broken")]
    assert absolute("json:loads") == "json:loads"


def test_the_help_names_the_policies_that_are_built_in(capsys):
    assert set(BUILT_IN) == set(POLICIES)
    with pytest.raises(SystemExit):
        main(["study", "arbitration", "--help"])
    words = " ".join(capsys.readouterr().out.split())
    assert all(name in words for name in POLICIES)
    assert "FILE.py:NAME" in words


@pytest.mark.parametrize("statistic", ["mean", "median"])
def test_the_bootstrap_agrees_with_scipy_s(statistic):
    from scipy import stats

    x = np.random.default_rng(5).gamma(2.0, 1.0, 40)
    found = bootstrap(x, np.random.default_rng(0), median=statistic == "median")
    other = stats.bootstrap(
        (x,), getattr(np, statistic), n_resamples=20000, method="percentile", rng=np.random.default_rng(1)
    ).confidence_interval
    width = other.high - other.low
    assert found.value == pytest.approx(getattr(np, statistic)(x))
    assert (found.low, found.high) == pytest.approx((other.low, other.high), abs=0.05 * width)
