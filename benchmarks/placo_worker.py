"""PlaCo in an interpreter of its own, since its wheel asks for another version of pinocchio.

Started by `benchmarks.tick` with a request on standard input: one JSON line that describes the arm, then one line per
block with targets, and answers each with one JSON line of timings. Imports nothing of optsc.
"""

import json
import sys
import tempfile
from pathlib import Path
from time import perf_counter


def solver_for(request):
    import numpy as np
    import placo

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(request["urdf"], encoding="utf-8")
        robot = placo.RobotWrapper(str(path), placo.Flags.ignore_collisions)
    for name, q, velocity in zip(request["joints"], request["q"], request["velocity"], strict=True):
        robot.set_joint(name, q)
        robot.set_velocity_limit(name, velocity)
    robot.update_kinematics()
    solver = placo.KinematicsSolver(robot)
    solver.dt = request["period"]
    solver.mask_fbase(True)
    solver.enable_joint_limits(True)
    solver.enable_velocity_limits(True)
    frame = solver.add_frame_task(request["tip"], robot.get_T_world_frame(request["tip"]))
    frame.configure("frame", "soft", request["position_cost"] ** 2, request["orientation_cost"] ** 2)
    posture = solver.add_joints_task()
    posture.set_joints(dict(zip(request["joints"], request["q"], strict=True)))
    posture.configure("posture", "soft", request["posture_cost"] ** 2)
    solver.add_regularization_task(1e-8)
    return robot, solver, frame, np


def main():
    request = json.loads(sys.stdin.readline())
    robot, solver, frame, np = solver_for(request)
    print(json.dumps({"ready": True}), flush=True)
    for line in sys.stdin:
        solve, whole = [], []
        for target in json.loads(line):
            start = perf_counter()
            if target is not None:
                frame.T_world_frame = np.array(target)
            before = perf_counter()
            solver.solve(True)
            after = perf_counter()
            robot.update_kinematics()
            whole.append(perf_counter() - start)
            solve.append(after - before)
        error = np.linalg.norm(frame.T_world_frame[:3, 3] - robot.get_T_world_frame(request["tip"])[:3, 3])
        print(json.dumps({"solve": solve, "whole": whole, "error": float(error)}), flush=True)


if __name__ == "__main__":
    main()
