"""Whole-pose inverse kinematics for a thousand poses at once."""

import numpy as np

import optsc

robot = optsc.load_robot("ur5")
rng = np.random.default_rng(0)
poses = robot.forward(robot.random_configuration(rng, (1000,)))

solutions = optsc.solve_ik(robot, poses, rng=rng)
print(f"{solutions.success.mean():.1%} solved, largest residual {solutions.residual[solutions.success].max():.1e}")

manipulability = optsc.Manipulability()  # Yoshikawa's index times the penalty of joint limits
values = manipulability.evaluate(robot, solutions.q)
print(f"penalised manipulability from {values.min():.4f} to {values.max():.4f}")
