"""A decision and a new scene are spread over ticks: what comes of it, when, and how much one tick may do."""

import pickle

import numpy as np
import pytest

from optsc import session
from optsc.control import deciding, path_search
from optsc.control.approach import Approach
from optsc.control.modes import Event, Mode
from optsc.control.path_feasibility import grasp_path_feasibility, most_feasible
from optsc.control.path_search import PathSearch, SearchScene, coarse_first
from optsc.control.policies import Automatic
from optsc.errors import InvalidValue
from optsc.followers import IdealFollower
from optsc.geometry import Pose
from optsc.operators import Button, OperatorSample
from optsc.records import RunInputs, SceneUpdate
from optsc.robot import load_robot
from optsc.selection import GraspSelector, table_build
from optsc.selection import selector as selector_module
from optsc.testing.loop import DOWN, PLACES, Loop, StraightOperator, controller, scene

TWO = {"left": (0.5, 0.25, 0.15), "right": (0.5, -0.25, 0.15)}


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


def random_places(rng):
    return {name: tuple(rng.uniform([0.3, -0.4, 0.05], [0.7, 0.4, 0.35])) for name in "abc"}


class Low:
    """A collision check: tools below a height touch something, and so do those in a wall beside the objects."""

    def __init__(self, robot, height, wall=np.inf):
        self.robot, self.height, self.wall, self.asked = robot, height, wall, []

    def _free(self, q):
        p = self.robot.forward(q).translation
        return (p[:, 2] > self.height) & (np.abs(p[:, 1] - self.wall) > 0.03)

    def __call__(self, q_grasp, q_pregrasp, candidates):
        self.asked.append(len(q_grasp))
        return self._free(q_grasp) & self._free(q_pregrasp)


class Screened(Low):
    """The same with a quick answer for tools that are far from it all."""

    def certainly_clear(self, q, hand_may_touch):
        self.asked.append(len(q))
        return self._free(q) & (self.robot.forward(q).translation[:, 2] > self.height + 0.1)

    def clear(self, q, hand_may_touch):
        self.asked.append(len(q))
        return self._free(q)


@pytest.mark.parametrize("check", [None, Low, Screened])
@pytest.mark.parametrize("seed", range(4))
def test_a_search_carried_to_its_end_finds_what_trying_path_after_path_does(robot, check, seed):
    rng = np.random.default_rng(seed)
    candidates = scene(random_places(rng), count=20, seed=seed)
    clear = None if check is None else check(robot, rng.uniform(0.0, 0.2), rng.uniform(-0.3, 0.3))
    q = robot.limits.clip(robot.home + rng.uniform(-0.2, 0.2, robot.n))
    X_WT, settings = robot.forward(q), Approach(speed=rng.choice([0.1, 0.7]), angular_speed=2.0)
    selector = GraspSelector(robot)
    selector.observe(candidates, q)
    ranking = selector.rank(X_WT, q)
    order = ranking.of(ranking.best).tolist()

    def tried(row):
        target = ranking.target_of(row)
        return grasp_path_feasibility(robot, settings, q, X_WT, target, candidates, clear)

    expected = most_feasible(order, tried)
    search, where = (
        PathSearch(X_WT, q, tuple(order)),
        SearchScene(robot, settings, candidates, clear, ranking.target_of),
    )
    pieces = 0
    while not search.over:
        search, pieces = path_search.advanced(search, where), pieces + 1
        assert pieces < 2000
    assert search.taken == expected


@pytest.mark.parametrize("count", [1, 2, 3, 7, 64, 139])
def test_the_coarse_order_holds_every_number_once_and_the_ends_first(count):
    order = coarse_first(count).tolist()
    assert sorted(order) == list(range(count))
    assert set(order[:2]) == {0, count - 1}


def pressed_after(robot, seed, real_time, rate=500.0):
    """A controller, at rest before a random scene, that the trigger was pressed at, and its steps until it decided."""
    rng = np.random.default_rng(seed)
    decides = controller(robot, real_time=real_time)
    q = robot.limits.clip(robot.home + rng.uniform(-0.15, 0.15, robot.n))
    decides.reset(q, rate)
    follower = IdealFollower(robot)
    measured = follower.reset(q)
    decides.observe(scene(random_places(rng), count=15, seed=seed))
    hand, steps, begun = Pose(DOWN, np.zeros(3)), [], None
    for k in range(round(1.0 * rate)):
        trigger = k >= round(0.8 * rate)
        sample = OperatorSample(decides.time, hand, True, trigger)
        step = decides.step(sample, measured)
        begun = step.time if trigger and begun is None else begun
        steps.append(step)
        measured = follower.apply(step.command.q, step.command.v, step.opening, 1.0 / rate)
        if trigger and (step.mode is Mode.APPROACH or step.reason):
            break
    return decides, steps, begun


@pytest.mark.parametrize("seed", range(6))
def test_a_decision_spread_over_ticks_is_the_one_that_is_made_at_once(robot, seed):
    """The hand rests, so that the moment is the same; no decision here needs more than the time that there is."""
    found = []
    for real_time in (True, False):
        _, steps, _ = pressed_after(robot, seed, real_time)
        last = steps[-1]
        found.append((last.mode, None if last.target is None else (last.target.candidate, last.target.half_turn)))
    assert found[0] == found[1]


@pytest.mark.parametrize("rate", [20.0, 125.0, 250.0, 333.0, 500.0, 1000.0])
def test_a_decision_is_made_within_20_ms_and_the_robot_moves_within_50_ms(robot, rate):
    decides, steps, begun = pressed_after(robot, 1, True, rate)
    assert steps[-1].event is Event.TRIGGERED
    assert steps[-1].time - begun <= deciding.DECISION_TIME + 1e-9
    start = np.concatenate(decides.servo.reference)
    follower = IdealFollower(robot).at(
        IdealFollower(robot).reset(steps[-1].command.q)._replace(q=steps[-1].command.q, v=steps[-1].command.v)
    )
    measured = follower.state()
    while decides.time <= begun + max(0.05, 1.5 / rate) + 1e-9:
        sample = OperatorSample(decides.time, Pose(DOWN, np.zeros(3)), True, True)
        step = decides.step(sample, measured)
        measured = follower.apply(step.command.q, step.command.v, step.opening, 1.0 / rate)
    assert np.abs(np.concatenate(decides.servo.reference) - start).max() > 1e-6


def test_a_decision_in_which_every_path_is_hard_to_judge_ends_in_time_with_the_best_that_was_found(robot):
    """All that is near the table is in doubt, and every path touches something at its end."""
    loop = Loop(robot, scene({"thing": (0.5, 0.0, 0.15)}, count=40))
    loop.go(0.1)
    state = loop.controller.state
    loop.controller.state = state._replace(choice=state.choice._replace(clear=Screened(robot, 0.161)))
    pressed = loop.time
    step = loop.press()
    assert step.time - pressed <= deciding.DECISION_TIME + 1e-9
    assert step.mode is Mode.APPROACH


def test_the_hand_goes_on_leading_while_it_is_decided(robot):
    loop = Loop(robot, scene(TWO))
    loop.go(0.4, move=(0.0, 0.08, 0.0))
    trigger = {"trigger": True}
    loop.go(0.002, move=(0.0, 4e-4, 0.0), **trigger)
    assert loop.controller.state.choice.deciding is not None
    assert loop.steps[-1].mode is Mode.MANUAL
    speeds = []
    while loop.controller.state.choice.deciding is not None:
        step = loop.go(0.002, move=(0.0, 4e-4, 0.0), **trigger)
        speeds.append(np.abs(step.command.v).max())
    assert len(speeds) > 1
    assert min(speeds) > 0.01


def test_who_lets_go_right_after_the_trigger_has_handed_over(robot):
    loop = Loop(robot, scene(TWO))
    loop.go(0.2)
    loop.tick(OperatorSample(loop.time, loop.hand, True, trigger=True))
    loop.go(0.1, clutch=False, trigger=True)
    assert loop.controller.mode is Mode.APPROACH


def test_opening_the_clutch_calls_off_what_the_robot_begins_by_itself(robot):
    loop = Loop(robot, scene(TWO), arbitration=Automatic(dwell=0.2))
    while loop.controller.state.choice.deciding is None:
        loop.tick(OperatorSample(loop.time, loop.hand))
    step = loop.tick(OperatorSample(loop.time, loop.hand, False))
    assert "clutch" in step.reason
    assert loop.controller.state.choice.deciding is None
    loop.go(0.2, clutch=False)
    assert loop.controller.mode is Mode.MANUAL


def test_pressing_again_while_it_is_decided_calls_it_off(robot):
    loop = Loop(robot, scene(TWO), debounce=0.0)
    loop.go(0.2)
    for trigger in (True, False, True):
        step = loop.tick(OperatorSample(loop.time, loop.hand, trigger=trigger))
    assert "again" in step.reason
    loop.go(0.1)
    assert loop.controller.mode is Mode.MANUAL


def test_what_is_vetoed_while_it_is_decided_is_not_taken(robot):
    loop = Loop(robot, scene({"thing": (0.45, 0.1, 0.25)}))
    loop.go(0.1)
    best = loop.controller.ranking.target()
    loop.tick(OperatorSample(loop.time, loop.hand, trigger=True))
    loop.tick(OperatorSample(loop.time, loop.hand, trigger=True, buttons=frozenset({Button.VETO})))
    loop.go(0.1)
    assert loop.controller.mode is Mode.MANUAL
    loop.go(0.1)
    assert loop.press().target.candidate != best.candidate


class Counted:
    """Counts rows and legs that are worked on, tick by tick."""

    def __init__(self, monkeypatch, loop):
        self.now, self.most = 0, 0
        solver = type(loop.controller.selector.solver)
        for owner, name, size in (
            (solver, "found", lambda a: len(a[2])),
            (solver, "judged", lambda a: len(a[2].rows)),
            (solver, "judged_again", lambda a: len(a[2])),
            (path_search, "path_rollout", lambda a: len(a[3][0]) * len(a[3])),
        ):
            self.count(monkeypatch, owner, name, size)

    def count(self, monkeypatch, owner, name, size):
        original = getattr(owner, name)

        def counting(*args, **kwargs):
            self.now += size(args)
            return original(*args, **kwargs)

        monkeypatch.setattr(owner, name, counting)

    def ticked(self):
        self.most, self.now = max(self.most, self.now), 0


def test_no_tick_does_more_than_the_counted_work(robot, monkeypatch):
    loop = Loop(robot, scene(count=60))
    counted, rng = Counted(monkeypatch, loop), np.random.default_rng(0)
    limit = max(
        selector_module.ROWS_AGAIN, table_build.ROWS_SOLVED, table_build.ROWS_JUDGED, path_search.LEGS_AT_ONCE + 2
    )
    loop.go(0.01)
    counted.now = 0
    for k in range(500):
        if k % 150 == 20:
            places = {name: tuple(np.array(p) + rng.uniform(-0.02, 0.02, 3)) for name, p in PLACES.items()}
            loop.controller.observe(scene(places, count=60))
        trigger = k % 250 > 200
        loop.go(0.002, move=1e-3 * rng.normal(size=3) + [0.0, 4e-4, 0.0], trigger=trigger)
        counted.ticked()
    assert 0 < counted.most <= limit


def test_a_table_solved_in_pieces_is_the_one_solved_at_once_to_the_last_bit(robot):
    rng = np.random.default_rng(3)
    selector, at_once = GraspSelector(robot), GraspSelector(robot)
    first, second = scene(random_places(rng), count=15), scene(random_places(rng), count=15, seed=5)
    q = robot.home + 0.05
    for one in (selector, at_once):
        one.observe(first, robot.home)
    selector.announce(second, q)
    assert selector.candidates is first
    pieces = 0
    while not selector.go_on(q):
        pieces += 1
    assert pieces > 10
    expected, table = at_once.observe(second, q), selector.table
    for name in ("q_grasp", "q_pregrasp", "status", "manipulability", "seed"):
        assert getattr(table, name).tobytes() == getattr(expected, name).tobytes(), name


def test_until_a_new_scene_is_ready_the_one_before_is_in_use_but_for_what_is_gone(robot):
    loop = Loop(robot, scene(TWO, count=40))
    loop.go(0.1)
    old = loop.controller.ranking
    assert old.of("left").size
    assert old.of("right").size
    now = {"left": TWO["left"], "right": (0.5, -0.2, 0.15)}
    loop.controller.observe(scene(now, count=40))
    loop.go(0.03)
    ranking = loop.controller.ranking
    assert ranking.decision.candidates is old.decision.candidates
    assert ranking.of("left").size
    assert not ranking.of("right").size
    assert "no longer there" in ranking.rejected_by
    loop.go(0.6)
    assert loop.controller.selector.candidates is not old.decision.candidates
    assert loop.controller.ranking.of("right").size


def test_scenes_that_come_faster_than_they_are_solved_do_not_keep_the_newest_out(robot):
    loop = Loop(robot, scene(TWO, count=40))
    loop.go(0.1)
    seen = {id(loop.controller.selector.candidates)}
    for k in range(12):
        now = {"left": TWO["left"], "right": (0.5, -0.25 + 0.002 * k, 0.15)}
        loop.controller.observe(scene(now, count=40))
        loop.go(0.06)
        seen.add(id(loop.controller.selector.candidates))
    assert len(seen) > 2
    loop.go(1.0)
    assert not loop.controller.selector.observing


def test_a_check_that_fails_later_leaves_the_scene_before_in_use_and_says_so(robot):
    loop = Loop(robot, scene(TWO, count=40))
    loop.go(0.1)
    before, calls = loop.controller.selector.candidates, []

    def clear(q_grasp, q_pregrasp, candidates):
        calls.append(len(q_grasp))
        if len(calls) > 3:
            raise RuntimeError("no more")
        return np.ones(len(q_grasp), dtype=bool)

    loop.controller.observe(scene({"left": TWO["left"], "right": (0.5, -0.2, 0.15)}, count=40), clear)
    start = len(loop.steps)
    loop.go(0.3)
    assert any("new scene cannot be used" in step.reason for step in loop.steps[start:])
    assert loop.controller.mode is Mode.MANUAL
    assert loop.controller.selector.candidates is before
    assert loop.controller.ranking.best == "left"


def test_what_has_moved_while_it_was_decided_is_not_gone_for(robot):
    loop = Loop(robot, scene({"thing": (0.45, 0.1, 0.25)}))
    loop.go(0.1)
    loop.tick(OperatorSample(loop.time, loop.hand, trigger=True))
    assert loop.controller.state.choice.deciding is not None
    loop.controller.observe(scene({"thing": (0.45, 0.2, 0.25)}))
    step = loop.decided(loop.steps[-1])
    assert step.target is None
    assert "moved" in step.reason
    assert loop.controller.mode is Mode.MANUAL


def bytes_of(steps):
    return [(s.mode, s.event, s.reason, s.command.q.tobytes(), s.command.a.tobytes(), s.opening) for s in steps]


def test_a_snapshot_in_the_middle_of_a_decision_and_of_a_new_scene_goes_on_with_the_same_bytes(robot):
    loop = Loop(robot, scene(TWO, count=40))
    loop.go(0.3, move=(0.0, 0.05, 0.0))
    loop.controller.observe(scene(TWO, count=40, seed=4))
    loop.go(0.02)
    inputs = [OperatorSample(loop.time, loop.hand, trigger=True)] + [None] * 200
    measured, snapshots, first = [], {}, []
    for k, sample in enumerate(inputs):
        if loop.controller.state.choice.deciding is not None or k % 40 == 0:
            snapshots[k] = loop.controller.snapshot()
        measured.append(loop.measured)
        first.append(loop.tick(sample))
    assert len(snapshots) > 7
    assert any(snapshot.selector.build is not None for snapshot in snapshots.values())
    for k, snapshot in snapshots.items():
        loop.controller.restore(snapshot)
        again = [loop.controller.step(sample, state) for sample, state in zip(inputs[k:], measured[k:], strict=True)]
        assert bytes_of(again) == bytes_of(first[k:]), f"from tick {k}"


def test_a_run_with_new_scenes_while_it_is_decided_is_replayed_bit_for_bit(robot):
    seeds = iter(range(1000))

    def watch(time, measured):
        return SceneUpdate(scene(count=20, seed=next(seeds) % 3))

    operator = StraightOperator(np.array(PLACES["middle"]) + [0, 0, 0.25], near=(0.1, 0.8))
    options = {"follower": IdealFollower(robot), "candidates": scene(count=20), "duration": 2.2}
    seen = session.run(controller(robot), operator=operator, watch=watch, watch_period=0.01, **options)
    decided = [k for k, tick in enumerate(seen) if tick.step.event is Event.TRIGGERED]
    assert decided
    assert any(decided[0] - 10 <= k <= decided[0] for k in seen.updates)
    inputs = RunInputs(
        {"rate": seen.rate, **seen.about},
        tuple(tick.sample for tick in seen),
        tuple(tick.measured for tick in seen),
        seen.commands,
    )
    again = session.replay(controller(robot), inputs, scene(count=20), updates=seen.updates)
    assert bytes_of([tick.step for tick in again]) == bytes_of([tick.step for tick in seen])


def test_a_table_that_was_solved_elsewhere_is_in_use_within_a_few_ticks(robot):
    loop = Loop(robot, scene(TWO, count=40))
    loop.go(0.1)
    other = scene(TWO, count=40, seed=4)
    selector = GraspSelector(robot)
    table = pickle.loads(pickle.dumps(selector.solver.table(other, loop.controller.servo.guard.q)))
    with pytest.raises(InvalidValue, match="candidates of the table"):
        loop.controller.observe(other, None, table)
    loop.controller.observe(table.candidates, None, table)
    loop.go(0.02)
    assert loop.controller.selector.candidates is table.candidates
    loop.go(0.04)
    assert loop.controller.ranking.best is not None
