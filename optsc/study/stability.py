"""Stability of rankings: how much they change when weights are a little different."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from optsc.selection import Cascade, RankingRule, Stage, WeightedSum
from optsc.study.conditions import Condition, OperatorSpec
from optsc.study.engine import Engine
from optsc.study.episode_setup import EpisodeSettings
from optsc.study.scenes import Scene
from optsc.study.statistics import kendall_tau, mean_of

SIZES = (0.05, 0.1, 0.2, 0.5, 1.0)
"""Standard deviations of the logarithms of weights: 0.1 is about ten percent up or down."""
BEST = 30
"""Ranks that are compared: what is further down is never chosen."""


class Stability(NamedTuple):
    """What one size of perturbation does to the ranking of one rule.

    Attributes:
        condition: name of the rule.
        size: see `SIZES`.
        tau: mean of Kendall's tau-b between the `BEST` before and their order after [-].
        low, high: 5th and 95th percentile over scenes and draws.
        same_choice: share of scenes and draws in which the same grasp comes first [-].
    """

    condition: str
    size: float
    tau: float
    low: float
    high: float
    same_choice: float


def perturbed(rule: RankingRule, size: float, rng: np.random.Generator) -> RankingRule:
    """Return ``rule`` with every weight, or every number of grasps that a stage keeps, times exp(size N(0, 1)).

    Rules that have neither come back as they are.
    """
    if isinstance(rule, WeightedSum):
        return WeightedSum(tuple((cost, w * float(np.exp(size * rng.standard_normal()))) for cost, w in rule.terms))
    if isinstance(rule, Cascade):
        stages = [
            stage if stage.keep == 1 else Stage(stage.cost, _count(stage.keep, size, rng)) for stage in rule.steps
        ]
        return Cascade(tuple(stages))
    return rule


def _count(keep: int, size: float, rng: np.random.Generator) -> int:
    return max(1, round(keep * float(np.exp(size * rng.standard_normal()))))


def stability(
    cases: Sequence[tuple[Scene, OperatorSpec]],
    conditions: Sequence[Condition],
    *,
    settings: EpisodeSettings | None = None,
    sizes: Sequence[float] = SIZES,
    draws: int = 8,
    seed: int = 0,
) -> list[Stability]:
    """Return how each rule's ranking at the hand-over changes under perturbations, over all ``cases``.

    Only rankings are made, nothing is executed: about a second for each case.
    """
    taus: dict[tuple[str, float], list[float]] = {(c.name, s): [] for c in conditions for s in sizes}
    same: dict[tuple[str, float], list[bool]] = {place: [] for place in taus}
    for number, (scene, person) in enumerate(cases):
        engine = Engine(scene, person, settings)
        rng = np.random.default_rng([seed, number])
        variants = [
            (c.name, s, replace(c, rule=perturbed(c.rule, s, rng)))
            for c in conditions
            for s in sizes
            for _ in range(draws)
        ]
        choices = engine.choices([*conditions, *(variant for *_, variant in variants)])
        orders = [None if c is None else c.ranking.of(c.target.object_name).tolist() for c in choices]
        bases = dict(zip((c.name for c in conditions), orders, strict=False))
        for (name, size, _), order in zip(variants, orders[len(conditions) :], strict=True):
            base = bases[name]
            if base is not None and order is not None:
                taus[name, size].append(kendall_tau(base[:BEST], order))
                same[name, size].append(base[0] == order[0])
    return [_summary(name, size, taus[name, size], same[name, size]) for name, size in taus]


def _summary(name: str, size: float, taus: list[float], same: list[bool]) -> Stability:
    low, high = np.nanpercentile(taus, [5.0, 95.0]) if taus else (np.nan, np.nan)
    return Stability(name, size, mean_of(taus), float(low), float(high), mean_of(np.array(same, dtype=float)))
