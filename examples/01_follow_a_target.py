"""Pose targets in, safe joint commands out: the servo alone, on a circle, and a stop."""

import numpy as np

import optsc

robot = optsc.load_robot("panda")  # or "ur5", "iiwa", "xarm7", or a URDF file and its tip frame
servo = optsc.Servo(robot, rate=500.0)
servo.reset(robot.home)
start = servo.X_WT

for tick in range(1500):
    if tick % 5:  # the target comes at 100 Hz, commands at 500 Hz
        command = servo.step()
        continue
    angle = 2.0 * servo.time
    shift = 0.08 * np.array([np.cos(angle) - 1.0, np.sin(angle), 0.0])  # [m]
    target = optsc.Pose.from_quaternion(start.quaternion, start.translation + shift)
    command = servo.step(target, stamp=servo.time)

wanted = np.linalg.norm(start.translation - servo.X_WT.translation)
print(f"{command.status.value}; {1e3 * wanted:.1f} mm from the start, as the circle asks for")

while np.any(command.v):
    command = servo.stop()
print(f"at rest after {servo.time:.2f} s")
