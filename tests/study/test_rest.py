"""The rest test repeats each of its episodes alone, and tells an arm that rests from one that does not."""

import json

import pytest

from optsc.cli import main
from optsc.errors import InvalidValue, UnknownName
from optsc.study.rest import ARMS, KINDS, RULES, arm_of, rest, run_episode


def test_every_arm_has_limits_by_every_rule():
    for name in ARMS:
        own, slow = arm_of(name, "own"), arm_of(name, "slow")
        assert slow.n == own.n
        assert set(slow.limits.acceleration) == {2.0}
        assert set(slow.limits.jerk) == {100.0}


def test_an_episode_is_the_same_alone_as_among_others():
    among = rest(2, arms=["ur5"], rules=["default"]).episodes
    assert [e.kind for e in among] == list(KINDS[:2])
    assert run_episode(0, "ur5", "default", 1) == among[1]


def test_targets_inside_obstacles_end_blocked_or_on_the_target_and_at_rest():
    ended = run_episode(1, "panda", "own", KINDS.index("inside"))
    assert ended.at_rest
    assert ended.truthful


def test_an_arm_that_moves_or_says_what_is_not_fails():
    good = run_episode(0, "ur5", "own", 0)
    assert good.at_rest
    assert good.truthful
    assert not good._replace(fastest=0.02).at_rest
    assert not good._replace(status="FOLLOWING", distance=0.002).truthful
    assert not good._replace(status="LIMITED", distance=0.0, angle=0.0).truthful
    assert not good._replace(status="UNREACHABLE", distance=0.1, reason="").truthful


def test_the_command_writes_what_it_found(tmp_path, capsys):
    code = main(["bench", "rest", "--arms", "ur3", "--rules", "own", "--count", "1", "--output", str(tmp_path)])
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["episodes"] == 1
    assert code == (0 if summary["passed"] else 1)
    assert "1 episodes" in capsys.readouterr().out


def test_what_there_is_not_is_refused():
    for wrong in ({"arms": ["no arm"]}, {"rules": ["no rule"]}):
        with pytest.raises(UnknownName):
            rest(1, **wrong)
    with pytest.raises(InvalidValue):
        rest(0)
    assert len(RULES) == 3
