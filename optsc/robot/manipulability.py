"""Penalised manipulability M = S L: how far a posture is from singularities (S) and from joint limits (L).

With the singular values σ of the Jacobian J (the min(6, n) greatest), S is one of

* ``yoshikawa``: the product of the σ, which is √det(J Jᵀ) for six joints or more; T. Yoshikawa,
  "Manipulability of robotic mechanisms", IJRR 4(2), 1985. Its unit depends on the arm, so it compares
  postures of one arm;
* ``inverse_condition``: least over greatest σ, in [0, 1];
* ``minimum_singular_value``: least σ [m].

The latter two compare metres with radians, so the angular rows of J are multiplied by a length first. L is
one of, with lower and upper limits l and u,

* ``tsai``: (1 - exp(-k x)) / (1 - exp(-k)), x = Πᵢ 4 (qᵢ - lᵢ) (uᵢ - qᵢ) / (uᵢ - lᵢ)²: 1 in the middle of all
  ranges;
* ``tsai_raw``: 1 - exp(-k x), x without the factors of four, as in Simox and MoveIt; after M.-J. Tsai, PhD
  thesis, Ohio State University, 1986;
* ``none``: 1.

Joints without two limits take no part in L, and L = 0 at a limit and beyond. The definitions prefer different
grasps, so a record of results names the one it used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi
import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry.rotation import Array
from optsc.robot.kernels.kernel import BatchKernel, Kernel, build_batch_kernel, build_kernel
from optsc.robot.kernels.kinematics import chain
from optsc.robot.model import RobotModel

SINGULARITY = ("yoshikawa", "inverse_condition", "minimum_singular_value")
JOINT_LIMITS = ("tsai", "tsai_raw", "none")
LOOP = 32
"""Postures in one compiled loop."""
_TINY = 1e-300


@dataclass(frozen=True)
class Manipulability:
    """A definition of penalised manipulability, see the module.

    Attributes:
        singularity: definition of S.
        joint_limits: definition of L.
        k: steepness of L [-]; the raw form needs a greater one, 50 in Simox.
        length: what the angular rows are multiplied by [m], unless S is ``yoshikawa``.
    """

    singularity: str = "yoshikawa"
    joint_limits: str = "tsai"
    k: float = 5.0
    length: float = 0.15

    def __post_init__(self) -> None:
        if self.singularity not in SINGULARITY:
            raise UnknownName("singularity measure", self.singularity, SINGULARITY)
        if self.joint_limits not in JOINT_LIMITS:
            raise UnknownName("joint limit measure", self.joint_limits, JOINT_LIMITS)
        for name in ("k", "length"):
            value = getattr(self, name)
            if not 0.0 < value < np.inf:
                raise InvalidValue(name, value, "positive and finite")

    @classmethod
    def simox(cls) -> Manipulability:
        """Return the default of Simox (Vahrenkamp et al., Humanoids 2012), with its penalty for limits."""
        return cls("inverse_condition", "tsai_raw", k=50.0, length=0.15)

    def evaluate(self, robot: RobotModel, q: ArrayLike) -> Array:
        """Return M (...), zero or more, at postures ``q`` (..., n).

        Least singular values are roots of eigenvalues of J Jᵀ, so they are good to 1e-8 of the greatest.

        Raises:
            InvalidValue: ``q`` is not finite or has a wrong shape.
        """
        q = robot.checked(q)
        rows = q.reshape(-1, robot.n)
        if self.singularity == "yoshikawa":
            (M,) = _products(robot, self.joint_limits)(rows, shared=(self.k,))
        else:
            gram, L = _grams(robot, self.joint_limits)(rows, shared=(self.k, self.length))
            size = min(6, robot.n)
            squares = np.linalg.eigvalsh(gram.reshape(-1, size, size))[:, [0, -1]]
            least, greatest = np.sqrt(np.maximum(squares, 0.0)).T
            M = L[:, 0] * (least / greatest if self.singularity == "inverse_condition" else least)
        return M.reshape(q.shape[:-1])

    def gradient(self, robot: RobotModel, q: ArrayLike) -> Array:
        """Return dM/dq (n,) at a posture ``q`` (n,).

        M has kinks: at singularities, at the limits, and where two singular values cross. There the result is
        finite, and one of the slopes or between them.

        Raises:
            InvalidValue: ``q`` is not finite or has a wrong shape.
        """
        q = robot.checked(q)
        if q.ndim != 1:
            raise InvalidValue("shape of q", q.shape, f"({robot.n},)")
        if self.singularity == "yoshikawa":
            return _product_slope(robot, self.joint_limits)(q, [self.k])[0]
        slopes = _slopes(robot, self.joint_limits)
        scale = np.array([1.0] * 3 + [self.length] * 3)[:, None]
        J, L, dL, _ = slopes(q, [self.k], np.zeros((6, robot.n)))
        U, sigma, Vt = np.linalg.svd(scale * J, full_matrices=False)
        S, weights = self._measure(sigma)
        # dσᵢ = uᵢᵀ dJ vᵢ, so dS = ⟨G, dJ⟩ with G = U diag(∂S/∂σ) Vᵀ; the scale of the rows goes into G.
        dS = slopes(q, [self.k], scale * ((U * weights) @ Vt))[3]
        return S * dL + L * dS

    def _measure(self, sigma: Array) -> tuple[float, Array]:
        """Return S and ∂S/∂σ for singular values in falling order."""
        weights = np.zeros(len(sigma))
        if self.singularity == "minimum_singular_value":
            weights[-1] = 1.0
            return float(sigma[-1]), weights
        S = float(sigma[-1] / sigma[0])
        weights[-1] += 1.0 / sigma[0]
        weights[0] -= S / sigma[0]
        return S, weights


def _distance_to_limits(robot: RobotModel, kind: str, q: casadi.SX, k: casadi.SX) -> casadi.SX:
    """Return the expression of L."""
    if kind == "none":
        return casadi.SX(1)
    x = casadi.SX(1)
    for i in np.flatnonzero(robot.limits.bounded).tolist():
        lower, upper = robot.limits.lower[i], robot.limits.upper[i]
        # Each factor is cut off on its own: two joints beyond their limits must not make a positive product.
        x *= casadi.fmax(0, (q[i] - lower) * (upper - q[i])) / (upper - lower) ** 2
        x *= 4 if kind == "tsai" else 1
    L = -casadi.expm1(-k * x)
    return L / -casadi.expm1(-k) if kind == "tsai" else L


def _product_of_singular_values(J: casadi.SX) -> casadi.SX:
    """Return the product of the min(6, n) singular values, by Gram-Schmidt.

    Against √det(J Jᵀ) this keeps its digits, and its derivatives, near singularities.
    """
    vectors = casadi.horzsplit(J.T) if J.shape[1] >= 6 else casadi.horzsplit(J)
    product = casadi.SX(1)
    while vectors:
        # The tiny number keeps directions and derivatives finite where a vector vanishes.
        norm = casadi.sqrt(casadi.dot(vectors[0], vectors[0]) + _TINY)
        direction = vectors[0] / norm
        vectors = [v - casadi.dot(direction, v) * direction for v in vectors[1:]]
        product *= norm
    return product


def _penalised_product(robot: RobotModel, kind: str) -> tuple[casadi.SX, casadi.SX, casadi.SX]:
    """Return the symbols q and k, and the expression of M with Yoshikawa's S."""
    q, k = casadi.SX.sym("q", robot.n), casadi.SX.sym("k")
    J = chain(robot, q)[2]
    return q, k, _product_of_singular_values(J) * _distance_to_limits(robot, kind, q, k)


@lru_cache(maxsize=32)
def _products(robot: RobotModel, joint_limits: str) -> BatchKernel:
    q, k, M = _penalised_product(robot, joint_limits)
    return build_batch_kernel(casadi.Function("yoshikawa", [q, k], [M]), LOOP, shared=1)


@lru_cache(maxsize=32)
def _product_slope(robot: RobotModel, joint_limits: str) -> Kernel:
    q, k, M = _penalised_product(robot, joint_limits)
    slope = casadi.densify(casadi.gradient(M, q))
    return build_kernel(casadi.Function("yoshikawa_gradient", [q, k], [slope]))


@lru_cache(maxsize=32)
def _grams(robot: RobotModel, joint_limits: str) -> BatchKernel:
    """Return the kernel q -> J Jᵀ, or Jᵀ J for fewer than six joints, with scaled angular rows, and L."""
    q, k, length = casadi.SX.sym("q", robot.n), casadi.SX.sym("k"), casadi.SX.sym("length")
    J = chain(robot, q)[2]
    J = casadi.vertcat(J[:3, :], length * J[3:, :])
    gram = J @ J.T if robot.n >= 6 else J.T @ J
    L = casadi.densify(_distance_to_limits(robot, joint_limits, q, k))
    function = casadi.Function("gram", [q, k, length], [casadi.densify(gram), L])
    return build_batch_kernel(function, LOOP, shared=2)


@lru_cache(maxsize=32)
def _slopes(robot: RobotModel, joint_limits: str) -> Kernel:
    """Return the kernel (q, k, G) -> J, L, dL/dq, d⟨G, J⟩/dq."""
    q, k, G = casadi.SX.sym("q", robot.n), casadi.SX.sym("k"), casadi.SX.sym("G", 6, robot.n)
    J, L = chain(robot, q)[2], _distance_to_limits(robot, joint_limits, q, k)
    inner = casadi.dot(G, J)
    outputs = [J, L, casadi.gradient(L, q), casadi.gradient(inner, q)]
    return build_kernel(casadi.Function("slopes", [q, k, G], [casadi.densify(o) for o in outputs]))
