"""Antipodal sampling on an exact surface: two opposite contacts, a free way in, enough pad on the object.

The idea follows V.-D. Nguyen, "Constructing force-closure grasps", 1988: two soft contacts hold an object
when the line between them lies in both friction cones.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from optsc.geometry import TriangleMesh
from optsc.grasps.grasp_set import GraspSet
from optsc.robot.gripper import Gripper
from optsc.sampling.checks import Tally, Workpiece
from optsc.sampling.gathering import Progress, check_request, gather, grasp_set
from optsc.sampling.proposals import propose
from optsc.sampling.settings import AntipodalSettings
from optsc.sampling.surface import centre_of_mass, sample_surface


def sample_grasps(
    mesh: TriangleMesh,
    gripper: Gripper,
    *,
    name: str,
    seed: int,
    settings: AntipodalSettings | None = None,
    progress: Progress | None = None,
    tally: Tally | None = None,
) -> GraspSet:
    """Return ``settings.count`` grasps of an object that stands on the plane z = 0 of its frame.

    Every grasp has: both contacts in the friction cone; pads that lie flat on the object; a straight approach
    with fully open jaws that touches neither object nor table; jaws that on closing meet nothing else first;
    a hold that bears small errors of the pose and resists a wrench in every direction. They are spread over
    positions and directions, with no grasp twice (a half turn of symmetric jaws is the same grasp). Where fewer
    are found, ``provenance["reason"]`` says why; ``provenance["funnel"]`` counts the poses left after each
    check, and ``tally`` keeps them where they are of interest. The quality is `optsc.sampling.quality.grasp_quality`.

    The same mesh, gripper, seed and settings give the same grasps. Raises `InvalidValue` for a negative seed
    and for a mesh that cannot have been meant in metres.
    """
    settings = settings or AntipodalSettings()
    check_request(name, mesh.extents, seed)
    rng = np.random.default_rng(seed)
    surface = sample_surface(mesh, settings.spacing, rng)
    work = Workpiece(surface, centre_of_mass(mesh), gripper, settings)
    kept = gather(work, partial(propose, mesh, gripper, settings), rng, name, progress, tally)
    return grasp_set(work, kept, name=name, object_hash=mesh.hash, seed=seed, facts={"source": "mesh"})
