"""Search for poses: from thousands of starts to a few refined hypotheses per template, cheap tests first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from optsc.checks import AtLeast, Checked, Positive
from optsc.geometry.rotation import Array
from optsc.perception.pose_hypotheses import PoseHypotheses, free_starts, resting_starts
from optsc.perception.refinement import FREE, PLANAR, Method, align, refine
from optsc.perception.scoring import Fit, FreeSpace, closeness, fit, shape_distance
from optsc.perception.templates import Template

_NEARBY_TURN = np.array([0.06, 0.06, 0.2])  # [rad], standard deviations about the axes of W
_NEARBY_SHIFT = 0.004  # [m]
_FAR, _NEAR = (4.0, 3.0, 2.4), (2.0, 1.6, 1.2, 1.0, 1.0)  # reaches of the two rounds of steps, in tolerances


@dataclass(frozen=True)
class SearchSettings(Checked):
    """How thoroughly poses are looked for.

    Attributes:
        voxel: seen points are averaged in cubes of this edge [m], which also averages their noise.
        most_points: no more averaged points than this are used.
        tolerance: how far a seen point may be from the surface [m].
        yaw_angles: starts about the vertical for what is not symmetric.
        free_rotations: starts in all directions, tried where no resting pose fits.
        rough: starts per template that are aligned coarsely.
        fine: of those, the ones that are aligned finely.
        refined: of those, the ones that differ in shape and are refined in all directions.
        behind: templates whose coarse score is worse than the best one's by more than this are abandoned [-].
        distinct: poses are distinct if the surface sticks out by more than this [m], see `shape_distance`.
        method: of the refinement, see `refine`.
        features: add starts from FPFH features; needs open3d (the ``features`` extra).
    """

    voxel: Annotated[float, Positive] = 0.004
    most_points: Annotated[int, AtLeast(1)] = 500
    tolerance: Annotated[float, Positive] = 0.005
    yaw_angles: Annotated[int, AtLeast(1)] = 24
    free_rotations: Annotated[int, AtLeast(0)] = 120
    rough: Annotated[int, AtLeast(1)] = 100
    fine: Annotated[int, AtLeast(1)] = 32
    refined: Annotated[int, AtLeast(1)] = 4
    behind: Annotated[float, Positive] = 0.35
    distinct: Annotated[float, Positive] = 0.006
    method: Method = "gicp"
    features: bool = False


@dataclass(frozen=True, eq=False)
class RankedHypotheses:
    """Hypotheses of one template's pose with how they fit, best first."""

    template: Template
    hypotheses: PoseHypotheses
    fit: Fit

    @property
    def best(self) -> float:
        """The best score; minus infinity if there are none."""
        return float(self.fit.score[0]) if len(self.hypotheses) else -np.inf


def voxel_means(points: Array, settings: SearchSettings, rng: np.random.Generator) -> Array:
    """Return the means of the points in cubes (M, 3) [m], shuffled, at most as many as wanted."""
    cell = np.floor(points / settings.voxel).astype(np.int64)
    _, index = np.unique(cell - cell.min(axis=0), axis=0, return_inverse=True)
    index = index.reshape(-1)
    count = np.bincount(index)
    means = np.stack([np.bincount(index, points[:, i]) / count for i in range(3)], axis=-1)
    return means[rng.permutation(len(means))][: settings.most_points]


class PoseSearch(NamedTuple):
    """Where poses are searched for: what was seen of one segment, and how thoroughly to search."""

    points: Array
    """Averaged points of the segment (M, 3) [m], in W, shuffled: any first part of them is a sample."""
    space: FreeSpace
    """What the image says around them."""
    eye: Array
    """Position of the camera in W (3,) [m]."""
    table_height: float
    settings: SearchSettings

    def resting(self, templates: Sequence[Template], extra: Mapping[str, PoseHypotheses]) -> list[RankedHypotheses]:
        """Return refined hypotheses of the templates that may fit, resting on the table; none of the others.

        Args:
            extra: further starts by the template's name.
        """
        rough = []
        for template in templates:
            starts = resting_starts(template, self.points, self.eye, self.table_height, self.settings.yaw_angles)
            rough.append(self._rough(template, starts, PLANAR))
        fine = self._fine(rough, PLANAR)
        for template in (one.template for one in rough):
            if template.name in extra:
                fine.append(self._rough(template, extra[template.name], FREE))
        return [self._refined(one) for one in fine if len(one.hypotheses)]

    def free(
        self, templates: Sequence[Template], rng: np.random.Generator, known: Sequence[RankedHypotheses] = ()
    ) -> list[RankedHypotheses]:
        """Return refined hypotheses in any position, such as leaning or on another object.

        Args:
            known: hypotheses to start from as well, each turned a little in all directions: the alignment does not
                look at free space, so a pose that is seen through is left by trying its neighbours.
        """
        count, rough = self.settings.free_rotations, []
        for template in templates:
            starts = [free_starts(template, self.points, self.eye, count, rng)]
            starts += [self._around(one.hypotheses, rng, count) for one in known if one.template is template]
            rough.append(self._rough(template, PoseHypotheses.joined(starts), FREE))
        return [self._refined(one) for one in self._fine(rough, FREE) if len(one.hypotheses)]

    def _around(self, hypotheses: PoseHypotheses, rng: np.random.Generator, count: int) -> PoseHypotheses:
        """Return about ``count`` hypotheses near the given ones."""
        copies = np.repeat(np.arange(len(hypotheses)), -(-count // len(hypotheses)))
        turn = rng.normal(0.0, 1.0, (len(copies), 3)) * _NEARBY_TURN
        shift = rng.normal(0.0, 1.0, (len(copies), 3)) * _NEARBY_SHIFT
        return hypotheses[copies].moved(turn, shift, self.points.mean(axis=0))

    def _fit(
        self, hypotheses: PoseHypotheses, template: Template, points: int, surface: int, slack: float = 1.0
    ) -> Fit:
        """Return how hypotheses fit the first ``points`` seen points, with ``surface`` points of the template."""
        return fit(
            hypotheses,
            self.points[:points],
            template,
            self.space,
            tolerance=slack * self.settings.tolerance,
            table_height=self.table_height,
            count=surface,
        )

    def _aligned(
        self,
        hypotheses: PoseHypotheses,
        template: Template,
        points: int,
        reaches: tuple[float, ...],
        freedom: tuple[int, ...],
    ) -> PoseHypotheses:
        """Return the hypotheses after a step for each of ``reaches`` (in tolerances) on the first ``points``."""
        lengths = tuple(self.settings.tolerance * reach for reach in reaches)
        return align(hypotheses, self.points[:points], template.field, lengths, freedom=freedom)

    def _rough(self, template: Template, starts: PoseHypotheses, freedom: tuple[int, ...]) -> RankedHypotheses:
        """Return the best starts after a few steps on few points."""
        few = closeness(starts, self.points[:50], template, 3.0 * self.settings.tolerance)
        chosen = starts[np.argsort(-few, kind="stable")[: self.settings.rough]]
        moved = self._aligned(chosen, template, 80, _FAR, freedom)
        return _ranked(template, moved, self._fit(moved, template, 80, 100, slack=2.0), self.settings.fine)

    def _fine(self, rough: Sequence[RankedHypotheses], freedom: tuple[int, ...]) -> list[RankedHypotheses]:
        """Return what is left after more steps on more points; templates far behind the best one are abandoned."""
        best = max((one.best for one in rough), default=-np.inf)
        result = []
        for one in rough:
            if one.best < best - self.settings.behind:
                continue
            moved = self._aligned(one.hypotheses, one.template, 160, _NEAR, freedom)
            found = self._fit(moved, one.template, 250, 250)
            ranked = _ranked(one.template, moved, found, self.settings.fine)
            kept = self._distinct(ranked)
            result.append(RankedHypotheses(one.template, ranked.hypotheses[kept], ranked.fit[kept]))
        return result

    def _refined(self, ranked: RankedHypotheses) -> RankedHypotheses:
        """Return the hypotheses after ICP in all directions, where that makes the score of all points better."""
        template, before, settings = ranked.template, ranked.hypotheses, self.settings
        after = refine(before, self.points, template, settings.method, 1.6 * settings.tolerance)
        both = PoseHypotheses.joined([before, after])
        found = self._fit(both, template, settings.most_points, len(template.points))
        n = len(before)
        better = np.where(found.score[n:] > found.score[:n], np.arange(n, 2 * n), np.arange(n))
        return _ranked(template, both[better], found[better], n)

    def _distinct(self, ranked: RankedHypotheses) -> np.ndarray:
        """Return the indices of the best hypotheses that differ in shape from all better ones."""
        kept: list[int] = []
        remaining = np.ones(len(ranked.hypotheses), dtype=bool)
        while remaining.any() and len(kept) < self.settings.refined:
            index = int(np.argmax(remaining))
            kept.append(index)
            apart = shape_distance(ranked.hypotheses, ranked.hypotheses[[index]], ranked.template, 150)
            remaining &= apart > self.settings.distinct
            remaining[index] = False
        return np.array(kept, dtype=int)


def _ranked(template: Template, hypotheses: PoseHypotheses, found: Fit, count: int) -> RankedHypotheses:
    order = np.argsort(-found.score, kind="stable")[:count]
    return RankedHypotheses(template, hypotheses[order], found[order])
