import numpy as np
import pinocchio
import pybullet
import pytest

from optsc.errors import Closed, InvalidValue, UnknownName
from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.robot import load_robot
from optsc.sim import OBJECT_NAMES, ObjectModel, Tabletop, object_model, tabletop
from optsc.sim.bullet_arm import add_robot
from optsc.sim.bullet_bodies import MARGIN, add_object, inertia, shrunk
from optsc.sim.objects.solids import cuboid
from optsc.sim.physics import Physics
from optsc.sim.settings import GRAVITY, PhysicsSettings

STILL = [0.0] * 7


@pytest.fixture(scope="module")
def panda():
    return load_robot("panda")


@pytest.fixture
def client():
    number = pybullet.connect(pybullet.DIRECT)
    yield number
    pybullet.disconnect(number)


def cube(mass=0.2, friction=0.6, size=0.05):
    mesh = cuboid([-size / 2, -size / 2, 0.0], [size / 2, size / 2, size])
    return ObjectModel("cube", mesh, (mesh,), mass, friction)


def lead(physics, start, end, seconds, opening):
    """Lead the arm from one configuration to another with a bell-shaped speed."""
    dt = physics.settings.time_step
    s = np.linspace(0.0, 1.0, round(seconds / dt) + 1)[:, None]
    path = start + (end - start) * (10 * s**3 - 15 * s**4 + 6 * s**5)
    for q, v in zip(path.tolist(), (np.diff(path, axis=0) / dt).tolist(), strict=False):
        physics.step(q, v, opening)


def record(physics):
    q, v = physics.joints()
    poses = [np.append(X.translation, X.quaternion) for X in physics.poses().values()]
    return np.concatenate([q, v, [physics.opening()], *poses]).tobytes()


# ---- bodies ----


def test_mass_properties_of_a_box_are_the_textbook_ones():
    X_OM, moments = inertia(cuboid([-0.1, -0.2, 0.0], [0.1, 0.2, 0.6]), 3.0)
    np.testing.assert_allclose(X_OM.translation, [0.0, 0.0, 0.3], atol=1e-15)
    expected = 3.0 / 12.0 * np.array([0.2**2 + 0.4**2, 0.2**2 + 0.6**2, 0.4**2 + 0.6**2])
    np.testing.assert_allclose(moments, np.sort(expected))


@pytest.mark.parametrize("name", OBJECT_NAMES)
def test_a_torque_turns_an_object_as_its_own_inertia_says(client, name):
    model = object_model(name)
    X_WO = Pose.from_rotation_vector([0.4, -0.3, 0.8], [0.1, 0.2, 1.0])
    body = add_object(client, model, X_WO)
    X_OM, moments = inertia(model.mesh, model.mass)
    R = (X_WO @ X_OM).rotation_matrix()
    torque, step = np.array([0.02, -0.03, 0.05]), 1e-4
    pybullet.setTimeStep(step, physicsClientId=client)
    pybullet.applyExternalTorque(body, -1, torque.tolist(), pybullet.WORLD_FRAME, physicsClientId=client)
    pybullet.stepSimulation(physicsClientId=client)
    _, turning = pybullet.getBaseVelocity(body, physicsClientId=client)
    np.testing.assert_allclose(turning, R @ ((R.T @ torque) / moments) * step, rtol=1e-5, atol=1e-9)


def test_an_object_falls_freely_and_without_turning(panda):
    X_WO = Pose.from_rotation_vector([0.3, 0.2, 0.1], [0.5, 0.0, 0.5])
    model, steps = object_model("mug"), 200
    with Physics(Tabletop(panda, {"mug": model}, {"mug": X_WO})) as physics:
        for _ in range(steps):
            physics.step(panda.home.tolist(), STILL, 0.08)
        X = physics.poses()["mug"]
    # The velocity is integrated first: the sum of 1 to N steps, not the half square.
    fallen = GRAVITY * 1e-6 * steps * (steps + 1) / 2
    np.testing.assert_allclose(X.translation, X_WO.translation - [0.0, 0.0, fallen], atol=1e-9)
    assert rotation.angle(X.quaternion, X_WO.quaternion) < 1e-9


def test_a_mug_is_hollow_and_its_handle_has_a_hole(client):
    add_object(client, object_model("mug"), Pose.identity())
    down = pybullet.rayTest([0.0, 0.0, 0.2], [0.0, 0.0, -0.1], physicsClientId=client)[0]
    assert down[3][2] == pytest.approx(0.005, abs=2e-3)
    across = pybullet.rayTest([0.048, -0.1, 0.046], [0.048, 0.1, 0.046], physicsClientId=client)[0]
    assert across[0] == -1


def test_a_shrunk_piece_rounded_by_the_margin_has_the_size_of_the_piece():
    rng = np.random.default_rng(0)
    for part in object_model("drill").parts:
        inner = shrunk(part)
        directions = rng.normal(size=(200, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        rounded = (directions @ inner.vertices.T).max(axis=1) + MARGIN
        assert np.all(rounded <= (directions @ part.vertices.T).max(axis=1) + 1e-9)
        for axis in np.vstack([np.eye(3), -np.eye(3)]):  # the flat or rounded sides themselves keep their place
            assert (inner.vertices @ axis).max() + MARGIN >= (part.vertices @ axis).max() - 1.5e-3
    floor = min(v[2] for v in shrunk(object_model("box").parts[0]).vertices)
    assert floor == pytest.approx(MARGIN, abs=1e-9)


def test_a_piece_thinner_than_the_margin_is_left_as_it_is():
    sheet = cuboid([0.0, 0.0, 0.0], [0.1, 0.1, 0.001])
    assert shrunk(sheet) is sheet


@pytest.mark.parametrize("name", ["ur5", "xarm7"])
def test_the_arm_has_the_masses_of_its_description_also_where_a_link_has_none(client, name):
    robot = load_robot(name)
    body = add_robot(client, robot, {})
    model = pinocchio.buildModelFromUrdf(str(robot.urdf))
    values = dict(zip(robot.joint_names, robot.home, strict=True))
    q = np.array([values.get(joint, 0.02) for joint in list(model.names)[1:]])
    expected = pinocchio.crba(model, model.createData(), q)
    found = pybullet.calculateMassMatrix(body, q.tolist(), physicsClientId=client)
    np.testing.assert_allclose(found, expected, atol=1e-8)


# ---- the running world ----


def test_objects_at_rest_stay_where_they_are(panda):
    world = tabletop(panda, OBJECT_NAMES, seed=5)
    with Physics(world) as physics:
        for _ in range(100):
            physics.step(panda.home.tolist(), STILL, 0.08)
        settled = physics.poses()
        for _ in range(2000):
            physics.step(panda.home.tolist(), STILL, 0.08)
        for name, X_WO in physics.poses().items():
            assert np.linalg.norm(X_WO.translation - world.X_WO[name].translation) < 2e-5
            assert np.linalg.norm(X_WO.translation - settled[name].translation) < 1e-6
            assert rotation.angle(X_WO.quaternion, settled[name].quaternion) < 5e-5
            assert physics.contacts(name) == {"table"}
            assert not physics.held(name)


def test_reset_forgets_everything_that_happened_before(panda):
    world = tabletop(panda, ("mug", "can"), seed=2)
    reach = panda.home + np.array([0.25, 0.75, 0.0, -0.1, 0.0, -0.3, 0.0])

    def run(physics, seconds=0.3):
        lead(physics, panda.home, reach, seconds, 0.02)
        lead(physics, reach, panda.home + 0.1, 0.15, 0.0)
        return record(physics)

    with Physics(world) as physics:
        first = run(physics)
        physics.reset(reach)
        other = run(physics, 0.1)  # another history, with other contacts
        physics.reset(panda.home)
        assert physics.time == 0.0
        again = run(physics)
    with Physics(world) as new:
        assert first == again == run(new)
    assert first != other


def straight_down(robot, heights, x=0.45):
    """Return configurations with the tool pointing down at (x, 0, height), each from the one before."""
    q, configurations = robot.home, []
    for height in heights:
        for _ in range(200):
            X_WT, J = robot.forward(q), robot.jacobian(q)
            target = Pose.from_quaternion([0.0, 1.0, 0.0, 0.0], [x, 0.0, height])
            turn = rotation.log(rotation.multiply(target.quaternion, rotation.conjugate(X_WT.quaternion)))
            error = np.concatenate([target.translation - X_WT.translation, turn])
            q = q + 0.5 * J.T @ np.linalg.solve(J @ J.T + 1e-6 * np.eye(6), error)
        configurations.append(q)
    return configurations


@pytest.mark.parametrize(
    ("mass", "friction", "holds"),
    [(0.2, 0.6, True), (4.0, 0.6, True), (6.0, 0.6, False), (0.2, 0.02, False)],
)
def test_the_jaws_hold_what_coulomb_friction_lets_them_hold(panda, mass, friction, holds):
    above, at, lifted = straight_down(panda, (0.10, 0.025, 0.175))
    world = Tabletop(panda, {"cube": cube(mass, friction)}, {"cube": Pose.from_translation([0.45, 0.0, 0.0])})
    with Physics(world) as physics:
        physics.reset(above)
        lead(physics, above, at, 0.4, 0.08)
        lead(physics, at, at, 0.6, 0.0)
        assert physics.held("cube")
        assert physics.contacts("cube") >= {"panda_leftfinger", "panda_rightfinger"}
        assert physics.opening() == pytest.approx(0.05, abs=5e-4)
        lead(physics, at, lifted, 0.6, 0.0)
        start = physics.poses()["cube"]
        lead(physics, lifted, lifted, 0.4, 0.0)
        end = physics.poses()["cube"]
        assert physics.held("cube") == holds
    assert (end.translation[2] > 0.148) == holds
    if holds and mass < 1.0:
        # Nothing creeps: friction that resists velocities alone loses 0.01 mm and 0.3 mrad here. (What is nearly too
        # heavy still swings a little so soon after the lift.)
        assert np.linalg.norm(end.translation - start.translation) < 5e-6
        assert rotation.angle(end.quaternion, start.quaternion) < 1e-4


def test_the_jaws_move_alike_also_when_only_one_meets_something(panda):
    (at,) = straight_down(panda, (0.025,))
    block = Pose.from_translation([0.45, 0.01, 0.0])
    with Physics(Tabletop(panda, {"cube": cube(mass=50.0, friction=1.0)}, {"cube": block})) as physics:
        physics.reset(at)
        lead(physics, at, at, 0.6, 0.0)
        assert not physics.held("cube")
        assert physics.opening() == pytest.approx(2 * (0.025 + 0.01), abs=2e-3)


def test_two_simulations_do_not_see_each_other(panda):
    world = tabletop(panda, ("can",), seed=1)
    with Physics(world) as alone:
        lead(alone, panda.home, panda.home + 0.1, 0.05, 0.0)
        expected = record(alone)
    with Physics(world) as first, Physics(tabletop(panda, (), seed=9)) as second:
        lead(second, panda.home, panda.home - 0.1, 0.05, 0.0)
        lead(first, panda.home, panda.home + 0.1, 0.05, 0.0)
        assert record(first) == expected


def test_an_unknown_object_is_refused(panda):
    with Physics(tabletop(panda, ("can",))) as physics:
        for ask in (physics.contacts, physics.held):
            with pytest.raises(UnknownName, match="can"):
                ask("teapot")


def test_a_wrong_posture_is_refused_and_changes_nothing(panda):
    with Physics(tabletop(panda, ())) as physics:
        before = record(physics)
        for wrong in (panda.home[:-1], panda.home * np.nan, np.stack([panda.home, panda.home])):
            with pytest.raises(InvalidValue):
                physics.reset(wrong)
        assert record(physics) == before


def test_closing_twice_is_harmless_and_use_after_closing_is_a_clear_error(panda):
    physics = Physics(tabletop(panda, ("can",)))
    physics.close()
    physics.close()
    for use in (
        physics.joints,
        physics.poses,
        physics.opening,
        lambda: physics.reset(panda.home),
        lambda: physics.held("can"),
        lambda: physics.step(panda.home.tolist(), STILL, 0.08),
    ):
        with pytest.raises(Closed, match="closed"):
            use()


def test_a_window_without_a_display_is_refused(panda, monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(InvalidValue, match="DISPLAY"):
        Physics(tabletop(panda, ()), gui=True)


@pytest.mark.parametrize(
    "wrong",
    [{"time_step": 1 / 240}, {"time_step": 0.0}, {"jaw_force": float("nan")}, {"position_gain": 1.5}],
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(InvalidValue, match=next(iter(wrong))):
        PhysicsSettings(**wrong)


def test_jaws_that_the_description_lacks_are_named(panda):
    from dataclasses import replace

    odd = replace(panda, gripper=replace(panda.gripper, finger_joints=("panda_finger_joint1", "thumb")))
    with pytest.raises(InvalidValue, match="thumb"):
        Physics(Tabletop(odd, {}, {}))


def test_meshes_are_told_apart_although_they_have_one_name(client):
    for size in (0.05, 0.02):
        mesh = TriangleMesh(cube(size=size).mesh.vertices, cube(size=size).mesh.faces)
        body = add_object(client, ObjectModel("thing", mesh, (mesh,), 0.1, 0.5), Pose.identity())
        hit = pybullet.rayTest([0.0, 0.0, 1.0], [0.0, 0.0, -1.0], physicsClientId=client)[0]
        assert hit[0] == body
        assert hit[3][2] == pytest.approx(size, abs=1e-6)
        pybullet.removeBody(body, physicsClientId=client)
