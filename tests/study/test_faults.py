"""The fault test: it finds what is wrong, a run can be repeated, and a part of it is run here."""

import json
from pathlib import Path

import numpy as np
import pytest

from optsc.cli import main
from optsc.control.controller import SharedController
from optsc.control.modes import Mode
from optsc.control.status import Status
from optsc.errors import InvalidValue, UnknownName
from optsc.study.faults.arms import ARMS, FOREIGN, arm
from optsc.study.faults.bench import MODES, Case, CaseResult, FaultTest, Worlds, bench, outcome, seed_of
from optsc.study.faults.catalogue import FAULTS, chosen
from optsc.study.faults.check import problems
from optsc.study.faults.fault import (
    FROM_THEN_ON,
    KINDS,
    ONCE,
    Fault,
    Injection,
    everywhere,
    goes_on,
    goes_on_everywhere,
    holds,
    is_safe,
    rests,
    stays_in_hold,
    stops,
)
from optsc.study.faults.run import run
from optsc.study.faults.world import World

NOTHING = Fault("nothing", "calls", ONCE, lambda *_: Injection(), goes_on_everywhere())


@pytest.fixture(scope="module")
def worlds():
    return Worlds(250.0)


@pytest.fixture(scope="module")
def world(worlds):
    return worlds.of("panda", NOTHING)


def found(world, mode, fault=NOTHING, seed=(0,)):
    return problems(world.robot, world.period, run(world, mode, fault, seed))


def test_there_are_at_least_ninety_faults_of_every_kind_each_in_at_least_seven_modes():
    everywhere_possible = [fault for fault in FAULTS.values() if len(fault.modes) >= 7]
    assert len(everywhere_possible) >= 90
    assert {fault.kind for fault in FAULTS.values()} <= set(KINDS)
    assert len(MODES) >= 7


@pytest.mark.parametrize("mode", [Mode(name) for name in MODES])
def test_without_a_fault_every_mode_goes_on_and_the_operator_can_take_over(world, mode):
    assert found(world, mode) == []


def test_the_foreign_arm_has_endless_joints_and_carries_the_hand():
    robot = arm(FOREIGN)
    assert robot.n == 6
    assert np.count_nonzero(~robot.limits.bounded) == 3
    assert robot.gripper is not None
    assert FOREIGN in ARMS


def raising(step, controller):
    raise ZeroDivisionError


DAMAGE = {
    "raised": raising,
    "continuity": lambda step, _: step._replace(command=step.command._replace(q=step.command.q + 1e-6)),
    "velocity": lambda step, c: step._replace(command=step.command._replace(v=1.01 * c.robot.limits.velocity)),
    "acceleration": lambda step, c: step._replace(command=step.command._replace(a=1.01 * c.robot.limits.acceleration)),
    "position": lambda step, c: step._replace(command=step.command._replace(q=c.robot.limits.upper + 1e-6)),
    "not finite": lambda step, _: step._replace(command=step.command._replace(v=np.nan * step.command.v)),
    "cannot be led on": lambda step, _: step._replace(mode=Mode.HOLD),
}


@pytest.mark.parametrize("what", DAMAGE)
def test_whatever_a_controller_breaks_is_found(world, what, monkeypatch):
    genuine, ticks = SharedController.step, []

    def damaged(controller, *arguments, **options):
        step = genuine(controller, *arguments, **options)
        ticks.append(step)
        return DAMAGE[what](step, controller) if len(ticks) > 100 else step

    monkeypatch.setattr(SharedController, "step", damaged)
    assert any(what in problem for problem in found(world, Mode.MANUAL))


def test_jerk_that_is_too_large_is_found(monkeypatch):
    world = World("panda", 500.0)
    genuine, ticks = SharedController.step, []

    def jerky(controller, *arguments, **options):
        step = genuine(controller, *arguments, **options)
        ticks.append(step)
        a = 0.9 * (-1.0) ** len(ticks) * controller.robot.limits.acceleration
        return step._replace(command=step.command._replace(a=a))

    monkeypatch.setattr(SharedController, "step", jerky)
    assert any("jerk" in problem for problem in found(world, Mode.MANUAL))


def test_following_that_is_not_true_is_found(world, monkeypatch):
    genuine = SharedController.step

    def boastful(controller, *arguments, **options):
        step = genuine(controller, *arguments, **options)
        return step._replace(command=step.command._replace(status=Status.FOLLOWING, reason=""))

    monkeypatch.setattr(SharedController, "step", boastful)
    gone = Fault("gone", "operator", FROM_THEN_ON, lambda *_: Injection(hand=lambda *_: None), everywhere(is_safe()))
    assert any(problem.startswith("following at rest") for problem in found(world, Mode.MANUAL, gone))


def test_finished_with_nothing_in_the_jaws_is_found(world, monkeypatch):
    monkeypatch.setattr(SharedController, "finished", True)
    empty = Fault(
        "empty",
        "jaws",
        FROM_THEN_ON,
        lambda *_: Injection(start=lambda world: world.arm.change(width=0.0)),
        everywhere(is_safe()),
    )
    assert any(problem.startswith("finished with nothing") for problem in found(world, Mode.CARRY, empty))


def silent(_, __):
    return Injection(hand=lambda *_: None)


@pytest.mark.parametrize(
    ("mode", "answer"),
    [
        (Mode.MANUAL, goes_on()),
        (Mode.MANUAL, holds()),
        (Mode.APPROACH, goes_on()),
        (Mode.APPROACH, rests()),
        (Mode.APPROACH, stops("elephant")),
        (Mode.LIFT, holds("elephant")),
    ],
)
def test_an_answer_that_is_not_the_expected_one_is_found(world, mode, answer):
    assert found(world, mode, Fault("silence", "operator", FROM_THEN_ON, silent, everywhere(answer)))


def test_leaving_hold_where_it_must_not_be_left_is_found(world):
    assert any("leaves hold" in problem for problem in found(world, Mode.HOLD, expecting(stays_in_hold())))


def expecting(answer):
    return Fault("nothing", "calls", ONCE, lambda *_: Injection(), everywhere(answer))


def test_an_arm_that_jumps_is_found(world):
    def start(here):
        here.arm.change(sag=np.full(here.robot.n, 0.1))

    jump = Fault("jump", "reading", FROM_THEN_ON, lambda *_: Injection(start=start), everywhere(is_safe()))
    assert any("the arm jumped" in problem for problem in found(world, Mode.CARRY, jump))


def test_a_case_is_repeated_to_the_last_bit_in_another_world(world):
    fault = FAULTS["the hand trembles by 1 mm"]
    case = Case("panda", "manual", fault.name, 3, 250.0)
    first, again = (run(here, Mode.MANUAL, fault, seed_of(case)) for here in (world, World("panda", 250.0)))
    for a, b in zip(first.rows, again.rows, strict=True):
        assert a.step.command.q.tobytes() == b.step.command.q.tobytes()
    other = run(world, Mode.MANUAL, fault, seed_of(case._replace(seed=4)))
    assert other.rows[-1].step.command.q.tobytes() != first.rows[-1].step.command.q.tobytes()


def test_every_kind_and_word_chooses_faults_and_an_unknown_one_is_refused():
    assert len(chosen(None)) == len(FAULTS)
    assert {fault.kind for fault in chosen(["jaws"])} == {"jaws"}
    assert chosen(["the QP solver raises"]) == (FAULTS["the QP solver raises"],)
    with pytest.raises(UnknownName, match="fault"):
        chosen(["elephant"])


def test_arms_modes_rates_and_seeds_that_are_none_are_refused():
    with pytest.raises(UnknownName, match="arm"):
        bench(arms=["elephant"])
    with pytest.raises(UnknownName, match="mode"):
        bench(modes=["sleeping"])
    with pytest.raises(InvalidValue, match="seed"):
        bench(seed=-1)
    with pytest.raises(InvalidValue, match="rate"):
        bench(rate=0.0)
    with pytest.raises(InvalidValue, match="at least one"):
        bench([])


def test_the_table_counts_runs_and_failures_by_kind_and_mode():
    case = Case("panda", "manual", "some", 0, 250.0)
    test = FaultTest([CaseResult(case, "clock", "goes on", ()), CaseResult(case, "clock", "goes on", ("raised it",))])
    assert test.table() == {"clock": {"manual": (2, 1)}}
    assert not test.passed
    assert not FaultTest().passed
    summary = test.summary()
    assert (summary["runs"], summary["failed"], summary["exceptions"], summary["untrue"]) == (2, 1, 1, 0)
    assert "--seed 0" in summary["failures"][0]["again"]
    assert FaultTest(test.outcomes[:1]).passed


def test_the_command_writes_a_summary_and_its_exit_code_tells_whether_all_passed(tmp_path, capsys, monkeypatch):
    common = ["bench", "faults", "--arms", "panda", "--modes", "carry", "--seed", "2"]
    assert main([*common, "--faults", "the scene again", "--output", str(tmp_path)]) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["passed"]
    assert summary["table"] == {"calls": {"carry": {"runs": 1, "failed": 0}}}
    monkeypatch.setattr("optsc.study.faults.bench.problems", lambda *_: ["raised an elephant"])
    assert main([*common, "--faults", "resetting to a joint too few"]) == 1
    assert "raised an elephant" in capsys.readouterr().out


def test_the_page_of_faults_is_the_one_that_the_command_writes(tmp_path):
    page = tmp_path / "faults.md"
    assert main(["bench", "faults", "--page", str(page)]) == 0
    assert page.read_text() == (Path(__file__).parents[2] / "docs" / "faults.md").read_text()


def sampled(per_kind=3, modes=1):
    """Draw some faults of every kind, and the modes to do each in."""
    rng = np.random.default_rng(0)
    for kind in KINDS:
        names = [name for name, fault in FAULTS.items() if fault.kind == kind]
        for name in sorted(rng.choice(names, min(per_kind, len(names)), replace=False)):
            possible = [mode.value for mode in FAULTS[name].modes if mode.value in MODES]
            for mode in sorted(rng.choice(possible, min(modes, len(possible)), replace=False)):
                yield str(name), str(mode)


@pytest.mark.parametrize(("name", "mode"), list(sampled()))
def test_a_fault_is_answered_as_it_was_written_down_beforehand(worlds, name, mode):
    found = outcome(worlds, Case("panda", mode, name, 0, 250.0))
    assert found.problems == (), found.case.command
