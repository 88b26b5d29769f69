"""What a run of the fault test must not do, whatever the fault is: break limits, tell an untruth, be of no more use."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from optsc.control.measured_arm import TrackingTolerance
from optsc.control.modes import Mode
from optsc.control.status import Status
from optsc.robot import RobotModel
from optsc.study.faults.answers import answered, follows, tool_error
from optsc.study.faults.run import SETTLED, Record, RunRow

TOLERANCE = 1e-9
"""What is taken for rounding, in the unit of each limit."""
AT_REST = 1e-4
"""Joint speed [rad/s] below which an arm is at rest."""
NEAR = (1e-3, 5e-3)
"""Distance and angle to the true target [m, rad] within which "following" is true at rest."""
LARGEST_JUMP = TrackingTolerance().resume
"""Of the arm itself in one period, beyond what it moves at its greatest speed [rad]: motion may begin this far away."""


def problems(robot: RobotModel, period: float, record: Record) -> list[str]:
    """Return what is wrong with a run, in words; empty where nothing is."""
    found = [] if record.exception is None else [f"raised {record.exception}"]
    rows = [row for row in record.rows if row.step is not None]
    if not rows:
        return [*found, "no tick was done"]
    found += broken_limits(period, record, rows)
    known = rows[record.again :] if record.fault.recouples else rows
    found += untruths(robot, known)
    if record.interrupted is False:
        found.append("an interrupt left half a tick behind")
    if record.jump > LARGEST_JUMP:
        found.append(f"the arm jumped by {record.jump:.3f} rad")
    if record.exception is None:
        found += answered(robot, record)
        found += no_use(robot, record)
    return found


def broken_limits(period: float, record: Record, rows: list[RunRow]) -> Iterator[str]:
    """Yield which finite differences of the commands break a limit, or do not belong to one motion."""
    commands = [row.step.command for row in rows if row.step is not None]
    q = np.vstack([record.first[:, 0], *(c.q for c in commands)])
    v = np.vstack([record.first[:, 1], *(c.v for c in commands)])
    a = np.vstack([record.first[:, 2], *(c.a for c in commands)])
    limits = [row.limits for row in rows]
    if record.fault.restarts:
        q, v, a, limits, rows = q[1:], v[1:], a[1:], limits[1:], rows[1:]
    if not np.isfinite(np.hstack([q, v, a])).all():
        yield "a command is not finite"
        return
    jerk, acceleration = (np.array([getattr(one, name) for one in limits]) for name in ("jerk", "acceleration"))
    velocity = np.array([np.maximum(one.velocity, record.limits.velocity) for one in limits])
    lower, upper = (np.array([getattr(one, name) for one in limits]) for name in ("lower", "upper"))
    excess = {
        "continuity": np.abs(q[1:] - q[:-1] - 0.5 * period * (v[1:] + v[:-1])),
        "the difference of velocities": np.abs(v[1:] - v[:-1] - period * a[1:]),
        "jerk": np.abs(a[1:] - a[:-1]) / period - jerk,
        "acceleration": np.abs(a[1:]) - acceleration,
        "velocity": np.abs(v[1:]) - velocity,
        "position": np.maximum(lower - q[1:], q[1:] - upper),
    }
    for name, over in excess.items():
        worst = over.max(axis=1)
        if (worst > TOLERANCE).any():
            k = int(np.argmax(worst > TOLERANCE))
            yield f"{name} of a command is off by up to {worst.max():.3g}, first at {rows[k].time:.3f} s"
    if np.any(np.abs(v[-1]) > limits[-1].velocity + TOLERANCE):
        yield "the velocity of the last command is above the limits that were set"


def untruths(robot: RobotModel, rows: list[RunRow]) -> Iterator[str]:
    """Yield where "following" or "finished" was said and was not so."""
    for row in rows:
        step = row.step
        if step is None or row.X_WT is None or row.resting < SETTLED or step.mode is not Mode.MANUAL:
            continue
        if step.command.status is Status.FOLLOWING and np.abs(step.command.v).max() < AT_REST:
            # A status is about the command; that the arm is elsewhere is told by its tracking error.
            distance, angle = tool_error(robot, row, row.X_WT, step.command.q)
            if distance > NEAR[0] or angle > NEAR[1]:
                yield (
                    f"following at rest, {1e3 * distance:.1f} mm and {1e3 * angle:.0f} mrad off the target "
                    f"at {row.time:.3f} s"
                )
                break
    untrue = next((row for row in rows if row.finished and not row.holding), None)
    if untrue is not None:
        yield f"finished with nothing in the jaws at {untrue.time:.3f} s"


def no_use(robot: RobotModel, record: Record) -> Iterator[str]:
    """Yield why the operator cannot lead the arm on after the fault."""
    row = record.rows[-1]
    step = row.step
    if step is None:
        yield "the last tick was interrupted"
        return
    if step.mode is not Mode.MANUAL:
        yield f"cannot be led on: {step.mode.value}, {step.reason or step.command.status.value}"
        return
    if row.X_WT is not None and not record.fault.far:
        distance, angle = tool_error(robot, row, row.X_WT)
        if distance > NEAR[0] or angle > NEAR[1]:
            yield (
                f"led on, the tool is {1e3 * distance:.1f} mm and {1e3 * angle:.0f} mrad off, "
                f"{step.command.status.name}: {step.reason}"
            )
        elif not follows(record.fault, step):
            yield f"led on, the tool is there and the status {step.command.status.name}: {step.reason}"
