"""The parts of penalised manipulability as CasADi functions; `optsc.robot.manipulability` says what they are."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import TypeAlias

import casadi
import numpy as np

from optsc.geometry.rotation import Array
from optsc.kernels.chain import Chain, tool_kinematics
from optsc.kernels.symbols import symbols

HYPEROCTANTS: Array = np.array(list(product((1.0, -1.0), repeat=6))).T
"""Signs (6, 64) of the tool's motion along and about the three axes."""
_TINY = 1e-300

Bounds: TypeAlias = tuple[Array, Array]
"""Lower and upper joint positions, each (n,); infinite for a joint that turns endlessly."""


def _bounded(bounds: Bounds) -> list[bool]:
    return (np.isfinite(bounds[0]) & np.isfinite(bounds[1])).tolist()


def distance_to_limits(bounds: Bounds, kind: str, q: casadi.SX, k: casadi.SX) -> casadi.SX:
    """Return the expression of L, 1 where joint limits enter the Jacobian instead."""
    if not kind.startswith("tsai"):
        return casadi.SX(1)
    x = casadi.SX(1)
    for i in np.flatnonzero(_bounded(bounds)).tolist():
        lower, upper = bounds[0][i], bounds[1][i]
        # Each factor is cut off on its own: two joints beyond their limits must not make a positive product.
        x *= casadi.fmax(0, (q[i] - lower) * (upper - q[i])) / (upper - lower) ** 2
        x *= 4 if kind == "tsai" else 1
    L = -casadi.expm1(-k * x)
    return L / -casadi.expm1(-k) if kind == "tsai" else L


def joint_weights(bounds: Bounds, q: casadi.SX) -> tuple[casadi.SX, casadi.SX]:
    """Return the factors (n,) of Chan and Dubey, and where (-1 to 1) each joint stands between its limits.

    With x from -1 to 1 between the limits, 1 / sqrt(1 + |dH/dq|) is the root of c / (c + 4 |x| / (u - l)) with
    c = (1 - x^2)^2, which is finite everywhere.
    """
    factors, places = [], []
    for i, bounded in enumerate(_bounded(bounds)):
        if not bounded:
            factors.append(casadi.SX(1))
            places.append(casadi.SX(0))
            continue
        lower, upper = bounds[0][i], bounds[1][i]
        x = (2 * q[i] - upper - lower) / (upper - lower)
        c = casadi.fmax(0, 1 - x * x) ** 2
        factors.append(casadi.sqrt(c / (c + 4 * casadi.fabs(x) / (upper - lower)) + _TINY))
        places.append(x)
    return casadi.vertcat(*factors), casadi.vertcat(*places)


def weighted_jacobian(chain: Chain, bounds: Bounds, kind: str, q: casadi.SX, signs: casadi.SX) -> casadi.SX:
    """Return the Jacobian (6, n) with the joint limits in it; ``signs`` (6,) is the hyperoctant where that counts."""
    J = tool_kinematics(chain, q)[2]
    if kind not in ("chan_dubey", "vahrenkamp"):
        return J
    factors, places = joint_weights(bounds, q)
    if kind == "chan_dubey":
        return J * casadi.repmat(factors.T, 6, 1)
    return _in_hyperoctant(J, factors, places, signs)


def _in_hyperoctant(J: casadi.SX, factors: casadi.SX, places: casadi.SX, signs: casadi.SX) -> casadi.SX:
    """Return the Jacobian weighted where the motion with these signs (6,) leads towards the nearer limit."""
    # Moving the tool with these signs needs joint j to go up through entry i where their product is positive.
    up = casadi.repmat(signs, 1, J.shape[1]) * J > 0
    at_upper = casadi.repmat(places.T > 0, 6, 1)
    towards = casadi.logic_or(casadi.logic_and(up, at_upper), casadi.logic_and(1 - up, 1 - at_upper))
    return J * casadi.if_else(towards, casadi.repmat(factors.T, 6, 1), 1)


def _over_hyperoctants(
    chain: Chain, bounds: Bounds, value: Callable[[casadi.SX, casadi.SX], casadi.SX]
) -> casadi.Function:
    """Return (q, length) -> ``value`` of the weighted Jacobian and the length, in all hyperoctants side by side."""
    n, angles = chain.n, casadi.SX.sym("q", chain.n)
    placed = [tool_kinematics(chain, angles)[2], *joint_weights(bounds, angles)]
    kinematics = casadi.Function("placed", [angles], [casadi.densify(x) for x in placed])
    parts = symbols(casadi.SX, J=(6, n), factors=n, places=n, length=1, signs=6)
    J, factors, places, scale, signs = parts
    one = casadi.Function("one", parts, [value(_in_hyperoctant(J, factors, places, signs), scale)])
    q, length = symbols(casadi.MX, q=n, length=1)
    each = one.map("each", "serial", HYPEROCTANTS.shape[1], [0, 1, 2, 3], [])
    found = each(*kinematics(q), length, casadi.DM(HYPEROCTANTS))
    return casadi.Function("over_hyperoctants", [q, length], [found])


def product_of_singular_values(J: casadi.SX) -> casadi.SX:
    """Return the product of the min(6, n) singular values, by Gram-Schmidt.

    Against √det(J Jᵀ) this keeps its digits, and its derivatives, near singularities.
    """
    vectors = casadi.horzsplit(J.T) if J.shape[1] >= 6 else casadi.horzsplit(J)
    value = casadi.SX(1)
    while vectors:
        # The tiny number keeps directions and derivatives finite where a vector vanishes.
        norm = casadi.sqrt(casadi.dot(vectors[0], vectors[0]) + _TINY)
        direction = vectors[0] / norm
        vectors = [v - casadi.dot(direction, v) * direction for v in vectors[1:]]
        value *= norm
    return value


def _gram(J: casadi.SX, length: casadi.SX) -> casadi.SX:
    """Return J Jᵀ, or Jᵀ J for fewer than six joints, with scaled angular rows."""
    scaled = casadi.vertcat(J[:3, :], length * J[3:, :])
    return casadi.densify(scaled @ scaled.T if J.shape[1] >= 6 else scaled.T @ scaled)


def penalised_product(chain: Chain, bounds: Bounds, kind: str) -> casadi.Function:
    """Return the function (q, k) -> M with Yoshikawa's S; not for hyperoctants."""
    q, k, M = _penalised_product(chain, bounds, kind)
    return casadi.Function("yoshikawa", [q, k], [casadi.densify(M)])


def product_slope(chain: Chain, bounds: Bounds, kind: str) -> casadi.Function:
    """Return the function (q, k) -> dM/dq (n) of `penalised_product`."""
    q, k, M = _penalised_product(chain, bounds, kind)
    return casadi.Function("yoshikawa_gradient", [q, k], [casadi.densify(casadi.gradient(M, q))])


def _penalised_product(chain: Chain, bounds: Bounds, kind: str) -> tuple[casadi.SX, casadi.SX, casadi.SX]:
    q, k = symbols(casadi.SX, q=chain.n, k=1)
    J = weighted_jacobian(chain, bounds, kind, q, casadi.SX.ones(6))
    return q, k, product_of_singular_values(J) * distance_to_limits(bounds, kind, q, k)


def least_product(chain: Chain, bounds: Bounds) -> casadi.Function:
    """Return the function (q, k) -> least product of the singular values in any hyperoctant."""
    q, k = symbols(casadi.MX, q=chain.n, k=1)
    each = _over_hyperoctants(chain, bounds, lambda J, _: product_of_singular_values(J))
    return casadi.Function("least_product", [q, k], [casadi.mmin(each(q, 1.0))])


def grams(chain: Chain, bounds: Bounds, kind: str) -> casadi.Function:
    """Return the function (q, k, length) -> Gram matrices side by side, one or one for each hyperoctant, and L."""
    sizes = {"q": chain.n, "k": 1, "length": 1}
    if kind == "vahrenkamp":
        inputs = symbols(casadi.MX, **sizes)
        found = _over_hyperoctants(chain, bounds, _gram)(inputs[0], inputs[2])
        return casadi.Function("grams", inputs, [found, casadi.MX(casadi.DM.ones(1))])
    q, k, length = inputs = symbols(casadi.SX, **sizes)
    gram = _gram(weighted_jacobian(chain, bounds, kind, q, casadi.SX.ones(6)), length)
    return casadi.Function("gram", inputs, [gram, casadi.densify(distance_to_limits(bounds, kind, q, k))])


def slopes(chain: Chain, bounds: Bounds, kind: str) -> casadi.Function:
    """Return the function (q, k, signs, G) -> J with the limits in it, L, dL/dq, d⟨G, J⟩/dq."""
    inputs = symbols(casadi.SX, q=chain.n, k=1, signs=6, G=(6, chain.n))
    q, k, signs, G = inputs
    J, L = weighted_jacobian(chain, bounds, kind, q, signs), distance_to_limits(bounds, kind, q, k)
    outputs = [J, L, casadi.gradient(L, q), casadi.gradient(casadi.dot(G, J), q)]
    return casadi.Function("slopes", inputs, [casadi.densify(o) for o in outputs])
