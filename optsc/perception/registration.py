"""Registration of one segment: which template it is and at which pose, an ambiguity, or a refusal with its reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np

from optsc.checks import AtLeast, Checked, NonNegative, Positive, Share
from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, Pose
from optsc.geometry.rotation import Array
from optsc.perception.pose_hypotheses import feature_starts
from optsc.perception.refinement import covariance
from optsc.perception.scoring import free_space, shape_distance, visible_fraction
from optsc.perception.search import PoseSearch, RankedHypotheses, SearchSettings, voxel_means
from optsc.perception.segments import Segment
from optsc.perception.templates import Template


@dataclass(frozen=True)
class RegistrationSettings(Checked):
    """When a pose is accepted, and when it is called ambiguous.

    Attributes:
        search: how poses are looked for.
        least_points: a segment with fewer averaged points is refused (see `SearchSettings.voxel`).
        least_inliers: share of the seen points that have to be on the template [-].
        largest_residual: of those, the root mean square distance [m].
        largest_violations: share of the template's visible points that may be seen through [-].
        margin: another shape in the view whose score is worse by less than this is an alternative [-];
        margin_of_few: to which this is added, divided by the root of the number of averaged points [-].
        through: a point is seen through if what was measured is farther away by this [m].
        noise: least standard deviation of an averaged point, for the covariance [m].
    """

    search: SearchSettings = field(default_factory=SearchSettings)
    least_points: Annotated[int, AtLeast(6)] = 15
    least_inliers: Annotated[float, Share] = 0.85
    largest_residual: Annotated[float, Positive] = 0.002
    largest_violations: Annotated[float, Share] = 0.06
    margin: Annotated[float, NonNegative] = 0.02
    margin_of_few: Annotated[float, NonNegative] = 0.25
    through: Annotated[float, Positive] = 0.008
    noise: Annotated[float, Positive] = 0.0005


class Alternative(NamedTuple):
    """Another explanation of the same view that fits about as well."""

    template: str
    X_WO: Pose
    score: float


@dataclass(frozen=True, eq=False)
class Registration:
    """What a segment was taken for.

    Attributes:
        template: name of the best template; None if there is none at all.
        X_WO: its pose; also given with a refusal, as the best that was found, but then not to be used.
        residual: root mean square distance of the inliers from the template [m].
        inliers: share of the seen points on the template [-].
        violations: share of the template's visible points that the camera saw through [-].
        visible_fraction: of the template's surface that the camera would see were nothing else there, the share that
            it saw [-].
        covariance: (6, 6) of shift [m] and turn [rad] along the axes of W, see `refinement.covariance`.
        score: see `Fit`.
        ambiguous: whether the view fits `alternatives` about as well; the pose is then only one of them.
        alternatives: the other ones, best first.
        refusal: why there is nothing to be used, in words; empty if there is.
    """

    template: str | None
    X_WO: Pose | None
    residual: float
    inliers: float
    violations: float
    visible_fraction: float
    covariance: Array | None
    score: float
    ambiguous: bool
    alternatives: tuple[Alternative, ...]
    refusal: str

    @property
    def accepted(self) -> bool:
        """Whether the template is known and its pose is, too: neither refused nor ambiguous."""
        return not self.refusal and not self.ambiguous

    @property
    def recognised_as(self) -> str | None:
        """Name of the template, None with a refusal."""
        return None if self.refusal else self.template

    @classmethod
    def refused(cls, reason: str) -> Registration:
        """Return a refusal without any pose."""
        return cls(None, None, float("nan"), 0.0, 0.0, 0.0, None, -np.inf, False, (), reason)


def register(
    segment: Segment,
    templates: Sequence[Template],
    image: DepthImage,
    *,
    robot_depth: Array | None = None,
    table_height: float = 0.0,
    settings: RegistrationSettings | None = None,
    seed: int = 0,
) -> Registration:
    """Return what ``segment`` is and where.

    Args:
        segment: of one object, from ``image``.
        templates: what it may be, each name once.
        image: what was measured, also around the segment: where the camera saw through, nothing can be.
        robot_depth: depth of the arm's own surface (H, W) [m], infinite where it is not; it hides what is behind it.
        seed: same arguments and seed, same result.

    Raises:
        InvalidValue: no templates, two of one name, or sizes that do not belong together.
    """
    settings = settings or RegistrationSettings()
    names = [template.name for template in templates]
    if not names or len(set(names)) < len(names):
        raise InvalidValue("templates", names, "at least one, each name once")
    rng = np.random.default_rng(seed)
    few = _too_few(segment.cloud.points, settings)
    if few:
        return Registration.refused(few)
    points = voxel_means(segment.cloud.points, settings.search, rng)
    if len(points) < settings.least_points:
        return Registration.refused(
            f"too few points: {len(points)} cubes of {1e3 * settings.search.voxel:.0f} mm were seen, "
            f"{settings.least_points} are needed"
        )
    space = free_space(image, robot_depth, tolerance=settings.through)
    search = PoseSearch(points, space, image.X_WC.translation, table_height, settings.search)
    voxel, extra = settings.search.voxel, {}
    if settings.search.features:
        extra = {t.name: feature_starts(t, segment.cloud.points, voxel, seed) for t in templates}
    found = search.resting(templates, extra)
    if all(_refusal(ranked, settings) for ranked in found):
        found += search.free(templates, rng, found)
    return _decided(found, search, settings)


def _too_few(points: Array, settings: RegistrationSettings) -> str:
    if len(points) < settings.least_points:
        return f"too few points: {len(points)} were seen, {settings.least_points} are needed"
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    return "" if size < 5.0 else f"the points spread over {size:.1f} m, which is no object on a table"


def _refusal(ranked: RankedHypotheses, settings: RegistrationSettings, index: int = 0) -> str:
    """Return why a hypothesis cannot be accepted; empty if it can."""
    f = ranked.fit[index]
    if f.inliers < settings.least_inliers:
        least = 100 * settings.least_inliers
        return f"only {100 * f.inliers:.0f} % of the seen points are on it ({least:.0f} % needed)"
    if f.violations > settings.largest_violations:
        most, through = 100 * settings.largest_violations, 100 * f.violations
        return f"the camera saw through {through:.0f} % of what should be visible of it (at most {most:.0f} %)"
    if f.residual > settings.largest_residual:
        return f"residual {1e3 * f.residual:.1f} mm (at most {1e3 * settings.largest_residual:.1f} mm)"
    return ""


def _decided(found: Sequence[RankedHypotheses], search: PoseSearch, settings: RegistrationSettings) -> Registration:
    """Return the best hypothesis with its alternatives, or why it is refused."""
    if not found:
        return Registration.refused("no template is as tall as what was seen")
    every = [(ranked, i) for ranked in found for i in range(len(ranked.hypotheses))]
    every.sort(key=lambda entry: -entry[0].fit.score[entry[1]])
    best, index = every[0]
    pose, f, template = best.hypotheses[[index]], best.fit[index], best.template
    reason = _refusal(best, settings, index)
    if reason:
        reason = f"no template fits; the best, {template.name}: {reason}"
    margin = settings.margin + settings.margin_of_few / np.sqrt(len(search.points))
    distinct = every[:1]
    for entry in every[1:]:
        if entry[0].fit.score[entry[1]] < f.score - margin:
            break
        if all(_differ(*entry, *other, settings.search.distinct) for other in distinct):
            distinct.append(entry)
    C = covariance(pose, search.points, template, settings.search.tolerance, settings.noise, template.diameter)
    return Registration(
        template=template.name,
        X_WO=pose.pose(0),
        residual=float(f.residual),
        inliers=float(f.inliers),
        violations=float(f.violations),
        visible_fraction=visible_fraction(template, pose, search.space),
        covariance=C,
        score=float(f.score),
        ambiguous=len(distinct) > 1 and not reason,
        alternatives=tuple(
            Alternative(r.template.name, r.hypotheses.pose(i), float(r.fit.score[i])) for r, i in distinct[1:]
        ),
        refusal=reason,
    )


def _differ(a: RankedHypotheses, i: int, b: RankedHypotheses, k: int, distinct: float) -> bool:
    if a.template.name != b.template.name:
        return True
    return bool(shape_distance(a.hypotheses[[i]], b.hypotheses[[k]], a.template)[0] > distinct)
