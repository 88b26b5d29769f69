"""Contract tests of a grasp cost and of a grasp filter, on random reach tables."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar

import numpy as np

from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.grasps import Candidates
from optsc.selection import GraspCost, GraspFilter, PositionDistance, ReachTable, TableCost, WeightedSum
from optsc.selection.grid import Grid, Situation, situate
from optsc.selection.reach import HALF_TURN, REACHED, UNREACHABLE
from optsc.testing.contract import Contract

JOINTS = 7
CENTRE = np.array([0.5, 0.0, 0.2])
"""About where the candidates are [m]."""


class CandidateContract(Contract):
    """What holds for whatever is said of candidates: frame, signs and order do not matter.

    Attributes:
        depends_on_world: whether the world frame matters, as it does where something looks at the vertical.
        tolerance: by how much numbers that should be equal may differ.
    """

    depends_on_world: ClassVar[bool] = False
    tolerance: ClassVar[float] = 1e-6

    def part(self) -> GraspCost | GraspFilter:
        """Return the cost or filter."""
        raise NotImplementedError

    def said(self, situation: Situation) -> np.ndarray:
        """Return what it says of the places (K, M)."""
        raise NotImplementedError

    def cases(self) -> Iterator[tuple[ReachTable, Pose]]:
        """Yield reach tables that have the columns it reads, each with a pose of the hand."""
        rng = np.random.default_rng(31)
        for counts, symmetric, reached in (((12, 1, 7), True, 0.7), ((9, 5), False, 0.7), ((4,), True, 0.0)):
            candidates = random_candidates(rng, counts, symmetric)
            table = random_table(rng, candidates, reached, self.part().columns)
            grasp = table.X_WG[3, 0]
            far = Pose(rotation.random(rng), np.array([50.0, -50.0, 50.0]))
            for hand in (random_hand(rng), random_hand(rng), grasp, grasp @ HALF_TURN, far):
                yield table, hand

    def of_candidates(self, table: ReachTable, hand: Pose) -> np.ndarray:
        """Return what it says of the candidates (N,), in their order."""
        return Grid(table).layout.gather(np.asarray(self.said(seen(table, hand))))

    def same(self, one: np.ndarray, other: np.ndarray) -> None:
        """Raise `AssertionError` where two arrays differ."""
        np.testing.assert_allclose(one, other, rtol=self.tolerance, atol=self.tolerance)

    def test_it_does_not_depend_on_the_world_frame(self) -> None:
        X_VW = Pose.from_rotation_vector([0.3, -1.1, 0.7], [0.4, -2.0, 1.0])
        for table, hand in self.cases() if not self.depends_on_world else ():
            candidates = replace(table.candidates, X_WG=X_VW @ table.candidates.X_WG)
            moved = replace(table, candidates=candidates, X_WG=X_VW @ table.X_WG, X_WP=X_VW @ table.X_WP)
            self.same(self.of_candidates(moved, X_VW @ hand), self.of_candidates(table, hand))

    def test_it_does_not_depend_on_the_sign_of_a_quaternion(self) -> None:
        rng = np.random.default_rng(32)
        for table, hand in self.cases():
            signs = rng.choice([-1.0, 1.0], (*table.X_WG.shape, 1))
            other = replace(table, X_WG=Pose(signs * table.X_WG.quaternion, table.X_WG.translation))
            opposite = Pose(-hand.quaternion, hand.translation)
            self.same(self.of_candidates(other, opposite), self.of_candidates(table, hand))

    def test_it_does_not_depend_on_the_order_of_the_candidates(self) -> None:
        rng = np.random.default_rng(33)
        for table, hand in self.cases():
            order = rng.permutation(len(table.candidates))
            moved = self.of_candidates(shuffled(table, order), hand)
            self.same(moved, self.of_candidates(table, hand)[order])

    def test_asking_changes_nothing_and_gives_the_same_again(self) -> None:
        for table, hand in self.cases():
            situation = seen(table, hand)
            first, before = np.array(self.said(situation)), contents(situation)
            np.testing.assert_array_equal(self.said(situation), first)
            np.testing.assert_array_equal(self.said(seen(table, hand)), first)
            assert contents(situation) == before, "what it was asked about was changed"


class GraspCostContract(CandidateContract):
    """What `optsc.selection.GraspCost` promises: one finite number with a unit for every candidate; lower is better.

    ::

        class TestMyCost(GraspCostContract):
            depends_on_world = True  # it looks at the vertical

            def make_cost(self):
                return MyCost()
    """

    def make_cost(self) -> GraspCost:
        """Return the cost; to be overridden."""
        raise NotImplementedError

    def part(self) -> GraspCost:
        """Return the cost."""
        return self.make_cost()

    def said(self, situation: Situation) -> Array:
        """Return its values."""
        return self.make_cost().values(situation)

    def test_it_has_a_name_a_unit_and_a_resolution(self) -> None:
        cost = self.make_cost()
        for what in ("name", "unit"):
            text = getattr(cost, what)
            assert isinstance(text, str), f"{what} is {text!r}, not a text"
            assert text, f'the {what} is empty; the unit of a plain number is "-"'
        assert 0.0 < cost.resolution < np.inf, f"resolution is {cost.resolution}"
        assert all(cost.describe(value).strip() for value in (0.0, 0.01, 1.0)), "described in no words"

    def test_it_is_a_finite_number_for_every_candidate(self) -> None:
        cost = self.make_cost()
        for table, hand in self.cases():
            situation = seen(table, hand)
            for values in (cost.values(situation), cost.key(situation)):
                assert values.shape == situation.similarity.shape, f"shape {values.shape}, not (K, M)"
                assert np.all(np.isfinite(situation.grid.layout.gather(values))), "a value is not finite"

    def test_the_key_sorts_as_the_cost_does(self) -> None:
        cost = self.make_cost()
        for table, hand in self.cases():
            situation = seen(table, hand)
            key, values = (
                situation.grid.layout.gather(array) for array in (cost.key(situation), cost.values(situation))
            )
            assert np.diff(values[np.argsort(key)]).min() >= -self.tolerance, "sorted by its key, the cost falls"

    def test_a_weight_of_zero_equals_leaving_it_out(self) -> None:
        other = PositionDistance()
        rules = WeightedSum(((self.make_cost(), 0.0), (other, 2.0))), WeightedSum(((other, 2.0),))
        for table, hand in self.cases():
            situation = seen(table, hand)
            one, two = (rule.select(situation, situation.grid.reachable) for rule in rules)
            np.testing.assert_array_equal(one.keys, two.keys)
            assert one.winner == two.winner, "with a weight of zero it changes the choice"

    def test_ranked_by_it_alone_candidates_come_in_its_order(self) -> None:
        cost = self.make_cost()
        for table, hand in self.cases():
            situation = seen(table, hand)
            selection = WeightedSum(((cost, 3.0),)).select(situation, situation.grid.reachable)
            for line, values in enumerate(cost.values(situation)):
                steps = np.diff(values[selection.order(line)])
                assert steps.min(initial=0.0) >= -self.tolerance, "the ranking is not in its order"

    def test_a_cost_of_the_table_is_that_of_the_twin_to_use(self) -> None:
        cost = self.make_cost()
        if not isinstance(cost, TableCost):
            return
        for table, hand in self.cases():
            situation = seen(table, hand)
            twins = cost.per_twin(situation.grid)
            assert twins.shape == situation.grid.status.shape, f"shape {twins.shape}, not (T, K, M)"
            np.testing.assert_array_equal(situation.chosen(twins), cost.values(situation))


class GraspFilterContract(CandidateContract):
    """What `optsc.selection.GraspFilter` promises: a mask with a reason.

    ::

        class TestMyFilter(GraspFilterContract):
            depends_on_world = True  # it looks at the vertical

            def make_filter(self):
                return MyFilter()
    """

    def make_filter(self) -> GraspFilter:
        """Return the filter; to be overridden."""
        raise NotImplementedError

    def part(self) -> GraspFilter:
        """Return the filter."""
        return self.make_filter()

    def said(self, situation: Situation) -> np.ndarray:
        """Return which places pass."""
        return self.make_filter().passes(situation)

    def test_it_gives_a_mask_with_a_reason(self) -> None:
        assert self.make_filter().reason.strip(), "a filter has a reason"
        for table, hand in self.cases():
            situation = seen(table, hand)
            mask = self.said(situation)
            assert mask.dtype == bool, f"the mask is of {mask.dtype}, not of bool"
            assert mask.shape == situation.similarity.shape, f"shape {mask.shape}, not (K, M)"


def random_candidates(
    rng: np.random.Generator,
    counts: tuple[int, ...] = (150, 150, 150),
    jaw_symmetric: bool = True,
    spread: float = 0.3,
) -> Candidates:
    """Return grasps of up to five objects in all orientations, as many of each as ``counts`` says."""
    total = sum(counts)
    return Candidates(
        object_names=("mug", "can", "box", "drill", "bottle")[: len(counts)],
        object_index=np.repeat(np.arange(len(counts)), counts),
        grasp_index=np.concatenate([np.arange(c) for c in counts]) if counts else np.zeros(0, dtype=int),
        X_WG=Pose(rotation.random(rng, (total,)), CENTRE + rng.uniform(-spread, spread, (total, 3))),
        opening=rng.uniform(0.01, 0.07, total),
        quality=rng.uniform(0.0, 1.0, total),
        jaw_symmetric=jaw_symmetric,
    )


def random_hand(rng: np.random.Generator) -> Pose:
    """Return a pose among the candidates."""
    return Pose(rotation.random(rng), CENTRE + rng.uniform(-0.3, 0.3, 3))


def random_table(
    rng: np.random.Generator, candidates: Candidates, reached: float, columns: frozenset[str]
) -> ReachTable:
    """Return a table of random configurations and columns; ``reached`` is the share of reached rows."""
    stored = candidates.X_WG
    poses = [stored, stored @ HALF_TURN] if candidates.jaw_symmetric else [stored]
    q, p = (np.stack([getattr(X, name) for X in poses], axis=1) for name in ("quaternion", "translation"))
    X_WG = Pose(q, p)
    known = rng.random(X_WG.shape) < reached
    return ReachTable(
        candidates=candidates,
        standoff=0.1,
        X_WG=X_WG,
        X_WP=X_WG @ Pose.from_translation([0.0, 0.0, -0.1]),
        q_grasp=rng.normal(size=(*X_WG.shape, JOINTS)),
        q_pregrasp=rng.normal(size=(*X_WG.shape, JOINTS)),
        status=np.where(known, REACHED, UNREACHABLE).astype(np.int8),
        manipulability=known * rng.random(X_WG.shape),
        seed=np.zeros((*X_WG.shape, JOINTS)),
        columns={name: known * rng.random(X_WG.shape) for name in sorted(columns)},
    )


def shuffled(table: ReachTable, order: np.ndarray) -> ReachTable:
    """Return the same candidates and rows in another order; ``order[j]`` is the old index of the new j-th."""
    names = ("X_WG", "X_WP", "q_grasp", "q_pregrasp", "status", "manipulability", "seed")
    columns = {name: values[order] for name, values in table.columns.items()}
    rows = {name: getattr(table, name)[order] for name in names}
    return replace(table, candidates=table.candidates.select(order), columns=columns, **rows)


def seen(table: ReachTable, hand: Pose) -> Situation:
    """Return the table as seen from a pose of the hand."""
    return situate(Grid(table), hand.quaternion, hand.translation, np.linspace(-0.5, 0.5, JOINTS))


def contents(situation: Situation) -> bytes:
    """Return the numbers of a situation that costs read most."""
    grid = situation.grid
    numbers = (
        grid.positions,
        grid.quaternions,
        grid.status,
        grid.manipulability,
        grid.q_grasp,
        *situation[1:4],
    )
    return b"".join(values.tobytes() for values in numbers)
