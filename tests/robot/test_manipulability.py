"""Penalised manipulability: against singular values of pinocchio's Jacobian, and the laws of its two factors."""

from itertools import product

import numpy as np
import pytest

from optsc.errors import InvalidValue, UnknownName
from optsc.kernels import compiler
from optsc.robot import ROBOT_NAMES, load_robot, model_from_urdf
from optsc.robot.manipulability import DEFINITIONS, JOINT_LIMITS, SINGULARITY, Manipulability

PANDA = load_robot("panda")

ENDLESS_ARM = """
<robot name="endless">
  <link name="base"/><link name="a"/><link name="b"/><link name="tool"/>
  <joint name="first" type="continuous">
    <parent link="base"/><child link="a"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
    <limit velocity="1" effort="1"/>
  </joint>
  <joint name="second" type="revolute">
    <parent link="a"/><child link="b"/><origin xyz="0.1 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="1" velocity="1" effort="1"/>
  </joint>
  <joint name="third" type="revolute">
    <parent link="b"/><child link="tool"/><origin xyz="0.4 0 0"/><axis xyz="0.6 0.8 0"/>
    <limit lower="-1" upper="3" velocity="1" effort="1"/>
  </joint>
</robot>
"""


@pytest.fixture(scope="module")
def endless_arm(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "endless.urdf"
    path.write_text(ENDLESS_ARM)
    return model_from_urdf(path, "tool")


def slope_of_closeness(robot, q):
    """|dH/dq| of H = sum (u - l)^2 / (4 (u - q) (q - l)), by joint; zero where a joint has no limits."""
    slope = np.zeros(robot.n)
    for j in np.flatnonzero(robot.limits.bounded):
        low, up, x = robot.limits.lower[j], robot.limits.upper[j], q[j]
        slope[j] = abs((up - low) ** 2 * (2 * x - up - low) / (4 * (up - x) ** 2 * (x - low) ** 2))
    return slope


def index_of(singularity, J):
    sigma = np.linalg.svd(J, compute_uv=False)
    return {
        "yoshikawa": np.prod(sigma),
        "inverse_condition": sigma[-1] / sigma[0],
        "minimum_singular_value": sigma[-1],
    }[singularity]


def worst_hyperoctant(singularity, robot, q, J):
    """The extended index of Vahrenkamp et al., entry by entry."""
    weight = 1 / np.sqrt(1 + slope_of_closeness(robot, q))
    low, up = robot.limits.lower, robot.limits.upper
    values = []
    for signs in product((-1, 1), repeat=6):
        weighted = J.copy()
        for i in range(6):
            for j in np.flatnonzero(robot.limits.bounded):
                goes_up = signs[i] * J[i, j] > 0
                nearer_the_upper = abs(q[j] - low[j]) > abs(q[j] - up[j])
                if goes_up == nearer_the_upper:
                    weighted[i, j] *= weight[j]
        values.append(index_of(singularity, weighted))
    return min(values)


def literal(measure, robot, q):
    """M written down as in the books, for one configuration."""
    J = robot.jacobian(q).copy()
    if measure.singularity != "yoshikawa":
        J[3:] *= measure.length
    if measure.joint_limits == "chan_dubey":
        return index_of(measure.singularity, J / np.sqrt(1 + slope_of_closeness(robot, q)))
    if measure.joint_limits == "vahrenkamp":
        return worst_hyperoctant(measure.singularity, robot, q, J)
    some = robot.limits.bounded
    lower, upper, q = robot.limits.lower[some], robot.limits.upper[some], q[some]
    factors = (q - lower) * (upper - q) / (upper - lower) ** 2
    L = {
        "tsai": (1 - np.exp(-measure.k * np.prod(4 * factors))) / (1 - np.exp(-measure.k)),
        "tsai_raw": 1 - np.exp(-measure.k * np.prod(factors)),
        "none": 1.0,
    }[measure.joint_limits]
    return index_of(measure.singularity, J) * L


def slope_of(function, q, step=1e-6):
    """Central differences."""
    return np.array([(function(q + d) - function(q - d)) / (2 * step) for d in step * np.eye(len(q))])


@pytest.mark.parametrize("name", ROBOT_NAMES)
@pytest.mark.parametrize("definition", DEFINITIONS)
def test_every_definition_equals_a_separate_reading_on_every_arm(name, definition):
    robot, measure = load_robot(name), DEFINITIONS[definition]
    q = robot.random_configuration(np.random.default_rng(1), (4 if "vahrenkamp" in definition else 40,))
    expected = [literal(measure, robot, row) for row in q]
    np.testing.assert_allclose(measure.evaluate(robot, q), expected, rtol=1e-8, atol=1e-11)


@pytest.mark.parametrize("singularity", SINGULARITY)
@pytest.mark.parametrize("joint_limits", JOINT_LIMITS)
def test_the_measure_equals_its_definition_on_an_arm_of_three_joints_one_endless(
    endless_arm, singularity, joint_limits
):
    measure = Manipulability(singularity, joint_limits, k=7.0, length=0.3)
    q = endless_arm.random_configuration(np.random.default_rng(2), (20,))
    expected = [literal(measure, endless_arm, row) for row in q]
    np.testing.assert_allclose(measure.evaluate(endless_arm, q), expected, rtol=1e-8, atol=1e-11)
    slope = slope_of(lambda x: literal(measure, endless_arm, x), q[0])
    np.testing.assert_allclose(measure.gradient(endless_arm, q[0]), slope, atol=1e-7)


@pytest.mark.parametrize("definition", DEFINITIONS)
def test_the_gradient_equals_differences_of_the_measure(definition):
    measure = DEFINITIONS[definition]
    for q in PANDA.random_configuration(np.random.default_rng(3), (1 if "vahrenkamp" in definition else 5,)):
        slope = slope_of(lambda x: literal(measure, PANDA, x), q)
        np.testing.assert_allclose(measure.gradient(PANDA, q), slope, atol=1e-7 + 1e-6 * np.abs(slope).max())


def test_joint_limits_count_nothing_in_the_middle_and_all_at_the_end():
    free, penalised = Manipulability(joint_limits="none"), Manipulability(joint_limits="tsai")
    middle = 0.5 * (PANDA.limits.lower + PANDA.limits.upper)
    assert penalised.evaluate(PANDA, middle) == pytest.approx(free.evaluate(PANDA, middle), rel=1e-12)
    assert free.evaluate(PANDA, middle) > 0
    for joint in range(7):
        at_limit = middle.copy()
        at_limit[joint] = PANDA.limits.upper[joint]
        assert penalised.evaluate(PANDA, at_limit) == 0.0


@pytest.mark.parametrize("joint_limits", ["tsai", "tsai_raw"])
def test_two_joints_beyond_their_limits_do_not_make_up_for_each_other(joint_limits):
    beyond = PANDA.home.copy()
    beyond[[0, 2]] = PANDA.limits.upper[[0, 2]] + 0.1
    measure = Manipulability(joint_limits=joint_limits)
    assert measure.evaluate(PANDA, beyond) == 0.0
    assert not measure.gradient(PANDA, beyond).any()


def test_turning_an_endless_joint_changes_nothing(endless_arm):
    q = np.array([[0.0, -0.5, 0.7], [2.0, -0.5, 0.7], [-50.0, -0.5, 0.7]])
    for singularity in SINGULARITY:
        M = Manipulability(singularity).evaluate(endless_arm, q)
        np.testing.assert_allclose(M, M[0], rtol=1e-9)


@pytest.mark.parametrize("shape", [(), (1,), (0,), (3, 37)])
def test_batches_keep_their_shape_and_equal_single_configurations(shape):
    q = PANDA.random_configuration(np.random.default_rng(4), shape)
    for singularity in SINGULARITY:
        measure = Manipulability(singularity)
        M = measure.evaluate(PANDA, q)
        assert M.shape == shape
        single = [measure.evaluate(PANDA, row) for row in q.reshape(-1, 7)[:5]]
        np.testing.assert_allclose(M.ravel()[:5], single, rtol=1e-12)


@pytest.mark.parametrize("definition", DEFINITIONS)
def test_at_a_limit_and_beyond_every_definition_and_its_gradient_is_finite(definition):
    measure, middle = DEFINITIONS[definition], 0.5 * (PANDA.limits.lower + PANDA.limits.upper)
    for offset in (0.0, 0.2):
        for joint in range(7):
            q = middle.copy()
            q[joint] = PANDA.limits.upper[joint] + offset
            assert 0.0 <= measure.evaluate(PANDA, q) < np.inf
            assert np.all(np.isfinite(measure.gradient(PANDA, q)))


def test_a_joint_at_its_limit_counts_as_not_there_in_the_jacobian_of_chan_and_dubey():
    q = PANDA.home.copy()
    q[3] = PANDA.limits.upper[3]
    J = PANDA.jacobian(q) / np.sqrt(1 + slope_of_closeness(PANDA, np.where(np.arange(7) == 3, 0.0, q)))
    J[:, 3] = 0.0
    M = Manipulability(joint_limits="chan_dubey").evaluate(PANDA, q)
    assert pytest.approx(index_of("yoshikawa", J), rel=1e-9) == M


@pytest.mark.parametrize("joint_limits", ["chan_dubey", "vahrenkamp"])
@pytest.mark.parametrize("singularity", SINGULARITY)
def test_limits_in_the_jacobian_count_nothing_in_the_middle_of_all_ranges(singularity, joint_limits):
    middle = 0.5 * (PANDA.limits.lower + PANDA.limits.upper)
    weighted, plain = (Manipulability(singularity, kind).evaluate(PANDA, middle) for kind in (joint_limits, "none"))
    assert weighted == pytest.approx(plain, rel=1e-7)
    assert plain > 0.0


@pytest.mark.parametrize("name", ROBOT_NAMES)
@pytest.mark.parametrize("singularity", SINGULARITY)
def test_a_singular_configuration_has_no_manipulability_and_a_finite_gradient(name, singularity):
    robot, measure = load_robot(name), Manipulability(singularity, joint_limits="none")
    stretched = np.zeros(robot.n)
    assert 0.0 <= measure.evaluate(robot, stretched) < 1e-7
    assert np.all(np.isfinite(measure.gradient(robot, stretched)))


def test_the_length_matters_except_to_yoshikawa():
    q = PANDA.home
    for singularity in SINGULARITY:
        short, long = (Manipulability(singularity, length=length).evaluate(PANDA, q) for length in (0.1, 1.0))
        assert (short == long) == (singularity == "yoshikawa")


@pytest.mark.skipif(compiler() is None, reason="no C compiler here")
def test_interpreted_measures_equal_compiled_ones(monkeypatch):
    q = PANDA.random_configuration(np.random.default_rng(5), (40,))
    compiled = [Manipulability(s).evaluate(PANDA, q) for s in SINGULARITY]
    monkeypatch.setenv("OPTSC_COMPILER", "none")
    fresh = load_robot("panda")
    for singularity, M in zip(SINGULARITY, compiled, strict=True):
        np.testing.assert_allclose(Manipulability(singularity).evaluate(fresh, q), M, rtol=1e-9)


def test_unknown_definitions_are_refused_with_the_known_ones():
    with pytest.raises(UnknownName, match="inverse_condition"):
        Manipulability("yoshi")
    with pytest.raises(UnknownName, match="tsai_raw"):
        Manipulability(joint_limits="hard")
    with pytest.raises(InvalidValue, match="length"):
        Manipulability(length=0.0)
    with pytest.raises(InvalidValue, match="k is"):
        Manipulability(k=float("nan"))


def test_configurations_that_are_none_are_refused():
    measure = Manipulability()
    with pytest.raises(InvalidValue):
        measure.evaluate(PANDA, np.zeros(6))
    with pytest.raises(InvalidValue):
        measure.evaluate(PANDA, np.full(7, np.nan))
    with pytest.raises(InvalidValue):
        measure.gradient(PANDA, np.zeros((2, 7)))
