"""From thousands of starts to a few refined poses per template: cheap tests on many, dear ones on few."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.perception.pose_hypotheses import PoseHypotheses, free_starts, resting_starts
from optsc.perception.refinement import FREE, METHODS, PLANAR, Method, aligned, refined
from optsc.perception.scoring import Fit, FreeSpace, closeness, fit, shape_distance
from optsc.perception.templates import Template

_NEARBY_TURN = np.array([0.06, 0.06, 0.2])  # [rad], standard deviations about the axes of W
_NEARBY_SHIFT = 0.004  # [m]
_FAR, _NEAR = (4.0, 3.0, 2.4), (2.0, 1.6, 1.2, 1.0, 1.0)  # reaches of the two rounds of steps, in tolerances


@dataclass(frozen=True)
class SearchSettings:
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
        behind: templates whose coarse score is worse than the best one's by more than this are given up [-].
        distinct: poses are told apart if the surface sticks out by more than this [m], see `shape_distance`.
        method: of the refinement, see `refined`.
        features: add starts from FPFH features; needs open3d (the ``features`` extra).
    """

    voxel: float = 0.004
    most_points: int = 500
    tolerance: float = 0.005
    yaw_angles: int = 24
    free_rotations: int = 120
    rough: int = 100
    fine: int = 32
    refined: int = 4
    behind: float = 0.35
    distinct: float = 0.006
    method: Method = "gicp"
    features: bool = False

    def __post_init__(self) -> None:
        for field in ("voxel", "tolerance", "behind", "distinct"):
            value = getattr(self, field)
            if not 0.0 < value < float("inf"):
                raise InvalidValue(f"SearchSettings.{field}", value, "finite, more than 0")
        for field in ("most_points", "yaw_angles", "rough", "fine", "refined"):
            if getattr(self, field) < 1:
                raise InvalidValue(f"SearchSettings.{field}", getattr(self, field), "at least 1")
        if self.free_rotations < 0:
            raise InvalidValue("SearchSettings.free_rotations", self.free_rotations, "at least 0")
        if self.method not in METHODS:
            raise InvalidValue("SearchSettings.method", self.method, f"one of {', '.join(METHODS)}")


class SegmentEvidence(NamedTuple):
    """What is searched in: averaged points of one segment and what the image says around them."""

    points: Array
    """(M, 3) [m], in W, shuffled, so that any first part of them is a sample."""
    space: FreeSpace
    eye: Array
    """Position of the camera in W (3,) [m]."""
    table_height: float


@dataclass(frozen=True, eq=False)
class RankedHypotheses:
    """PoseHypotheses of one template's pose with how they fit, best first."""

    template: Template
    hypotheses: PoseHypotheses
    fit: Fit

    @property
    def best(self) -> float:
        """The best score; minus infinity if there are none."""
        return float(self.fit.score[0]) if len(self.hypotheses) else -np.inf


def averaged(points: Array, settings: SearchSettings, rng: np.random.Generator) -> Array:
    """Return the means of the points in cubes (M, 3) [m], shuffled, at most as many as wanted."""
    cell = np.floor(points / settings.voxel).astype(np.int64)
    _, index = np.unique(cell - cell.min(axis=0), axis=0, return_inverse=True)
    index = index.reshape(-1)
    count = np.bincount(index)
    means = np.stack([np.bincount(index, points[:, i]) / count for i in range(3)], axis=-1)
    return means[rng.permutation(len(means))][: settings.most_points]


def resting_candidates(
    templates: Sequence[Template],
    view: SegmentEvidence,
    settings: SearchSettings,
    extra: dict[str, PoseHypotheses] | None = None,
) -> list[RankedHypotheses]:
    """Return refined candidates of the templates that may fit, resting on the table; none of the others.

    Args:
        templates: to look for.
        view: where.
        settings: how.
        extra: further starts by the template's name.
    """
    rough = []
    for template in templates:
        starts = resting_starts(template, view.points, view.eye, view.table_height, settings.yaw_angles)
        rough.append(_rough(template, starts, view, settings, PLANAR))
    fine = _fine(rough, view, settings, PLANAR)
    for candidates in rough if extra else []:
        template = candidates.template
        if extra and template.name in extra:
            fine.append(_rough(template, extra[template.name], view, settings, FREE))
    return [_refined(candidates, view, settings) for candidates in fine if len(candidates.hypotheses)]


def free_candidates(
    templates: Sequence[Template],
    view: SegmentEvidence,
    settings: SearchSettings,
    rng: np.random.Generator,
    known: Sequence[RankedHypotheses] = (),
) -> list[RankedHypotheses]:
    """Return refined candidates in any position, such as leaning or on another thing.

    Args:
        templates: to look for.
        view: where.
        settings: how.
        rng: of the starts.
        known: candidates to start from as well, each turned a little in all directions: what free space forbids is no
            part of the alignment, so it is left by trying.
    """
    rough = []
    for template in templates:
        starts = [free_starts(template, view.points, view.eye, settings.free_rotations, rng)]
        for candidates in known:
            if candidates.template is template:
                starts.append(_around(candidates.hypotheses, view, rng, settings.free_rotations))
        rough.append(_rough(template, PoseHypotheses.joined(starts), view, settings, FREE))
    fine = _fine(rough, view, settings, FREE)
    return [_refined(candidates, view, settings) for candidates in fine if len(candidates.hypotheses)]


def _around(
    hypotheses: PoseHypotheses, view: SegmentEvidence, rng: np.random.Generator, count: int
) -> PoseHypotheses:
    """Return about ``count`` hypotheses near the given ones."""
    copies = np.repeat(np.arange(len(hypotheses)), -(-count // len(hypotheses)))
    turn = rng.normal(0.0, 1.0, (len(copies), 3)) * _NEARBY_TURN
    shift = rng.normal(0.0, 1.0, (len(copies), 3)) * _NEARBY_SHIFT
    return hypotheses[copies].moved(turn, shift, view.points.mean(axis=0))


def judged(
    hypotheses: PoseHypotheses,
    template: Template,
    view: SegmentEvidence,
    settings: SearchSettings,
    points: int,
    surface: int,
) -> Fit:
    """Return how the hypotheses fit the first ``points`` seen points, with ``surface`` points of the template."""
    return fit(
        hypotheses,
        view.points[:points],
        template,
        view.space,
        tolerance=settings.tolerance,
        table_height=view.table_height,
        count=surface,
    )


def _rough(
    template: Template,
    starts: PoseHypotheses,
    view: SegmentEvidence,
    settings: SearchSettings,
    freedom: tuple[int, ...],
) -> RankedHypotheses:
    """Return the best starts after a few steps on few points."""
    tolerance = settings.tolerance
    few = closeness(starts, view.points[:50], template, 3.0 * tolerance)
    chosen = starts[np.argsort(-few, kind="stable")[: settings.rough]]
    moved = aligned(
        chosen, view.points[:80], template.field, tuple(tolerance * r for r in _FAR), freedom=freedom
    )
    found = fit(
        moved,
        view.points[:80],
        template,
        view.space,
        tolerance=2.0 * tolerance,
        table_height=view.table_height,
        count=100,
    )
    return _sorted(template, moved, found, settings.fine)


def _fine(
    rough: Sequence[RankedHypotheses],
    view: SegmentEvidence,
    settings: SearchSettings,
    freedom: tuple[int, ...],
) -> list[RankedHypotheses]:
    """Return the candidates of the templates that are not left far behind, after more steps on more points."""
    best = max((candidates.best for candidates in rough), default=-np.inf)
    result = []
    for candidates in rough:
        if candidates.best < best - settings.behind:
            continue
        reaches = tuple(settings.tolerance * r for r in _NEAR)
        template = candidates.template
        moved = aligned(candidates.hypotheses, view.points[:160], template.field, reaches, freedom=freedom)
        found = judged(moved, template, view, settings, 250, 250)
        ordered = _sorted(template, moved, found, settings.fine)
        kept = _distinct(ordered, settings)
        result.append(RankedHypotheses(template, ordered.hypotheses[kept], ordered.fit[kept]))
    return result


def _refined(
    candidates: RankedHypotheses, view: SegmentEvidence, settings: SearchSettings
) -> RankedHypotheses:
    """Return the candidates after ICP in all directions, judged with everything; ICP has to make a pose better."""
    template, before = candidates.template, candidates.hypotheses
    after = refined(before, view.points, template, settings.method, 1.6 * settings.tolerance)
    both = PoseHypotheses.joined([before, after])
    found = judged(both, template, view, settings, settings.most_points, len(template.points))
    n = len(before)
    better = np.where(found.score[n:] > found.score[:n], np.arange(n, 2 * n), np.arange(n))
    return _sorted(template, both[better], found[better], n)


def _distinct(candidates: RankedHypotheses, settings: SearchSettings) -> np.ndarray:
    """Return the indices of the best candidates that differ in shape from all better ones."""
    kept: list[int] = []
    open_ = np.ones(len(candidates.hypotheses), dtype=bool)
    while open_.any() and len(kept) < settings.refined:
        index = int(np.argmax(open_))
        kept.append(index)
        apart = shape_distance(
            candidates.hypotheses, candidates.hypotheses[[index]], candidates.template, 150
        )
        open_ &= apart > settings.distinct
        open_[index] = False
    return np.array(kept, dtype=int)


def _sorted(template: Template, hypotheses: PoseHypotheses, found: Fit, count: int) -> RankedHypotheses:
    order = np.argsort(-found.score, kind="stable")[:count]
    return RankedHypotheses(template, hypotheses[order], found[order])
