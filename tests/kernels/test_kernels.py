"""Compiled kinematics: equal to pinocchio, compiled or not, and safe against everything that befalls a cache."""

import gc
import os
import subprocess
import sys
import threading
from pathlib import Path

import casadi
import numpy as np
import pytest

from optsc.cli.kernel_comparison import compare_kernels
from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.ik.reach_bound import ReachBound
from optsc.kernels import (
    build_batch_kernel,
    build_kernel,
    compiler,
    forward_kinematics,
    kinematics,
    rotations,
)
from optsc.kernels.newton import DAMPING, FLOOR, LENGTH
from optsc.kernels.rollout import newton
from optsc.robot import ROBOT_NAMES, load_robot, model_from_urdf

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler here")

ODD_ARM = """
<robot name="odd">
  <link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="tool"/>
  <joint name="turn" type="continuous">
    <parent link="base"/><child link="a"/><origin xyz="0.1 0 0.3" rpy="0.2 0.1 -0.4"/><axis xyz="0.6 0 0.8"/>
    <limit velocity="1" effort="1"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="a"/><child link="b"/><origin xyz="0 0.2 0" rpy="0 0.5 0"/><axis xyz="0 0.8 -0.6"/>
    <limit lower="-0.1" upper="0.4" velocity="1" effort="1"/>
  </joint>
  <joint name="bend" type="revolute">
    <parent link="b"/><child link="c"/><origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="1.5" velocity="1" effort="1"/>
  </joint>
  <joint name="fix" type="fixed">
    <parent link="c"/><child link="tool"/><origin xyz="0 0.05 0.2" rpy="0.3 0 0.1"/>
  </joint>
</robot>
"""


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("OPTSC_CACHE", str(tmp_path))
    return tmp_path / "kernels"


def odd_arm(folder):
    path = folder / "odd.urdf"
    path.write_text(ODD_ARM)
    return model_from_urdf(path, "tool", limits={"velocity": [1.0] * 3})


def square():
    x = casadi.SX.sym("x", 2)
    return casadi.Function("square", [x], [x * x + 1])


@pytest.fixture(params=[*ROBOT_NAMES, "odd"])
def robot(request, tmp_path):
    return odd_arm(tmp_path) if request.param == "odd" else load_robot(request.param)


def test_symbolic_kinematics_equal_those_of_pinocchio(robot):
    forward, both = forward_kinematics(robot.chain), kinematics(robot.chain)
    for q in robot.random_configuration(np.random.default_rng(1), (20,)):
        X_WT = robot.forward(q)
        R, p, J = (np.array(value.full()) for value in both(q))
        np.testing.assert_allclose(R, X_WT.rotation_matrix(), atol=1e-14)
        np.testing.assert_allclose(p[:, 0], X_WT.translation, atol=1e-14)
        np.testing.assert_allclose(J, robot.jacobian(q), atol=1e-14)
        assert [v.full().tolist() for v in forward(q)] == [v.tolist() for v in (R, p)]


def test_the_jacobian_equals_differences_of_pinocchios_kinematics(robot):
    both, h = kinematics(robot.chain), 1e-6
    for q in robot.random_configuration(np.random.default_rng(6), (5,)):
        ahead, back = robot.forward(q + h * np.eye(robot.n)), robot.forward(q - h * np.eye(robot.n))
        linear = (ahead.translation - back.translation) / (2 * h)
        turn = rotation.log(rotation.multiply(ahead.quaternion, rotation.conjugate(back.quaternion))) / (2 * h)
        np.testing.assert_allclose(both(q)[2].full(), np.hstack([linear, turn]).T, atol=1e-8)


def test_one_step_along_a_line_is_the_damped_step_of_pinocchios_jacobian(robot):
    step_kernel, rng = build_kernel(newton(robot.chain)), np.random.default_rng(7)
    n, W = robot.n, np.diag([1.0] * 3 + [LENGTH**2] * 3)
    free = np.repeat([-np.inf, np.inf], n)
    for _ in range(10):
        q, away = robot.random_configuration(rng), rng.normal(size=n)
        X_WT, X_goal = robot.forward(q), robot.forward(q + 0.02 * away)
        turn = rotation.log(rotation.multiply(X_goal.quaternion, rotation.conjugate(X_WT.quaternion)))
        e, J = np.concatenate([X_goal.translation - X_WT.translation, turn]), robot.jacobian(q)
        damping = DAMPING * e @ W @ e + FLOOR
        step = np.linalg.solve(J.T @ W @ J + damping * np.eye(n), J.T @ W @ e)
        goal = np.concatenate([X_goal.quaternion, X_goal.translation])
        here = np.concatenate([X_WT.quaternion, X_WT.translation])
        (there,) = step_kernel(np.r_[q, q, np.inf], goal, here, [1e-9], free)
        np.testing.assert_allclose(there[:n] - q, step, rtol=1e-6, atol=1e-7)
        norms = np.linalg.norm(e[:3]), np.linalg.norm(e[3:])
        assert there[2 * n] == pytest.approx(max(norms), abs=1e-9)
        # A configuration that is at its target goes on to the next one.
        (onward,) = step_kernel(np.r_[q, np.zeros(n), np.inf], here, goal, [1e-6], free)
        np.testing.assert_allclose(onward[:n], there[:n], atol=1e-9)
        assert np.array_equal(onward[n : 2 * n], q)


@needs_compiler
@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_every_kernel_gives_the_same_results_compiled_and_interpreted(name):
    found = compare_kernels(load_robot(name), np.random.default_rng(8))
    assert len(found) == 5
    for one in found:
        assert one.compiled
        assert one.difference <= 1e-9, one.name
        assert one.interpreted_time > 0.0


@needs_compiler
def test_compiled_and_interpreted_kernels_agree_to_rounding(monkeypatch):
    function = kinematics(load_robot("panda").chain)
    compiled = build_kernel(function)
    monkeypatch.setenv("OPTSC_COMPILER", "none")
    interpreted = build_kernel(function)
    assert compiled.compiled
    assert not interpreted.compiled
    for q in np.random.default_rng(2).uniform(-3, 3, (20, 7)):
        for a, b in zip(compiled(q), interpreted(q), strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-15)


def test_a_kernel_runs_in_place_on_its_own_buffers():
    kernel = build_kernel(square())
    (x,), (y,) = kernel.inputs, kernel.outputs
    x[:] = [2.0, 3.0]
    kernel.run()
    assert y.tolist() == [5.0, 10.0]
    assert kernel.inputs[0] is x
    assert kernel.outputs[0] is y


def test_run_outlives_its_kernel():
    kernel = build_kernel(square())
    (x,), (y,), run = kernel.inputs, kernel.outputs, kernel.run
    x[:] = [2.0, 3.0]
    del kernel, x
    gc.collect()
    run()
    assert y.tolist() == [5.0, 10.0]


def test_calling_a_kernel_returns_copies():
    kernel = build_kernel(square())
    (first,) = kernel([2.0, 3.0])
    kernel([0.0, 0.0])
    assert first.tolist() == [5.0, 10.0]


def test_a_kernel_names_the_input_that_does_not_fit():
    kernel = build_kernel(square())
    with pytest.raises(InvalidValue, match=r"\(2,\)"):
        kernel([1.0, 2.0, 3.0])
    with pytest.raises(InvalidValue, match="number of inputs"):
        kernel([1.0, 2.0], [1.0])


def test_a_sparse_output_is_refused():
    x = casadi.SX.sym("x", 2)
    with pytest.raises(InvalidValue, match="dense"):
        build_kernel(casadi.Function("sparse", [x], [casadi.diag(x)]))


def test_a_matrix_keeps_its_rows_and_columns():
    x = casadi.SX.sym("x", 2, 3)
    (y,) = build_kernel(casadi.Function("twice", [x], [2 * x]))(np.arange(6.0).reshape(2, 3))
    assert y.tolist() == [[0.0, 2.0, 4.0], [6.0, 8.0, 10.0]]


def test_threads_may_share_a_kernel():
    kernel, wrong = build_kernel(square()), []

    def work(value):
        for _ in range(300):
            if kernel([value, -value])[0].tolist() != [value * value + 1] * 2:
                wrong.append(value)

    threads = [threading.Thread(target=work, args=(float(i),)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


@pytest.mark.parametrize("count", [0, 1, 4, 9])
def test_a_batch_kernel_takes_any_number_of_items(count):
    x, a = casadi.SX.sym("x", 2), casadi.SX.sym("a")
    function = casadi.Function("outer", [x, a], [a * x @ x.T, x[0] + a])
    kernel = build_batch_kernel(function, 4, shared=1)
    items = np.random.default_rng(3).normal(size=(count, 2))
    outer, total = kernel(items, shared=(3.0,))
    np.testing.assert_allclose(outer.reshape(-1, 2, 2), 3.0 * items[:, :, None] * items[:, None, :])
    np.testing.assert_allclose(total, items[:, :1] + 3.0)


@needs_compiler
def test_a_library_is_built_once(cache):
    build_kernel(square())
    (library,) = cache.iterdir()
    before = library.stat()
    assert build_kernel(square()).compiled
    assert list(cache.iterdir()) == [library]
    assert library.stat() == before


@needs_compiler
@pytest.mark.parametrize("damage", [b"", b"\x7fELF", None])
def test_a_damaged_library_is_built_again(cache, damage):
    build_kernel(square())
    (library,) = cache.iterdir()
    content = library.read_bytes()
    library.write_bytes(content[: len(content) // 2] if damage is None else damage)
    kernel = build_kernel(square())
    assert kernel.compiled
    assert kernel([2.0, 3.0])[0].tolist() == [5.0, 10.0]
    assert [path.read_bytes() for path in cache.iterdir()] == [content]


@needs_compiler
def test_two_processes_may_build_at_once(cache):
    program = (
        "import casadi; from optsc.kernels import build_kernel; x = casadi.SX.sym('x');"
        "k = build_kernel(casadi.Function('sine', [x], [casadi.sin(x)])); print(k.compiled, k([0.0])[0][0])"
    )
    processes = [subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) for _ in range(2)]
    assert [process.communicate()[0] for process in processes] == [b"True 0.0\n"] * 2
    assert [path.suffix for path in cache.iterdir()] == [".so"]


def test_a_compiler_that_fails_warns_and_leaves_the_interpreter(cache, monkeypatch, tmp_path):
    broken = tmp_path / "broken-cc"
    broken.write_text('#!/bin/sh\n[ "$1" = --version ] && exit 0\necho out of luck >&2\nexit 1\n')
    broken.chmod(0o755)
    monkeypatch.setenv("OPTSC_COMPILER", str(broken))
    with pytest.warns(UserWarning, match="out of luck"):
        kernel = build_kernel(square())
    assert not kernel.compiled
    assert kernel([2.0, 3.0])[0].tolist() == [5.0, 10.0]


def test_a_compiler_that_does_not_exist_is_refused(monkeypatch):
    monkeypatch.setenv("OPTSC_COMPILER", "no-such-compiler")
    with pytest.raises(InvalidValue, match="no-such-compiler"):
        compiler()


def test_with_an_empty_path_kernels_are_interpreted_and_say_the_same(tmp_path):
    program = (
        "from optsc.robot import load_robot; from optsc.kernels import *; from optsc.robot.rollout import *;"
        "r = load_robot('panda'); X = r.forward(r.home);"
        "Y = type(X).from_translation([0, 0.05, 0])[None] @ X;"
        "rollout = straight_line_rollout(r, r.home, X, Y, speed=0.1, angular_speed=0.5);"
        "print(compiler(), rollout.q.tolist())"
    )
    outputs = []
    for environment in ({}, {"PATH": str(tmp_path), "OPTSC_CACHE": str(tmp_path), "CC": ""}):
        command = [sys.executable, "-c", program]
        done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, **environment})
        assert done.returncode == 0, done.stderr
        outputs.append(done.stdout.partition(" "))
    assert outputs[1][0] == "None"
    assert outputs[0][2] == outputs[1][2]


def test_no_compiler_is_wanted_with_none(monkeypatch):
    monkeypatch.setenv("OPTSC_COMPILER", "none")
    assert compiler() is None


def test_building_writes_nothing_to_the_terminal(cache, capfd):
    build_kernel(square()).run()
    assert capfd.readouterr() == ("", "")


def test_building_leaves_nothing_in_the_working_directory(cache, tmp_path, monkeypatch):
    folder = tmp_path / "empty"
    folder.mkdir()
    monkeypatch.chdir(folder)
    build_kernel(square())
    assert list(Path.cwd().iterdir()) == []


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 1.0, 3.0, np.pi - 1e-7, np.pi])
def test_the_kernels_rotation_vector_has_the_length_of_the_rotation(angle):
    c = casadi.SX.sym("c", 4)
    vector = casadi.Function("vector", [c], [rotations.from_matrix(rotations.to_matrix(c))])
    axes = np.random.default_rng(4).normal(size=(10, 3))
    for axis in [*np.eye(3), *(axes / np.linalg.norm(axes, axis=1, keepdims=True))]:
        found = vector(rotation.exp(angle * axis)).full()[:, 0]
        assert np.linalg.norm(found) == pytest.approx(angle, abs=1e-8)
        if angle < 3.1:
            np.testing.assert_allclose(found, angle * axis, atol=1e-14)


def test_no_configuration_is_out_of_reach(robot):
    X_WT = robot.forward(robot.random_configuration(np.random.default_rng(5), (500,)))
    assert not ReachBound.of(robot).excludes(X_WT.quaternion, X_WT.translation).any()


def test_a_pose_further_away_than_the_arm_is_long_is_out_of_reach(robot):
    X_WT = robot.forward(robot.home[None])
    far = Pose.from_translation([3.0, 0.0, 0.0]) @ X_WT
    assert ReachBound.of(robot).excludes(far.quaternion, far.translation).all()


@pytest.mark.skipif(compiler() is None, reason="no C compiler here")
def test_greatest_and_least_leave_out_what_is_not_a_number_as_the_interpreter_does():
    x, y = casadi.SX.sym("x", 9), casadi.SX.sym("y", 9)
    function = casadi.Function("extremes", [x, y], [casadi.fmax(x, y), casadi.fmin(x, y)])
    a, b = (values.ravel() for values in np.meshgrid(*[[np.nan, -np.inf, 1.5]] * 2))
    compiled = build_kernel(function)
    assert compiled.compiled
    for found, expected in zip(compiled(a, b), function(a, b), strict=True):
        np.testing.assert_array_equal(found, expected.full()[:, 0])
