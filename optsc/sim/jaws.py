"""Two jaws of any body in PyBullet: pads that hold, jaws that move alike, and drives that reach their force."""

from __future__ import annotations

from collections.abc import Sequence

import pybullet


def prepare_pads(client: int, body: int, fingers: Sequence[int], friction: float, torsion: float) -> None:
    """Give the links ``fingers`` of ``body`` the contact properties of rubber pads.

    Args:
        client: PyBullet's number of the simulation.
        body: of the hand or of the arm with its hand.
        fingers: indices of the two jaws' links.
        friction: Coulomb coefficient of the pads [-]; PyBullet multiplies it by the object's.
        torsion: radius [m] at which a pad's friction resists turning about its normal.
    """
    for finger in fingers:
        pybullet.changeDynamics(
            body,
            finger,
            lateralFriction=friction,
            spinningFriction=torsion,
            # Friction of velocities alone lets what is held creep out of the hand, up to 0.1 mm a second.
            frictionAnchor=1,
            physicsClientId=client,
        )


def couple(client: int, body: int, fingers: Sequence[int]) -> None:
    """Make both jaws of ``body`` move alike: otherwise they slide to one side together with what they hold."""
    nowhere = [0.0, 0.0, 0.0]
    gear = pybullet.createConstraint(
        body,
        fingers[0],
        body,
        fingers[1],
        jointType=pybullet.JOINT_GEAR,
        jointAxis=[0.0, 1.0, 0.0],
        parentFramePosition=nowhere,
        childFramePosition=nowhere,
        physicsClientId=client,
    )
    # A soft gear (erp 0.1, 50 N) lets the jaws drift sideways together by 5 mm at 240 Hz.
    pybullet.changeConstraint(gear, gearRatio=-1, erp=1.0, maxForce=1000, physicsClientId=client)


def drive_jaws(
    client: int, body: int, fingers: Sequence[int], opening: float, force: float, speed: float
) -> None:
    """Let the jaws move towards ``opening`` [m] from now on.

    Args:
        client: PyBullet's number of the simulation.
        body: of the hand or of the arm with its hand.
        fingers: indices of the two jaws' links.
        opening: distance between the pads to reach [m].
        force: greatest force of each jaw [N], which it only reaches where ``speed`` is far from being met.
        speed: greatest speed of each jaw [m/s].
    """
    for finger in fingers:
        pybullet.setJointMotorControl2(
            body,
            finger,
            pybullet.POSITION_CONTROL,
            targetPosition=0.5 * opening,
            force=force,
            maxVelocity=speed,
            physicsClientId=client,
        )
