"""One tick of differential IK: its cost against a separately written one, and what its terms mean."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio
import pytest

from optsc.errors import InvalidValue
from optsc.ik import DifferentialIK, IkSettings, Rows, differential, make_solver
from optsc.ik.solvers import DaqpSolver
from optsc.kernels import build_kernel
from optsc.kernels.interior import interior_minimum
from optsc.robot import ROBOT_NAMES, load_robot
from optsc.robot.manipulability import Manipulability

PERIOD = 2e-3
CALM = partial(IkSettings, smoothing=0.0, gain=60.0)  # one tick by itself: nothing is carried over


def row(X):
    return np.concatenate([X.translation, X.quaternion])


def wide(robot):
    return -100 * np.ones(robot.n), 100 * np.ones(robot.n)


def still(q):
    return q, np.zeros_like(q), np.zeros_like(q)


def expected_cost(robot, settings, q, reference, twist, posture):
    """The formula of the module's documentation, written with pinocchio in the local frame."""
    X, R = robot.forward(q), robot.forward(q).rotation_matrix()
    E = R.T @ reference.rotation_matrix()
    error = np.concatenate([R.T @ (reference.translation - X.translation), pinocchio.log3(E)])
    pull, to_tool = error.copy(), np.kron(np.eye(2), R.T)
    W = np.diag([*settings.position_weight, *settings.orientation_weight])
    local = to_tool @ robot.jacobian(q)
    J = W @ local
    plain = J.T @ J + (settings.posture_weight + settings.damping) * np.eye(robot.n)
    stop = stopping_time(robot, plain, J.T @ W @ to_tool @ twist, np.zeros(robot.n))
    gain, weakest = min(settings.gain, 0.3 / PERIOD), robot.limits.acceleration.min()
    for part, braking in ((slice(0, 3), 0.4 * weakest), (slice(3, 6), 0.5 * weakest)):
        pull[part] *= min(gain, np.sqrt(braking / max(np.linalg.norm(error[part]), 1e-12)), 1.0 / stop)
    wanted = to_tool @ twist + pull
    H = plain + curvature(local, W @ W @ pull, gain, stop) * np.eye(robot.n)
    g = -J.T @ W @ wanted - settings.posture_weight * homeward(settings, posture - q)
    return H, g, error


def stopping_time(robot, plain, along, v):
    """Time in which the joints brake from what they move besides following the reference."""
    follow = np.linalg.solve(plain + 1e-3 * np.eye(robot.n), along)
    return np.abs((v - follow) / robot.limits.acceleration).max()


def curvature(J, pull, gain, stop):
    lever = np.linalg.norm(J[:3], axis=0).max()
    return 0.4 * (lever * np.linalg.norm(pull[:3]) + np.linalg.norm(pull[3:])) * (1.0 / gain + stop)


def homeward(settings, way):
    speed = settings.posture_gain * way
    return speed * min(1.0, settings.posture_speed / max(np.linalg.norm(speed), 1e-12))


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_the_cost_equals_its_formula(name):
    robot, rng = load_robot(name), np.random.default_rng(0)
    settings = CALM(position_weight=(1.0, 2.0, 0.5), orientation_weight=(0.3, 0.1, 0.0))
    ik = DifferentialIK(robot, PERIOD, settings)
    for _ in range(10):
        q, posture = robot.random_configuration(rng), robot.random_configuration(rng)
        reference, twist = robot.forward(q + 0.05 * rng.normal(size=robot.n)), rng.normal(size=6)
        H, g, error = expected_cost(robot, settings, q, reference, twist, posture)
        step = ik.solve(still(q), row(reference), twist, posture, *wide(robot))
        np.testing.assert_allclose(step.error, error, atol=1e-9)
        np.testing.assert_allclose(H @ step.velocity, -g, atol=1e-6)
        J = robot.jacobian(q)
        assert step.volume == pytest.approx(np.sqrt(np.linalg.det(J @ J.T)), abs=1e-9)


def written_program():
    """The terms of the objective and the velocity V as the module writes them."""
    objective = re.search(r"minimise(.*?)\n\n", differential.__doc__, re.DOTALL).group(1)
    terms = [re.split(r"\s{3,}", line.strip(" +"))[0] for line in objective.splitlines()]
    assert len(terms) == 5
    (velocity,) = re.findall(r"^ +V = (.*?)\s{3,}", differential.__doc__, re.MULTILINE)
    return terms, velocity


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_the_module_writes_the_program_that_is_solved(name):
    robot, rng = load_robot(name), np.random.default_rng(4)
    terms, velocity = written_program()
    rows = Rows(rng.normal(size=(3, robot.n)), np.full(3, 0.2), np.full(3, np.inf), weight=10.0)
    settings = IkSettings(gain=60.0, posture_weight=0.01)
    ik = DifferentialIK(robot, PERIOD, settings)
    w_s, r = differential.smoothness(settings.smoothing, PERIOD)
    for _ in range(5):
        q, q_p = robot.random_configuration(rng, (2,))
        v, a = rng.normal(size=(2, robot.n))
        X, X_goal, twist = (
            robot.forward(q),
            robot.forward(q + 0.01 * rng.normal(size=robot.n)),
            rng.normal(size=6),
        )
        R = X.rotation_matrix()
        to_tool = np.kron(np.eye(2), R.T)
        turn = pinocchio.log3(R.T @ X_goal.rotation_matrix())
        e = np.concatenate([R.T @ (X_goal.translation - X.translation), turn])
        k, parts = min(60.0, 0.3 / PERIOD, 0.5 / differential.ramp_time(robot.limits)), []
        w, J = np.array([*settings.position_weight, *settings.orientation_weight]), to_tool @ robot.jacobian(q)
        plain = (w[:, None] * J).T @ (w[:, None] * J) + (0.01 + settings.damping) * np.eye(robot.n)
        t = stopping_time(robot, plain, J.T @ (w * w * (to_tool @ twist)), v)
        for part, b in zip((e[:3], e[3:]), differential.tool_braking(robot.limits), strict=True):
            names = {"twist": (to_tool @ twist)[3 * len(parts) :][:3], "e": part, "k": k, "b": b, "t": t}
            parts.append(eval(velocity, {"min": min, "sqrt": np.sqrt, "norm": np.linalg.norm}, names))
        V = np.concatenate(parts)
        c = curvature(J, w * w * (V - to_tool @ twist), k, t)
        known = {"w": w, "V": V, "J": J, "e": e, "h": homeward(settings, q_p - q), "v": v, "a": a, "T": PERIOD}
        known |= {"w_p": 0.01, "w_s": w_s, "r": r, "w_r": 10.0, "d": settings.damping, "c": c, "sum": np.sum}
        known |= {"M": np.linalg.cholesky(plain + c * np.eye(robot.n)).T}

        def cost(x, known=known):
            s = np.maximum(rows.lower - rows.matrix @ x, 0.0)
            return sum(eval(term, known | {"x": x, "s": s}) for term in terms)

        lowest, highest = -0.5 * np.ones(robot.n), 0.5 * np.ones(robot.n)
        x = ik.solve((q, v, a), row(X_goal), twist, q_p, lowest, highest, rows).velocity
        smooth = known | {"s": np.zeros(3)}
        for other in rng.uniform(lowest, highest, (50, robot.n)):
            written = [sum(eval(term, smooth | {"x": y}) for term in terms) for y in (other, np.zeros(robot.n))]
            assert 0.5 * other @ ik._H @ other + ik._g @ other == pytest.approx(written[0] - written[1], abs=1e-9)
            assert cost(x) <= cost(other)
            assert cost(x) <= cost(np.clip(x + 1e-3 * (other - x), lowest, highest)) + 1e-9


def test_the_answer_does_not_depend_on_the_period():
    robot = load_robot("panda")
    q = robot.home
    reference, twist = robot.forward(q + 0.01), np.array([0.1, 0, 0, 0, 0.1, 0])
    answers = [
        DifferentialIK(robot, period, CALM()).solve(still(q), row(reference), twist, robot.home, *wide(robot)).velocity
        for period in (1e-3, 4e-3)
    ]
    np.testing.assert_allclose(*answers, atol=1e-12)


def test_a_zero_weight_leaves_that_direction_of_the_tool_free():
    robot = load_robot("panda")
    q = robot.home
    roll = DifferentialIK(robot, PERIOD, CALM(orientation_weight=(0.3, 0.3, 0.0)))
    reference = robot.forward(q + np.array([0, 0, 0, 0, 0, 0, 0.1]))  # a pure roll of the tool
    step = roll.solve(still(q), row(reference), np.zeros(6), robot.home, *wide(robot))
    assert abs(step.error[5]) == pytest.approx(0.1, abs=1e-6)
    np.testing.assert_allclose(robot.jacobian(q) @ step.velocity, 0, atol=1e-3)


@pytest.mark.parametrize("band", [2e-3, 0.05])
def test_a_dead_band_leaves_its_direction_free_and_is_exact(band):
    robot = load_robot("ur5")
    ik = DifferentialIK(robot, PERIOD, CALM(position_tolerance=(0.0, 0.0, band)))
    start = robot.forward(robot.home)
    z = start.rotation_matrix()[:, 2]

    def end_for(distance):
        target = np.concatenate([start.translation + distance * z, start.quaternion])
        q = robot.home.copy()
        for _ in range(800):
            q = q + PERIOD * ik.solve(still(q), target, np.zeros(6), robot.home, *wide(robot)).velocity
        return z @ (robot.forward(q).translation - start.translation)

    assert abs(end_for(0.5 * band)) < 0.01 * band + 1e-6
    assert end_for(3 * band) == pytest.approx(2 * band, abs=1e-4)
    assert end_for(-3 * band) == pytest.approx(-2 * band, abs=1e-4)


def test_a_rotation_within_its_dead_band_is_not_followed():
    robot = load_robot("panda")
    ik = DifferentialIK(robot, PERIOD, CALM(orientation_tolerance=(0.0, 0.0, 0.3)))
    for turn, followed in ((0.2, 0.0), (0.5, 0.2)):
        q, ahead = robot.home.copy(), robot.home + turn * np.eye(7)[6]
        for _ in range(800):
            q = (
                q
                + PERIOD * ik.solve(still(q), row(robot.forward(ahead)), np.zeros(6), robot.home, *wide(robot)).velocity
            )
        left = pinocchio.log3(robot.forward(q).rotation_matrix().T @ robot.forward(robot.home).rotation_matrix())
        assert abs(left[2]) == pytest.approx(followed, abs=2e-3)


def test_spare_motion_goes_to_the_posture_and_does_not_move_the_tool():
    robot = load_robot("panda")
    ik = DifferentialIK(robot, PERIOD, CALM())
    preferred = robot.home + 0.3 * np.eye(7)[0]
    step = ik.solve(still(robot.home), row(robot.forward(robot.home)), np.zeros(6), preferred, *wide(robot))
    assert step.velocity[0] > 0.01
    assert np.linalg.norm((robot.jacobian(robot.home) @ step.velocity)[:3]) < 5e-3


def test_spare_motion_climbs_the_manipulability_and_does_not_move_the_tool():
    robot = load_robot("panda")
    q = robot.home + np.array([0.0, 0.2, 0.3, 0.1, 0.4, 0.0, 0.5])
    X, M = row(robot.forward(q)), Manipulability()
    ends = []
    for gain in (0.0, 20.0):
        ik = DifferentialIK(robot, PERIOD, CALM(manipulability_gain=gain, posture_gain=0.1, posture_speed=1.0))
        posture = q.copy()
        for _ in range(1000):
            posture = posture + PERIOD * ik.solve(still(posture), X, np.zeros(6), q, *wide(robot)).velocity
        ends.append(float(M.evaluate(robot, posture)))
        assert np.linalg.norm(robot.forward(posture).translation - robot.forward(q).translation) < 2e-3
    assert ends[1] > ends[0] + 5e-4


def test_bounds_are_kept():
    robot = load_robot("ur5")
    ik = DifferentialIK(robot, PERIOD, CALM())
    reference = robot.forward(robot.home + 0.3)
    step = ik.solve(still(robot.home), row(reference), np.zeros(6), robot.home, np.full(6, -0.05), np.full(6, 0.05))
    assert np.all(np.abs(step.velocity) <= 0.05 + 1e-9)


def test_impossible_settings_are_refused():
    for wrong in (
        {"gain": -1.0},
        {"position_weight": (1.0, 1.0)},
        {"orientation_weight": (np.nan, 0.0, 0.0)},
        {"damping": 0.0, "posture_weight": 0.0},
        {"manipulability_gain": 1.0, "posture_gain": 0.0},
    ):
        with pytest.raises(InvalidValue):
            IkSettings(**wrong)


@pytest.mark.parametrize("period", [1e-3, 4e-3])
def test_the_smoothness_task_equals_its_formula(period):
    robot, rng = load_robot("iiwa"), np.random.default_rng(3)
    settings = IkSettings(smoothing=5e-3)
    plain, smooth = (DifferentialIK(robot, period, s) for s in (replace(settings, smoothing=0.0), settings))
    q, v, a = robot.random_configuration(rng), rng.normal(size=7), rng.normal(size=7)
    target, twist = row(robot.forward(q + 0.01)), rng.normal(size=6)
    z = np.exp(-period / 5e-3)
    w, share = (2 * z - z * z) / (1 - z) ** 2, z / (2 - z)
    free = plain.solve((q, v, a), target, twist, robot.home, *wide(robot))
    expected = (free.velocity + w * (v + share * period * a)) / (1 + w)
    np.testing.assert_allclose(
        smooth.solve((q, v, a), target, twist, robot.home, *wide(robot)).velocity, expected, atol=1e-6
    )


def test_the_smoothness_task_fades_alike_at_every_rate():
    robot = load_robot("panda")
    target, ends = row(robot.forward(robot.home)), []
    for period in (1e-3, 2e-3):
        ik = DifferentialIK(robot, period, IkSettings(gain=0.0, braking=(1e-9, 1e-9)))
        q, v, a = robot.home, np.full(7, 0.1), np.zeros(7)
        for _ in range(round(0.02 / period)):
            new = ik.solve((q, v, a), target, np.zeros(6), robot.home, *wide(robot)).velocity
            v, a = new, (new - v) / period
        ends.append(np.linalg.norm(v))
    assert ends[0] == pytest.approx(ends[1], rel=0.15)


@pytest.mark.parametrize("n", [3, 7])
def test_a_minimum_that_no_bound_holds_is_the_solution_and_any_other_is_left_to_the_solver(n):
    kernel, solver, rng = build_kernel(interior_minimum(n)), make_solver("daqp"), np.random.default_rng(n)
    interior = 0
    for _ in range(300):
        J = rng.normal(size=(min(n, 6), n))
        H, g = J.T @ J + 10.0 ** rng.uniform(-2, 0) * np.eye(n), rng.normal(size=n)
        ends = np.array([[-1.0], [1.0]]) * rng.uniform(0.5, 1.0, n) * rng.choice([1.0, 10.0, 100.0])
        x, inside = kernel(H, g, *ends)
        expected = np.linalg.solve(H, -g)
        np.testing.assert_allclose(x, expected, rtol=1e-7, atol=1e-9)
        assert inside[0] == np.all((x >= ends[0]) & (x <= ends[1]))
        if inside[0]:
            np.testing.assert_allclose(solver.solve(H, g, *ends).x, x, rtol=1e-9, atol=1e-9)
            interior += 1
    assert 20 < interior < 280
    for broken in (-np.eye(n), np.full((n, n), np.nan)):
        assert kernel(broken, g, np.full(n, -1e9), np.full(n, 1e9))[1] == 0.0


def counted(asked, call, *problem, **settings):
    asked.append(1)
    return call(*problem, **settings)


def test_daqp_is_asked_only_where_something_holds_the_minimum_and_a_users_solver_always(monkeypatch):
    robot = load_robot("panda")
    far, X = np.full(robot.n, 10.0), robot.forward(robot.home)
    reference = np.concatenate([X.translation + [1e-3, 0.0, 0.0], X.quaternion])
    for kind, expected in ((DaqpSolver, [0, 1, 1, 0, 1]), (type("Users", (DaqpSolver,), {}), [1, 1, 1, 1, 1])):
        solver, asked = kind(), []
        monkeypatch.setattr(solver, "_solve", partial(counted, asked, solver._solve))
        ik = DifferentialIK(robot, 1e-3, solver=solver)
        problem = still(robot.home), reference, np.zeros(6), robot.home
        free = ik.solve(*problem, -far, far).velocity
        row = free / np.linalg.norm(free)
        reached = float(row @ free)
        cases = [
            (-far, far, None),
            (-far, 0.5 * np.abs(free), None),
            (-far, far, Rows(row[None], np.array([-1.0]), np.array([0.5 * reached]))),
            (-far, far, Rows(row[None], np.array([-1.0]), np.array([2.0 * reached]), 100.0)),
            (-far, far, Rows(row[None], np.array([2.0 * reached]), np.array([np.inf]), 100.0)),
        ]
        counts = []
        for low, high, rows in cases:
            asked.clear()
            step = ik.solve(*problem, low, high, rows)
            assert step.solved
            counts.append(min(len(asked), 1))
            assert np.all((step.velocity >= low - 1e-9) & (step.velocity <= high + 1e-9))
            if not counts[-1]:
                np.testing.assert_allclose(step.velocity, free, atol=1e-12)
                assert (step.iterations, step.slack) == (0, 0.0)
        assert counts == expected
