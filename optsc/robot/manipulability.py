"""Penalised manipulability M: how far a configuration is from singularities (S) and from joint limits (L).

With the singular values σ of the Jacobian J (the min(6, n) greatest), S is one of

* ``yoshikawa``: the product of the σ, which is √det(J Jᵀ) for six joints or more; T. Yoshikawa,
  "Manipulability of robotic mechanisms", IJRR 4(2), 1985. Its unit depends on the arm, so it compares
  configurations of one arm;
* ``inverse_condition``: least over greatest σ, in [0, 1];
* ``minimum_singular_value``: least σ [m].

The latter two compare metres with radians, so the angular rows of J are multiplied by a length first. Joint limits
multiply S by L, with lower and upper limits l and u one of

* ``tsai``: (1 - exp(-k x)) / (1 - exp(-k)), x = Πᵢ 4 (qᵢ - lᵢ) (uᵢ - qᵢ) / (uᵢ - lᵢ)²: 1 in the middle of all
  ranges;
* ``tsai_raw``: 1 - exp(-k x), x without the factors of four, as in Simox and MoveIt; after M.-J. Tsai, PhD
  thesis, Ohio State University, 1986;
* ``none``: 1;

or they enter the Jacobian before its singular values are taken. With H = Σᵢ (uᵢ - lᵢ)² / (4 (uᵢ - qᵢ) (qᵢ - lᵢ)),
whose slope grows without bound towards the limits, column j is multiplied

* ``chan_dubey``: by wⱼ = 1 / √(1 + |∂H/∂qⱼ|); T. F. Chan, R. V. Dubey, "A weighted least-norm solution based scheme
  for avoiding joint limits for redundant joint manipulators", IEEE T-RA 11(2), 1995;
* ``vahrenkamp``: by wⱼ only where the motion goes towards the nearer limit. For each of the 64 combinations of
  signs γ of the tool's motion, entry (i, j) is multiplied where γᵢ Jᵢⱼ has the sign of that motion; M is the least S of
  all; N. Vahrenkamp, T. Asfour, G. Metta, G. Sandini, R. Dillmann, "Manipulability analysis", Humanoids 2012,
  without its factor for obstacles (a clearance is a cost of its own here).

Joints without two limits take no part, and M = 0 at a limit and beyond (but for ``none``; with the latter two where
the arm loses a direction by it). The definitions prefer different grasps, so a record of results names the one it
used; `DEFINITIONS` names the common ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import ArrayLike

from optsc.checks import Checked, OneOf, Positive
from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.kernels import manipulability as parts
from optsc.kernels.kernel import BatchKernel, Kernel, build_batch_kernel, build_kernel
from optsc.robot.model import RobotModel

SINGULARITY = ("yoshikawa", "inverse_condition", "minimum_singular_value")
JOINT_LIMITS = ("tsai", "tsai_raw", "chan_dubey", "vahrenkamp", "none")
SAMPLES = 256
"""Configurations that stand for the workspace of an arm."""
MEASURES_PER_LOOP = 8
"""Configurations in one compiled loop."""


class ManipulabilityMeasure(Protocol):
    """How well an arm can move: `Manipulability`, or a user-defined measure."""

    def evaluate(self, robot: RobotModel, q: Array) -> Array:
        """Return the measure (...) at configurations ``q`` (..., n); higher is better."""


@dataclass(frozen=True)
class Manipulability(Checked):
    """A definition of penalised manipulability, see the module.

    Attributes:
        singularity: definition of S.
        joint_limits: how joint limits count.
        k: steepness of L [-]; the raw form needs a greater one, 50 in Simox.
        length: what the angular rows are multiplied by [m], unless S is ``yoshikawa``.
    """

    singularity: Annotated[str, OneOf(SINGULARITY, "singularity measure")] = "yoshikawa"
    joint_limits: Annotated[str, OneOf(JOINT_LIMITS, "joint limit measure")] = "tsai"
    k: Annotated[float, Positive] = 5.0
    length: Annotated[float, Positive] = 0.15

    @classmethod
    def simox(cls) -> Manipulability:
        """Return the default of Simox (Vahrenkamp et al., Humanoids 2012), with its penalty for limits."""
        return cls("inverse_condition", "tsai_raw", k=50.0, length=0.15)

    def evaluate(self, robot: RobotModel, q: ArrayLike) -> Array:
        """Return M (...), zero or more, at configurations ``q`` (..., n).

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
            matrices = gram.reshape(len(rows), gram.shape[1] // size**2, size, size)
            squares = np.linalg.eigvalsh(matrices)[..., [0, -1]]
            least, greatest = np.sqrt(np.maximum(np.moveaxis(squares, -1, 0), 0.0))
            if self.singularity == "inverse_condition":
                least = np.divide(least, greatest, out=np.zeros_like(least), where=greatest > 0.0)
            M = L[:, 0] * least.min(axis=1)
        return M.reshape(q.shape[:-1])

    def gradient(self, robot: RobotModel, q: ArrayLike) -> Array:
        """Return dM/dq (n,) at a configuration ``q`` (n,).

        M has kinks: at singularities, at the limits, in the middle between them where they enter the Jacobian, and
        where two singular values or two hyperoctants change places. There the result is finite, and one of the
        slopes or between them.

        Raises:
            InvalidValue: ``q`` is not finite or has a wrong shape.
        """
        q = robot.checked(q)
        if q.ndim != 1:
            raise InvalidValue("shape of q", q.shape, f"({robot.n},)")
        if self.singularity == "yoshikawa" and self.joint_limits != "vahrenkamp":
            return _product_slope(robot, self.joint_limits)(q, [self.k])[0]
        slopes = _slopes(robot, self.joint_limits)
        length = 1.0 if self.singularity == "yoshikawa" else self.length
        scale = np.array([1.0] * 3 + [length] * 3)[:, None]
        signs = self._worst_signs(slopes, q, scale)
        J, L, dL, _ = slopes(q, [self.k], signs, np.zeros((6, robot.n)))
        U, sigma, Vt = np.linalg.svd(scale * J, full_matrices=False)
        S, weights = self._measure(sigma)
        # dσᵢ = uᵢᵀ dJ vᵢ, so dS = ⟨G, dJ⟩ with G = U diag(∂S/∂σ) Vᵀ; the scale of the rows goes into G.
        dS = slopes(q, [self.k], signs, scale * ((U * weights) @ Vt))[3]
        return S * dL + L * dS

    def _worst_signs(self, slopes: Kernel, q: Array, scale: Array) -> Array:
        """Return the signs (6,) of the hyperoctant that M is taken from; any where there are none."""
        octants = parts.HYPEROCTANTS.T
        if self.joint_limits != "vahrenkamp":
            return octants[0]
        none = np.zeros((6, len(q)))
        found = [scale * slopes(q, [self.k], signs, none)[0] for signs in octants]
        values = [self._measure(np.asarray(np.linalg.svd(J, compute_uv=False), dtype=float))[0] for J in found]
        return octants[int(np.argmin(values))]

    def _measure(self, sigma: Array) -> tuple[float, Array]:
        """Return S and ∂S/∂σ for singular values in falling order."""
        weights = np.zeros(len(sigma))
        if self.singularity == "yoshikawa":
            others = np.where(np.eye(len(sigma), dtype=bool), 1.0, sigma)
            return float(np.prod(sigma)), np.prod(others, axis=1)
        if self.singularity == "minimum_singular_value":
            weights[-1] = 1.0
            return float(sigma[-1]), weights
        if sigma[0] == 0.0:
            return 0.0, weights
        S = float(sigma[-1] / sigma[0])
        weights[-1] += 1.0 / sigma[0]
        weights[0] -= S / sigma[0]
        return S, weights


DEFINITIONS: Mapping[str, Manipulability] = MappingProxyType(
    {
        "yoshikawa": Manipulability(joint_limits="none"),
        "yoshikawa-tsai": Manipulability(),
        "yoshikawa-tsai-raw": Manipulability(joint_limits="tsai_raw", k=50.0),
        "inverse-condition": Manipulability("inverse_condition", "none"),
        "inverse-condition-tsai": Manipulability("inverse_condition"),
        "simox": Manipulability.simox(),
        "minimum-singular-value": Manipulability("minimum_singular_value", "none"),
        "minimum-singular-value-tsai": Manipulability("minimum_singular_value"),
        "chan-dubey": Manipulability("yoshikawa", "chan_dubey"),
        "chan-dubey-inverse-condition": Manipulability("inverse_condition", "chan_dubey"),
        "vahrenkamp": Manipulability("inverse_condition", "vahrenkamp"),
        "vahrenkamp-volume": Manipulability("yoshikawa", "vahrenkamp"),
    }
)
"""The common definitions by name, for studies that compare them; "yoshikawa-tsai" is the default."""


@lru_cache(maxsize=32)
def _products(robot: RobotModel, joint_limits: str) -> BatchKernel:
    if joint_limits == "vahrenkamp":
        return build_batch_kernel(parts.least_product(robot.chain, robot.limits.positions), MEASURES_PER_LOOP, shared=1)
    return build_batch_kernel(
        parts.penalised_product(robot.chain, robot.limits.positions, joint_limits),
        MEASURES_PER_LOOP,
        shared=1,
    )


@lru_cache(maxsize=32)
def _product_slope(robot: RobotModel, joint_limits: str) -> Kernel:
    return build_kernel(parts.product_slope(robot.chain, robot.limits.positions, joint_limits))


@lru_cache(maxsize=32)
def _grams(robot: RobotModel, joint_limits: str) -> BatchKernel:
    return build_batch_kernel(
        parts.grams(robot.chain, robot.limits.positions, joint_limits), MEASURES_PER_LOOP, shared=2
    )


@lru_cache(maxsize=32)
def _slopes(robot: RobotModel, joint_limits: str) -> Kernel:
    return build_kernel(parts.slopes(robot.chain, robot.limits.positions, joint_limits))


@lru_cache(maxsize=32)
def typical_volume(robot: RobotModel) -> float:
    """Return the median of Yoshikawa's index over configurations within the position limits: the arm's own scale.

    The configurations are the same at every call. One configuration, such as home, may happen to be singular.
    """
    rng = np.random.default_rng(0)
    size = min(6, robot.n)
    volumes = [
        np.prod(np.linalg.svd(robot.jacobian(q), compute_uv=False)[:size])
        for q in robot.random_configuration(rng, (SAMPLES,))
    ]
    return float(np.median(volumes))
