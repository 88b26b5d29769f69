"""Whether the controller has answered a fault as it is expected to."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from optsc.control.controller_state import ControlStep
from optsc.control.modes import Mode
from optsc.control.status import Status
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.robot import RobotModel
from optsc.study.faults.fault import Answer, Fault
from optsc.study.faults.run import ENGAGES, Record, RunRow

AT_REST = 1e-6
"""Joint speed [rad/s] below which an arm has come to rest."""


def tool_error(robot: RobotModel, row: RunRow, X_WT: Pose, q: Array | None = None) -> tuple[float, float]:
    """Return distance [m] and angle [rad] of the tool, at ``q`` (n,) or where the arm is, to where the hand leads it.

    Who takes over leads the tool on as it is, or to the orientation of the hand; both are right.
    """
    at = robot.forward(row.q if q is None else q)
    angles = [angle_between(at.quaternion, q) for q in (X_WT.quaternion, row.hand_q)]
    return float(np.linalg.norm(at.translation - X_WT.translation)), min(angles)


def follows(fault: Fault, step: ControlStep) -> bool:
    """Tell whether the status says that the tool is where it is led to; a loop that is late may be called so."""
    return step.command.status is Status.FOLLOWING or (fault.timed and step.command.status is Status.LATE)


def angle_between(a: Array, b: Array) -> float:
    """Return the angle [rad] between two orientations."""
    return float(np.linalg.norm(rotation.log(rotation.multiply(a, rotation.conjugate(b)))))


def answered(robot: RobotModel, record: Record) -> Iterator[str]:
    """Yield what is not as expected."""
    answer = record.fault.expected.of(record.mode)
    rows = [row for row in record.rows[: record.again] if row.step is not None]
    if not rows:
        return
    came = {row.step.mode for row in rows if row.step is not None}
    for mode in answer.never:
        if mode in came and mode is not record.mode:
            yield f"came to {mode.value}"
    if answer.turning < np.inf:
        first = robot.forward(record.first[:, 0]).quaternion
        turned = max(angle_between(robot.forward(row.q).quaternion, first) for row in rows)
        if turned > answer.turning:
            yield f"the tool turned by {turned:.2f} rad"
    carrying = record.fault.keeps_jaws and record.mode in (Mode.LIFT, Mode.CARRY)
    if carrying and max(row.opening for row in rows) > rows[0].opening + 1e-4:
        yield f"the jaws opened to {1e3 * max(row.opening for row in rows):.0f} mm"
    yield from _ANSWERS[answer.name](robot, record, rows, answer)


def _goes_on(robot: RobotModel, record: Record, rows: list[RunRow], answer: Answer) -> Iterator[str]:
    by_hand, before = record.mode in (Mode.HOLD, Mode.MANUAL), record.mode
    for row in rows:
        step = row.step
        left = record.mode is not Mode.HOLD or row.time > ENGAGES + 0.1
        if step is not None and left and step.mode is Mode.HOLD:
            yield f"does not go on: holds at {row.time:.3f} s, {step.reason or 'without a reason'}"
            return
        if step is not None and step.mode is Mode.MANUAL and not by_hand:
            # The robot is done after it has let go of something and moved back.
            if before is not Mode.RETREAT:
                yield f"does not go on: manual at {row.time:.3f} s, {step.reason or 'without a reason'}"
            return
        before = before if step is None else step.mode
    if answer.within is None or not by_hand:
        return
    errors = [tool_error(robot, row, row.X_WT)[0] for row in rows if row.X_WT is not None]
    if max(errors) > answer.moving:
        yield f"the tool is up to {1e3 * max(errors):.1f} mm from where the hand leads it"
    if errors[-1] > answer.within:
        yield f"the tool is {1e3 * errors[-1]:.1f} mm from where the hand has led it"
    step = rows[-1].step
    if step is not None and answer.follows and not follows(record.fault, step):
        yield f"does not follow at the end: {step.command.status.name}, {step.reason}"


def _rests(robot: RobotModel, record: Record, rows: list[RunRow], answer: Answer) -> Iterator[str]:
    yield from _at_rest(rows, (record.mode,))


def _holds(robot: RobotModel, record: Record, rows: list[RunRow], answer: Answer) -> Iterator[str]:
    yield from _at_rest(rows, (Mode.HOLD,), answer.led)
    yield from _says(rows[-1].step, answer)


def _stops(robot: RobotModel, record: Record, rows: list[RunRow], answer: Answer) -> Iterator[str]:
    yield from _at_rest(rows, (Mode.HOLD, Mode.MANUAL))
    yield from _says(rows[-1].step, answer)


def _stays(robot: RobotModel, record: Record, rows: list[RunRow], answer: Answer) -> Iterator[str]:
    left = next((row for row in rows if row.step is not None and row.step.mode is not Mode.HOLD), None)
    if left is not None and left.step is not None:
        yield f"leaves hold at {left.time:.3f} s for {left.step.mode.value}"
    else:
        yield from _holds(robot, record, rows, answer)


def _is_safe(robot: RobotModel, record: Record, rows: list[RunRow], answer: Answer) -> Iterator[str]:
    step = rows[-1].step
    engaged = record.mode is not Mode.HOLD
    if step is not None and engaged and step.mode is Mode.HOLD and not step.reason:
        yield "holds without a reason"


def _at_rest(rows: list[RunRow], modes: tuple[Mode, ...], led: bool = False) -> Iterator[str]:
    step = rows[-1].step
    if step is None:
        return
    if step.mode not in modes:
        yield f"is in {step.mode.value}, not in {' or '.join(mode.value for mode in modes)}"
    elif not step.reason:
        yield f"is at rest in {step.mode.value} without a reason"
    if np.abs(step.command.v).max() > AT_REST and not led:
        yield f"has not come to rest: {np.abs(step.command.v).max():.3g} rad/s"


def _says(step: ControlStep | None, answer: Answer) -> Iterator[str]:
    if step is not None and answer.says and not any(word in step.reason for word in answer.says):
        yield f"the reason says {step.reason!r}, nothing of {' / '.join(answer.says)}"


_ANSWERS: dict[str, Callable[[RobotModel, Record, list[RunRow], Answer], Iterator[str]]] = {
    "goes on": _goes_on,
    "rests": _rests,
    "holds": _holds,
    "stays in hold": _stays,
    "stops": _stops,
    "is safe": _is_safe,
}
