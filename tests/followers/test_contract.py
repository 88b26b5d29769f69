"""What every follower has to do, tried on each of them."""

import optsc
from optsc.followers import IdealFollower
from optsc.testing import FollowerContract


def world(robot):
    return optsc.sim.tabletop(robot, ("mug", "can"), seed=1)


class TestIdeal(FollowerContract):
    tolerance, jaw_speed = 1e-12, 0.1

    def make_follower(self, robot):
        return IdealFollower(robot, world(robot).X_WO)

    def expected_objects(self, robot):
        return world(robot).X_WO


class TestPyBullet(FollowerContract):
    tolerance, jaw_speed = 2e-5, 0.1

    def make_follower(self, robot):
        return optsc.PyBulletFollower(world(robot))

    def expected_objects(self, robot):
        return world(robot).X_WO


class TestIdealWithoutGripper(FollowerContract):
    tolerance = 1e-12

    def make_robot(self):
        panda = optsc.load_robot("panda")
        return optsc.load_robot(panda.urdf, "panda_hand_tcp", home=panda.home)

    def make_follower(self, robot):
        return IdealFollower(robot)
