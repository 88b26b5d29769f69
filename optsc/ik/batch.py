"""Inverse kinematics of whole poses: many at once, from anywhere (global), within the joint limits.

Every pose is first tried from its seeds, so that the branch found is the one that the arm would be driven to.
What is left starts again from configurations that already hold the tool near the pose: the nearest of a table of
random ones. Each round takes all poses that are left through one compiled loop (`optsc.kernels.search`). Poses that
are still left are tried without limits, which shows why they have no configuration.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.ik.arm import TABLE_SIZE, ArmSearch, arm_search
from optsc.ik.attempts import IkStatus, PoseBatch, restart
from optsc.ik.choice import (
    CHOICES,
    POSES_AT_ONCE,
    Clear,
    MostManipulable,
    NearestToSeed,
    Objective,
    choose,
    collect,
    only_clear,
    refine,
)
from optsc.kernels.search import STARTS
from optsc.robot.manipulability import Manipulability, ManipulabilityMeasure
from optsc.robot.model import RobotModel

RESTARTS = 32
"""Attempts after the seeds': about one in 50 000 reachable poses needs more, and every impossible one pays for all."""
FEW_STARTS = 2 * STARTS
"""Starts for a single pose, before it is left to what poses in numbers get."""
CHOICE_STARTS = 16
"""Starts that a choice is made from, besides the configuration at hand."""
POSE_TOLERANCE = 1e-5
"""Greatest distance [m] and angle [rad] of a solution to its pose; found ones are mostly below 1e-9."""
REASONS = ("", "out of reach", "joint limits", "collision", "not found")
"""The words of each `IkStatus`."""
_WORDS = np.array(REASONS)
_WORDS.flags.writeable = False


class IkSolutions(NamedTuple):
    """Configurations for N poses. Arrays may be shared between calls, and are then read-only.

    Attributes:
        q: (N, n), inside the limits; where there was no success, the one of least residual that was met, or one
            that touches something.
        success: (N,) bool: the pose is met within tolerance, and the configuration clear where that was asked for.
        residual: (N,) the larger of distance ‖p* - p‖ [m] and angle ‖log(R* Rᵀ)‖ [rad] at q; with six
            tolerances, by how much a component of `deviation` exceeds its own: 0 on success.
        reason: (N,) text: empty on success, else one of `REASONS`.
        status: (N,) the same as numbers, see `IkStatus`.
        found: (N,) how many different configurations were compared: 0 or 1 unless a choice had to be made.
    """

    q: Array
    success: NDArray[np.bool_]
    residual: Array
    reason: NDArray[np.str_]
    status: NDArray[np.int8]
    found: NDArray[np.int64]


def deviation(X_WG: Pose, X_WT: Pose) -> Array:
    """Return how tools X_WT deviate from targets X_WG (..., 6): position, tilt about x and y, roll about z.

    In the target's axes [m and rad], as the six tolerances of `solve_ik` bound it. The tilt is the rotation
    vector that takes the target's z axis to the tool's, the roll is the turn about z that is left. With
    D = R_WGᵀ R_WT: tilt = acos(D₂₂) (-D₁₂, D₀₂) / √(D₀₂² + D₁₂²), roll = atan2(D₁₀ - D₀₁, D₀₀ + D₁₁).
    """
    X_GT = X_WG.inverse() @ X_WT
    D = rotation.to_matrix(X_GT.quaternion)
    sine = np.hypot(D[..., 0, 2], D[..., 1, 2])
    angle = np.arctan2(sine, D[..., 2, 2])
    f = angle / np.where(sine > 0.0, sine, 1.0)
    tilt_x = np.where((sine == 0.0) & (angle > 0.0), np.pi, -f * D[..., 1, 2])
    roll = np.arctan2(D[..., 1, 0] - D[..., 0, 1], D[..., 0, 0] + D[..., 1, 1])
    turn = np.stack([tilt_x, f * D[..., 0, 2], roll], axis=-1)
    return np.concatenate([X_GT.translation, turn], axis=-1)


def _choose(
    batch: PoseBatch, index: NDArray[np.intp], samples: int, objective: Objective | None, clear: Clear | None
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Replace the configurations of the poses ``index`` by chosen ones; return which (R,) have one, and of how many."""
    part = batch.subset(index)
    several = collect(part, samples)
    if clear is not None:
        only_clear(several, clear)
    q, usable = choose(part, several, objective)
    rows = np.flatnonzero(usable)
    if objective is not None and (batch.by_component or batch.arm.n > 6) and len(rows):
        q[rows] = refine(part.subset(rows), q[rows], objective, clear)
    # The residual is that of the configuration which is returned: a start that is a solution already stays.
    again = part.unsolved_subset(rows)
    again.attempt(q[rows, None])
    batch.best[index[rows]] = again.best
    return usable, several.found


def _checked_tolerance(tolerance: ArrayLike) -> Array:
    values = np.asarray(tolerance, dtype=float)
    if values.shape not in ((), (6,)):
        raise InvalidValue("shape of tolerance", values.shape, "one number, or (6,) in the tool's axes")
    finite = np.isfinite(values)
    valid = np.all(values > 0.0) and (np.all(finite) if values.ndim == 0 else np.any(finite))
    if not valid:
        words = "positive and finite [m and rad]; of six, all but one may be infinite, which leaves them free"
        raise InvalidValue("tolerance", values.tolist(), words)
    return values.reshape(-1)


def _checked_targets(X_WT: Pose, tolerance: ArrayLike) -> Array:
    """Return rows (N, 8) or (N, 13) as the attempts take them."""
    bounds = _checked_tolerance(tolerance)
    targets = np.empty((math.prod(X_WT.shape), 7 + len(bounds)))
    targets[:, :4] = X_WT.quaternion.reshape(-1, 4)
    targets[:, 4:7] = X_WT.translation.reshape(-1, 3)
    targets[:, 7:] = bounds
    if not np.isfinite(targets[:, :7]).all():
        raise InvalidValue("X_WT", X_WT.matrix().tolist(), "finite")
    return targets


def _checked_seeds(robot: RobotModel, seeds: ArrayLike | None, shape: tuple[int, ...]) -> Array:
    """Return K seeds (N, K, n) for each pose, inside the limits."""
    q, n, count = robot.home, robot.n, math.prod(shape)
    if seeds is not None:
        q = robot.limits.clip(robot.checked(seeds, "seeds"))
    if q.ndim == 1:
        return np.broadcast_to(q, (count, 1, n))
    if q.shape[:-1] == shape:
        return q.reshape(count, 1, n)
    if q.ndim == len(shape) + 2 and q.shape[: len(shape)] == shape and q.shape[-2]:
        return q.reshape(count, -1, n)
    raise InvalidValue("shape of seeds", q.shape, f"({n},), {(*shape, n)} or ({', '.join(map(str, shape))}, K, {n})")


@lru_cache(maxsize=8)
def _of_one(
    shape: tuple[int, ...],
) -> tuple[NDArray[np.bool_], NDArray[np.str_], NDArray[np.int8], NDArray[np.int64]]:
    """Return what success looks like besides configuration and residual, read-only, as every call shares it."""
    success, reason = np.ones(shape, dtype=bool), np.full(shape, "", dtype=_WORDS.dtype)
    status, found = np.zeros(shape, dtype=np.int8), np.ones(shape, dtype=np.int64)
    for array in (success, reason, status, found):
        array.flags.writeable = False
    return success, reason, status, found


def _solve_one(
    arm: ArmSearch, X_WT: Pose, seeds: ArrayLike | None, tolerance: float, restarts: int
) -> IkSolutions | None:
    """Solve a single pose in the buffers of the compiled search; None when that takes many starts.

    It gives what a batch of one would, which also raises the errors: all that is not plain ends here with None.
    """
    n, shape = arm.n, X_WT.shape
    q = arm.robot.home if seeds is None else np.asarray(seeds, dtype=float)
    if q.shape != (n,) or not 0.0 < tolerance < math.inf or not math.isfinite(sum(q.tolist())):
        return None
    with arm.lock:
        found = _search_one(arm, X_WT, q, tolerance, restarts)
    if found is None:
        return None
    success, reason, status, one = _of_one(shape)
    return IkSolutions(found[:n].reshape(*shape, n), success, found[n].reshape(shape), reason, status, one)


def _search_one(arm: ArmSearch, X_WT: Pose, q: Array, tolerance: float, restarts: int) -> Array | None:
    """Return configuration and residual (n + 3,), or None for a pose that is not solved so."""
    n, kernel = arm.n, arm.search_one
    best, target, seed, starts, count = kernel.inputs[:5]
    (out,) = kernel.outputs
    target[:4], target[4:7], target[7] = X_WT.quaternion, X_WT.translation, tolerance
    if not math.isfinite(sum(target.tolist())):
        return None
    np.maximum(q, arm.limits.lower, out=seed)
    np.minimum(seed, arm.limits.upper, out=seed)
    best[:] = arm.nothing
    starts[:, 0], count[0] = seed, 1.0
    kernel.run()
    near: Array | None = None
    for tried in range(0, min(restarts, FEW_STARTS), STARTS):
        if out[n + 1]:
            break
        if near is None:
            folded = arm.folded(seed)
            near = arm.first_table.nearest_to_one(target[:4], target[4:7], folded, FEW_STARTS)
        tries = min(STARTS, restarts - tried)
        best[:], starts[:, :tries], count[0] = out, near[tried : tried + tries].T, tries
        kernel.run()
    return out.copy() if out[n + 1] else None


def _objective(robot: RobotModel, choice: str, measure: ManipulabilityMeasure | None) -> Objective | None:
    if choice not in CHOICES:
        raise UnknownName("choice", choice, CHOICES)
    if choice == "manipulability":
        return MostManipulable(robot, Manipulability() if measure is None else measure)
    return NearestToSeed(robot) if choice == "nearest" else None


def solve_ik(
    robot: RobotModel,
    X_WT: Pose,
    *,
    rng: np.random.Generator | None = None,
    seeds: ArrayLike | None = None,
    restarts: int = RESTARTS,
    tolerance: ArrayLike = POSE_TOLERANCE,
    choice: str = "first",
    samples: int = CHOICE_STARTS,
    measure: ManipulabilityMeasure | None = None,
    clear: Clear | None = None,
) -> IkSolutions:
    """Return a configuration inside the limits for each pose of the tool.

    The results depend on the arguments and the state of ``rng`` alone.

    Args:
        robot: the arm.
        X_WT: the poses, of any batch shape (N,); the results have the same.
        rng: draws further starts for the few poses that the fixed first table of starts does not solve; None
            stands for a generator of fixed seed.
        seeds: configuration(s) to start from, by default the robot's home; moved into the limits: (n,) for all poses,
            (N, n) for each its own, or (N, K, n) for K of each, tried one after another. A joint that can make
            full turns ends within half a turn of its first seed, as far as limits permit.
        restarts: greatest number of attempts from other starts, for poses that their seeds do not solve.
        tolerance: greatest distance [m] and greatest angle [rad] to the pose that count as success. Within it a
            configuration is finished to 1e-9, except where steps lead no nearer: at a singularity, or for a pose
            that is itself out of reach by less than the tolerance. Or six numbers that bound the components of
            `deviation`, in the tool's axes: position x, y, z, tilt about x and y, roll about z. Infinite ones are
            free, and nothing is finished further than they ask.
        choice: "first": the first configuration that is found; "nearest": the one nearest to the (first) seed;
            "manipulability": the one of greatest ``measure``. The latter two compare several configurations and
            use what freedom the pose leaves.
        samples: starts from which configurations are collected, where there is a choice or ``clear`` refuses one.
        measure: what "manipulability" is, by default `optsc.robot.manipulability.Manipulability()`.
        clear: collision check of configurations (R, n) that returns which (R,) touch nothing; a solution has to pass.

    Raises:
        InvalidValue: a pose or seed is not finite, or a shape, a tolerance, ``restarts`` or ``samples`` is
            impossible.
        UnknownName: there is no such choice.
    """
    if restarts < 0:
        raise InvalidValue("restarts", restarts, "zero or more")
    arm, shape = arm_search(robot), X_WT.shape
    if choice == "first" and clear is None and isinstance(tolerance, float) and math.prod(shape) == 1:
        solution = _solve_one(arm, X_WT, seeds, tolerance, restarts)
        if solution is not None:
            return solution
    if not 1 <= samples < TABLE_SIZE:
        raise InvalidValue("samples", samples, f"1 to {TABLE_SIZE - 1}")
    objective = _objective(robot, choice, measure)
    starts = _checked_seeds(robot, seeds, shape)
    batch = PoseBatch(arm, _checked_targets(X_WT, tolerance), starts[:, 0])
    batch.attempt(starts)
    status = np.zeros(len(starts), dtype=np.int8)
    unsolved = np.flatnonzero(~batch.success)
    if len(unsolved):
        part = batch.subset(unsolved)
        status[unsolved] = restart(part, restarts, rng)
        batch.best[unsolved] = part.best
    found = batch.success.astype(np.int64)
    _apply_choice(batch, status, found, samples, objective, clear)
    return IkSolutions(
        q=batch.q.copy().reshape(*shape, arm.n),
        success=(status == IkStatus.SOLVED).reshape(shape),
        residual=batch.residual.reshape(shape),
        reason=_WORDS[status].reshape(shape),
        status=status.reshape(shape),
        found=found.reshape(shape),
    )


def _apply_choice(
    batch: PoseBatch,
    status: NDArray[np.int8],
    found: NDArray[np.int64],
    samples: int,
    objective: Objective | None,
    clear: Clear | None,
) -> None:
    """Make the choice for the poses that are solved; fills in statuses and numbers of configurations (N,)."""
    index = np.flatnonzero(status == IkStatus.SOLVED)
    if objective is None:
        if clear is None or not len(index):
            return
        index = index[~np.asarray(clear(batch.q[index]), dtype=bool)]
    for start in range(0, len(index), POSES_AT_ONCE):
        rows = index[start : start + POSES_AT_ONCE]
        usable, found[rows] = _choose(batch, rows, samples, objective, clear)
        status[rows[~usable]] = IkStatus.COLLISION
