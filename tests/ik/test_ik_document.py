"""What docs/inverse-kinematics.md says: its formulas, and that its code runs."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from optsc.geometry import rotation
from optsc.ik.arm import TABLE_SIZE, features
from optsc.ik.attempts import FIRST_STARTS, LIMIT_PROBES
from optsc.ik.batch import CHOICE_STARTS, REASONS, RESTARTS, deviation
from optsc.ik.choice import DISTINCT
from optsc.kernels import build_kernel
from optsc.kernels.search import AIM, FALL, ITERATIONS, PATIENCE, iteration
from optsc.robot import load_robot

PAGE = (Path(__file__).parents[2] / "docs" / "inverse-kinematics.md").read_text()


def test_a_step_is_the_damped_one_of_the_page():
    robot, rng = load_robot("panda"), np.random.default_rng(0)
    kernel = build_kernel(iteration(robot.chain, by_component=False))
    W = np.diag([1.0] * 3 + [0.2**2] * 3)
    for _ in range(20):
        q, goal = robot.random_configuration(rng, (2,))
        X_WT, X_goal = robot.forward(q), robot.forward(q + 0.1 * (goal - q))
        turn = rotation.log(rotation.multiply(X_goal.quaternion, rotation.conjugate(X_WT.quaternion)))
        e = np.concatenate([X_goal.translation - X_WT.translation, turn])
        J = robot.jacobian(q)
        damping = 0.05 * e @ W @ e + 1e-10
        step = J.T @ np.linalg.solve(J @ J.T + damping * np.linalg.inv(W), e)
        state = np.concatenate([q, q, [np.inf, 0.0, 0.0, np.inf, 0.0]])
        target = np.concatenate([X_goal.quaternion, X_goal.translation, [1e-5]])
        free = np.repeat([-np.inf, np.inf], 7)
        (after,) = kernel(state, target, free)
        np.testing.assert_allclose(after[:7] - q, step * min(1.0, 1.0 / np.abs(step).max()), atol=1e-9)
    assert "after 40 steps" in PAGE
    assert (ITERATIONS, FALL, PATIENCE) == (40, 0.9, 4)


def test_starts_are_compared_by_the_distance_of_the_page():
    rng = np.random.default_rng(1)
    quaternion = rotation.exp(rng.uniform(-2, 2, (2, 3)))
    p, q = rng.uniform(-1, 1, (2, 3)), rng.uniform(-1, 1, (2, 7))
    a, b = features(quaternion, p, q)
    theta = rotation.angle(quaternion[0], quaternion[1])
    square = (0.8 * np.sin(theta / 2)) ** 2 + np.sum((p[0] - p[1]) ** 2) + 0.01 * np.sum((q[0] - q[1]) ** 2)
    assert np.sum((a - b) ** 2) == pytest.approx(square)
    assert (TABLE_SIZE, FIRST_STARTS, RESTARTS, CHOICE_STARTS, LIMIT_PROBES) == (512, 24, 32, 16, 16)
    assert (DISTINCT, AIM) == (0.05, 0.5)


def test_tilt_and_roll_make_up_the_rotation():
    robot = load_robot("panda")
    X_WG, X_WT = (robot.forward(robot.random_configuration(np.random.default_rng(s), (50,))) for s in (2, 3))
    found = deviation(X_WG, X_WT)
    tilt, roll = np.zeros((2, 50, 3))
    tilt[:, :2], roll[:, 2] = found[:, 3:5], found[:, 5]
    both = rotation.multiply(rotation.exp(tilt), rotation.exp(roll))
    back = rotation.multiply(X_WG.quaternion, both)
    np.testing.assert_allclose(rotation.angle(back, X_WT.quaternion), 0.0, atol=1e-7)


def test_every_reason_is_explained():
    assert all(f'| "{reason}" |' in PAGE for reason in REASONS)


def test_the_code_of_the_page_runs(tmp_path):
    (block,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    done = subprocess.run([sys.executable, "-c", block], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "100% solved" in done.stdout
    assert "out of reach" in done.stdout
