import json
import math

import numpy as np
import pytest

from optsc.cli import main
from optsc.control.servo import Servo
from optsc.errors import InvalidValue, UnknownName
from optsc.study import soak as soak_module
from optsc.study.soak import KINDS, STREAMS, run_episode, soak

POSES = tuple(name for name in STREAMS if name != "no pose")


def test_hostile_poses_break_no_limit_and_raise_nothing():
    result = soak(6000, seed=7, streams=POSES)
    assert result.ticks >= 6000
    assert result.summary()["violations"] == dict.fromkeys(KINDS, 0)
    assert result.exceptions == 0
    assert result.passed
    assert sum(result.statuses.values()) == result.ticks


@pytest.mark.parametrize("name", POSES)
def test_every_kind_of_input_alone_ends_in_commands_within_the_limits(name):
    episode = run_episode(1, 0, ("panda",), (name,))
    assert not episode.failed
    assert set(episode.about["streams"]) == {name}


def test_an_episode_is_a_pure_function_of_seed_and_number():
    first, again = run_episode(3, 4, streams=POSES), run_episode(3, 4, streams=POSES)
    assert first == again
    assert run_episode(3, 5, streams=POSES) != first


class Broken(Servo):
    """A servo whose commands leave something out of account, or that raises."""

    damage = ""

    def step(self, *arguments):
        command = super().step(*arguments)
        if self.damage == "exception":
            raise ZeroDivisionError("on purpose")
        if self.damage == "continuity":
            return command._replace(q=command.q + 1e-6 * (self.state.ticks % 2))
        if self.damage == "position":
            return command._replace(q=self.robot.limits.upper + 1e-6)
        if self.damage == "finite":
            return command._replace(v=command.v * math.nan)
        limit = getattr(self.robot.limits, "acceleration" if self.damage == "jerk" else self.damage)
        wrong = limit * (1.0 + 1e-6) if self.damage != "jerk" else limit * (-1.0) ** self.state.ticks
        return command._replace(**{"v" if self.damage == "velocity" else "a": wrong})


@pytest.mark.parametrize("damage", [*KINDS, "exception"])
def test_whatever_a_servo_breaks_is_found(monkeypatch, damage):
    monkeypatch.setattr(Broken, "damage", damage)
    monkeypatch.setattr(soak_module, "Servo", Broken)
    monkeypatch.setattr(soak_module, "_start", at_rest_inside)
    episode = run_episode(0, 0, ("panda",), ("silent",))
    assert episode.failed
    if damage == "exception":
        assert episode.exception == "ZeroDivisionError: on purpose"
    else:
        assert episode.violations[damage] > 0


def at_rest_inside(rng, robot):
    return soak_module._Start(robot.home, np.zeros(robot.n), True)


def test_the_command_line_counts_and_writes_its_summary(tmp_path, capsys):
    arguments = ["bench", "soak", "--seed", "2", "--robots", "ur5", "--streams", "moving", "silent"]
    assert main([*arguments, "--ticks", "500", "--output", str(tmp_path)]) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["passed"]
    assert summary["ticks"] >= 500
    assert summary["robots"] == ["ur5"]
    assert "violations: position 0" in capsys.readouterr().out
    assert main([*arguments, "--episode", "1"]) == 0
    assert "in 1 episodes" in capsys.readouterr().out


def test_a_failed_soak_says_how_to_repeat_it_and_has_another_exit_code(monkeypatch, capsys):
    monkeypatch.setattr(Broken, "damage", "finite")
    monkeypatch.setattr(soak_module, "Servo", Broken)
    assert main(["bench", "soak", "--ticks", "1", "--seed", "5", "--robots", "panda"]) == 1
    assert "--seed 5 --episode 0" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ({"ticks": 0}, InvalidValue),
        ({"ticks": 1, "seed": -1}, InvalidValue),
        ({"ticks": 1, "robots": ()}, InvalidValue),
        ({"ticks": 1, "streams": ()}, InvalidValue),
        ({"ticks": 1, "robots": ("abacus",)}, UnknownName),
        ({"ticks": 1, "streams": ("lullaby",)}, UnknownName),
    ],
)
def test_a_soak_that_cannot_be_run_is_refused(arguments, error):
    with pytest.raises(error):
        soak(**arguments)
