"""The joint guard at work: a joint is pushed against its limit as hard as it may be, and a picture of it is drawn."""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import optsc
from optsc.shaping import JointGuard

robot = optsc.load_robot("panda")
guard = JointGuard(robot.limits, period=1e-3)
guard.reset(robot.home)
joint = 5

states = []
for _ in range(1600):
    push = np.where(np.arange(robot.n) == joint, 100.0, 0.0)  # [rad/s], far more than is allowed
    states.append(guard.advance(push))
q, v, a = (np.array([getattr(state, name)[joint] for state in states]) for name in "qva")
jerk = np.diff(a, prepend=0.0) / guard.period

figure = Figure(figsize=(7, 7.5), dpi=120, layout="constrained")
axes = figure.subplots(4, 1, sharex=True)
time = np.arange(1, len(q) + 1) * guard.period
limits = robot.limits
rows = (
    ("position [rad]", q, limits.upper[joint]),
    ("velocity [rad/s]", v, limits.velocity[joint]),
    ("acceleration [rad/s²]", a, limits.acceleration[joint]),
    ("jerk [rad/s³]", jerk, limits.jerk[joint]),
)
for axis, (label, values, limit) in zip(axes, rows, strict=True):
    axis.plot(time, values, color="#1f6fb4")
    for bound in (limit,) if values is q else (limit, -limit):
        axis.axhline(bound, color="#c04a60", linewidth=1, linestyle="--")
    axis.set_ylabel(label)
axes[-1].set_xlabel("time [s]")
axes[0].set_title(f"{robot.joint_names[joint]} pushed against its limit (dashed: limits)")

path = Path(sys.argv[1] if len(sys.argv) > 1 else "viable-interval.png")
figure.savefig(path, metadata={"Software": None})
print(f"rests {limits.upper[joint] - q[-1]:.1e} rad before its limit; picture: {path}")
