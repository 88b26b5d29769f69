"""What every sampled grasp promises, checked in other ways than the sampler checks it."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import Pose, TriangleMesh
from optsc.grasps import GraspSet
from optsc.robot.gripper import PANDA_HAND
from optsc.sampling.antipodal import pose_distance, sample_grasps
from optsc.sampling.contacts import cone_cosine
from optsc.sampling.proposals import exits, propose, within_cone
from optsc.sampling.quality import grasp_quality, hold_quality
from optsc.sampling.settings import AntipodalSettings
from optsc.sampling.surface import centre_of_mass, sample_surface
from optsc.sim.objects import OBJECT_NAMES
from optsc.sim.objects.solids import hull, revolved

GraspsOf = Callable[[str], GraspSet]
Meshes = Mapping[str, TriangleMesh]
SETTINGS = AntipodalSettings()
every_object = pytest.mark.parametrize("name", OBJECT_NAMES)


def collides(grasps: GraspSet, mesh: TriangleMesh, distance: float) -> np.ndarray:
    """Whether a point of the surface is in the open gripper at ``distance`` before every third grasp, pose by pose."""
    points = sample_surface(mesh, 0.0025, np.random.default_rng(99)).points
    boxes = PANDA_HAND.boxes(PANDA_HAND.max_opening)
    hits = []
    for X_OG in grasps.X_OG[::3] @ Pose.from_translation([0.0, 0.0, -distance]):
        points_T = X_OG.inverse().apply(points)
        hits.append(any(np.any(np.all((points_T > low) & (points_T < high), axis=1)) for low, high in boxes))
    return np.array(hits)


@every_object
def test_there_are_as_many_grasps_as_asked_for_and_no_reason_for_fewer(name: str, grasps_of: GraspsOf) -> None:
    grasps = grasps_of(name)
    assert len(grasps) == 150
    assert "reason" not in grasps.provenance


@every_object
def test_the_open_gripper_touches_nothing_anywhere_on_its_way_in(
    name: str, grasps_of: GraspsOf, meshes: Meshes
) -> None:
    for distance in (0.0, 0.015, 0.04, 0.1):
        assert not collides(grasps_of(name), meshes[name], distance).any()


@every_object
def test_half_turned_grasps_are_as_free_as_the_stored_ones(name: str, grasps_of: GraspsOf, meshes: Meshes) -> None:
    grasps = grasps_of(name)
    turned = replace(grasps, X_OG=grasps.X_OG @ Pose.from_rotation_vector([0.0, 0.0, np.pi], np.zeros(3)))
    assert not collides(turned, meshes[name], 0.0).any()


@every_object
def test_no_corner_of_the_gripper_is_ever_below_the_table(name: str, grasps_of: GraspsOf) -> None:
    boxes = PANDA_HAND.boxes(PANDA_HAND.max_opening)
    corners = np.array([[b[i, 0], b[j, 1], b[k, 2]] for b in boxes for i, j, k in np.ndindex(2, 2, 2)])
    for distance in (0.0, SETTINGS.standoff):
        X_OT = grasps_of(name).X_OG @ Pose.from_translation([0.0, 0.0, -distance])
        assert X_OT[:, None].apply(corners)[..., 2].min() >= SETTINGS.table_clearance - 1e-9


@every_object
def test_jaws_meet_opposite_walls_as_far_apart_as_the_opening_says(
    name: str, grasps_of: GraspsOf, meshes: Meshes
) -> None:
    grasps, mesh, stroke = grasps_of(name), meshes[name], PANDA_HAND.max_opening
    y = grasps.X_OG.rotation_matrix()[:, :, 1]
    reach = np.full((2, len(grasps)), -np.inf)  # how far the object reaches towards either jaw, from the other one
    for x, z in np.ndindex(5, 5):
        on_the_pad = np.array([(x - 2) / 4.1 * PANDA_HAND.pad_size[0], 0.0, (z - 2) / 4.1 * PANDA_HAND.pad_size[1]])
        middle = grasps.X_OG.apply(on_the_pad)
        for side, along in enumerate((y, -y)):
            ray, distance, _ = exits(mesh, middle - 0.5 * stroke * along, along, stroke)
            np.maximum.at(reach[side], ray, distance)
    assert np.all(np.abs(reach.sum(axis=0) - stroke - grasps.opening) < 0.0015)
    assert np.all(np.abs(reach[0] - reach[1]) < 0.0035)  # both jaws touch at about the same time
    assert np.all(grasps.opening <= stroke - 2 * SETTINGS.clearance)


@every_object
def test_the_hand_never_comes_from_below(name: str, grasps_of: GraspsOf) -> None:
    assert np.all(grasps_of(name).X_OG.rotation_matrix()[:, 2, 2] <= 1e-9)


@pytest.mark.parametrize("name", ["bottle", "can", "mug", "drill"])
def test_directions_cover_the_top_and_all_sides(name: str, grasps_of: GraspsOf) -> None:
    approach = grasps_of(name).X_OG.rotation_matrix()[:, :, 2]
    from_above = -approach[:, 2] > np.cos(np.radians(30))
    from_the_side = -approach[:, 2] < np.sin(np.radians(30))
    assert from_above.sum() >= 10
    assert from_the_side.sum() >= 30
    sector = np.floor(np.arctan2(approach[:, 1], approach[:, 0]) / (np.pi / 4)).astype(int)
    assert set(sector) == set(range(-4, 4))


@every_object
def test_no_grasp_is_stored_twice_not_even_half_turned(name: str, grasps_of: GraspsOf) -> None:
    X_OG = grasps_of(name).X_OG
    distance = pose_distance(X_OG[:, None], X_OG[None, :], jaw_symmetric=True)
    assert distance[~np.eye(len(X_OG), dtype=bool)].min() > 0.03


@every_object
def test_gravity_has_a_short_lever_in_every_grasp(name: str, grasps_of: GraspsOf, meshes: Meshes) -> None:
    X_OG, centre = grasps_of(name).X_OG, centre_of_mass(meshes[name])
    torque = np.cross(centre - X_OG.translation, [0.0, 0.0, -1.0])
    about_the_jaws = np.abs(np.einsum("ki,ki->k", torque, X_OG.rotation_matrix()[:, :, 1]))
    assert about_the_jaws.max() <= SETTINGS.max_lever + 1e-12


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(
    brick: TriangleMesh, few: AntipodalSettings, few_grasps: GraspSet
) -> None:
    again = sample_grasps(brick, PANDA_HAND, name="brick", seed=1, settings=few)
    assert again.X_OG.quaternion.tobytes() == few_grasps.X_OG.quaternion.tobytes()
    assert again.X_OG.translation.tobytes() == few_grasps.X_OG.translation.tobytes()
    assert again.quality.tobytes() == few_grasps.quality.tobytes()
    other = sample_grasps(brick, PANDA_HAND, name="brick", seed=2, settings=few)
    assert not np.array_equal(other.X_OG.translation, few_grasps.X_OG.translation)


def test_a_box_is_held_by_opposite_faces(few_grasps: GraspSet) -> None:
    closing = np.abs(few_grasps.X_OG.rotation_matrix()[:, :, 1])
    assert np.all(closing.max(axis=1) >= SETTINGS.min_alignment)
    across = np.array([0.04, 0.06, 0.08])[closing.argmax(axis=1)]
    assert np.all((few_grasps.opening >= across - 2e-3) & (few_grasps.opening <= across + 4e-3))


def test_what_is_too_big_for_the_jaws_gives_no_grasps_and_the_reason() -> None:
    drum = revolved([(0.06, 0.0), (0.06, 0.12)])
    grasps = sample_grasps(drum, PANDA_HAND, name="drum", seed=0, settings=AntipodalSettings(count=5, max_rounds=2))
    assert len(grasps) == 0
    assert "0 of 5 found in 2 rounds" in str(grasps.provenance["reason"])


def test_progress_rises_to_the_end(brick: TriangleMesh, few: AntipodalSettings) -> None:
    calls: list[tuple[str, int, int]] = []
    sample_grasps(brick, PANDA_HAND, name="brick", seed=1, settings=few, progress=lambda *a: calls.append(a))
    done = [c[1] for c in calls]
    assert {c[0] for c in calls} == {"brick"}
    assert done == sorted(done)
    assert done[-1] == calls[-1][2] == few.pool * few.count


def test_a_mesh_in_millimetres_and_a_negative_seed_are_refused(brick: TriangleMesh) -> None:
    millimetres = TriangleMesh(brick.vertices * 1000.0, brick.faces)
    with pytest.raises(InvalidValue, match="metres"):
        sample_grasps(millimetres, PANDA_HAND, name="brick", seed=0)
    with pytest.raises(InvalidValue, match="seed"):
        sample_grasps(brick, PANDA_HAND, name="brick", seed=-1)


@pytest.mark.parametrize(
    "change",
    [{"count": 0}, {"friction": float("nan")}, {"min_coverage": 1.5}, {"spacing": 0.0}, {"max_lever": 0.0}],
)
def test_impossible_settings_are_refused_by_name(change: dict[str, float]) -> None:
    with pytest.raises(InvalidValue, match=next(iter(change))):
        AntipodalSettings(**change)  # type: ignore[arg-type]


def test_quality_is_the_documented_mean_of_its_five_factors() -> None:
    settings = AntipodalSettings(max_lever=0.04)
    coverage, lever, spare = np.array(0.2), np.array(0.02), np.array(0.018)
    hold = hold_quality(coverage, lever, spare, settings)
    assert hold == pytest.approx((0.4 * 0.75 * 0.6) ** (1 / 3))
    quality = grasp_quality(np.array(0.7), np.array(0.5), hold)
    assert quality == pytest.approx((0.7 * 0.5 * 0.4 * 0.75 * 0.6) ** (1 / 5))
    best = hold_quality(np.array(1.0), np.array(0.0), np.array(0.05), settings)
    assert grasp_quality(np.array(1.2), np.array(1.0), best) == 1.0
    assert grasp_quality(np.array(0.7), np.array(0.0), hold) == 0.0


def test_proposals_have_both_contacts_in_the_friction_cone(brick: TriangleMesh) -> None:
    settings = AntipodalSettings(friction=0.3)
    X_OG = propose(brick, PANDA_HAND, settings, np.random.default_rng(0))
    closing = X_OG.rotation_matrix()[:, :, 1]
    assert len(X_OG) > 500
    # Between parallel faces of a box both normals make the same angle with the closing axis.
    assert np.all(np.abs(closing).max(axis=1) >= cone_cosine(0.3) - 1e-12)


def test_no_pair_of_contacts_is_proposed_on_faces_that_are_not_opposite() -> None:
    corners = 0.03 * np.array([[np.cos(a), np.sin(a)] for a in 2 * np.pi * np.arange(3) / 3])
    wedge = hull([[*corner, height] for corner in corners for height in (0.0, 0.04)])
    X_OG = propose(wedge, PANDA_HAND, AntipodalSettings(friction=0.3), np.random.default_rng(0))
    assert len(X_OG) > 300
    # The three sides of the prism face each other at 60 degrees; only top and bottom are opposite.
    assert np.all(np.abs(X_OG.rotation_matrix()[:, 2, 1]) >= cone_cosine(0.3) - 1e-12)


def test_directions_within_a_cone_stay_in_it_and_are_of_unit_length() -> None:
    rng = np.random.default_rng(0)
    axes = rng.normal(size=(500, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    directions = within_cone(axes, 0.3, rng)
    assert np.allclose(np.linalg.norm(directions, axis=1), 1.0)
    angles = np.arccos(np.clip(np.einsum("ni,ni->n", axes, directions), -1, 1))
    assert angles.max() <= 0.3 + 1e-9
    assert angles.max() > 0.25
