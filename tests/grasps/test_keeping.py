"""Stored grasps are not lost without a word, and their surface is kept beside them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optsc.cache import cache_directory
from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import TriangleMesh
from optsc.grasps import GraspSet
from optsc.grasps.storage import load_set, load_surface, path_of, save_set, save_surface, surface_path
from optsc.robot.gripper import PANDA_HAND
from optsc.sampling import build_library
from optsc.sampling.importing import import_grasps
from optsc.sampling.keeping import keep_set, origin
from optsc.sampling.settings import AntipodalSettings


@pytest.fixture
def imported(tmp_path: Path) -> GraspSet:
    table = tmp_path / "poses.csv"
    table.write_text("x,y,z,qw,qx,qy,qz\n0,0,0.1,0,1,0,0\n")
    return import_grasps(table, PANDA_HAND, name="brick")


def outcome(grasps: GraspSet) -> GraspSet:
    return replace(grasps, tried=np.ones(len(grasps), dtype=bool), held=np.ones(len(grasps), dtype=bool))


def build(brick: TriangleMesh, few: AntipodalSettings, folder: Path, **change: object) -> GraspSet:
    options = {"seed": 1, "settings": few, **change}
    return build_library({"brick": brick}, PANDA_HAND, directory=folder, **options)["brick"]  # type: ignore[arg-type]


class TestBuildingOverWhatIsThere:
    @pytest.mark.parametrize("kind", ["imported", "of a view", "tried with another seed", "another seed"])
    def test_other_grasps_are_kept_unless_they_are_to_be_replaced(
        self,
        tmp_path: Path,
        brick: TriangleMesh,
        few: AntipodalSettings,
        few_grasps: GraspSet,
        imported: GraspSet,
        kind: str,
    ) -> None:
        other = replace(few_grasps, provenance={**few_grasps.provenance, "seed": 7})
        cloud = replace(
            few_grasps, object_hash="cloud:1", provenance={"source": "cloud", "made_from": "a template"}
        )
        there = {
            "imported": (imported, "imported from poses.csv"),
            "of a view": (cloud, "made from a view"),
            "tried with another seed": (outcome(other), "tried"),
            "another seed": (other, "with seed 1"),
        }
        before = save_set(there[kind][0], tmp_path).read_bytes()
        with pytest.raises(InvalidValue, match=f"{there[kind][1]}.*--replace"):
            build(brick, few, tmp_path)
        assert path_of(tmp_path, "brick").read_bytes() == before
        assert build(brick, few, tmp_path, replace=True).provenance["seed"] == 1
        assert load_set(path_of(tmp_path, "brick")).tried is None

    def test_the_refusal_comes_before_the_work_and_names_what_differs(
        self, tmp_path: Path, brick: TriangleMesh, few: AntipodalSettings, few_grasps: GraspSet
    ) -> None:
        save_set(few_grasps, tmp_path)
        meshes = {"stone": brick, "brick": brick}
        with pytest.raises(InvalidValue, match=r"grasps with clearance 0.004"):
            build_library(
                meshes, PANDA_HAND, seed=1, directory=tmp_path, settings=replace(few, clearance=0.004)
            )
        assert not path_of(tmp_path, "stone").exists()

    def test_tried_grasps_that_were_made_as_asked_are_used_with_their_outcome(
        self, tmp_path: Path, brick: TriangleMesh, few: AntipodalSettings, few_grasps: GraspSet
    ) -> None:
        save_set(outcome(few_grasps), tmp_path)
        assert build(brick, few, tmp_path).reliable.all()

    def test_imported_grasps_of_the_very_surface_are_used_as_they_are(
        self, tmp_path: Path, brick: TriangleMesh, few: AntipodalSettings, imported: GraspSet
    ) -> None:
        save_set(replace(imported, object_hash=brick.hash), tmp_path)
        assert build(brick, few, tmp_path, seed=5).provenance["source"] == "imported"

    def test_in_the_cache_of_the_library_only_what_can_be_made_again_gives_way(
        self,
        tmp_path: Path,
        brick: TriangleMesh,
        few: AntipodalSettings,
        few_grasps: GraspSet,
        imported: GraspSet,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        monkeypatch.setenv("OPTSC_CACHE", str(tmp_path))
        folder = cache_directory("grasps")
        save_set(replace(few_grasps, provenance={**few_grasps.provenance, "method": "older"}), folder)
        assert build(brick, few, folder).provenance["method"] != "older"
        save_set(imported, folder)
        with pytest.raises(InvalidValue, match="imported"):
            build(brick, few, folder)


class TestKeeping:
    def test_an_outcome_may_be_added_but_not_taken_away(self, tmp_path: Path, few_grasps: GraspSet) -> None:
        keep_set(few_grasps, tmp_path)
        path = keep_set(outcome(few_grasps), tmp_path)
        assert load_set(path).reliable.all()
        with pytest.raises(InvalidValue, match="tried"):
            keep_set(few_grasps, tmp_path)
        keep_set(few_grasps, tmp_path, replace=True)
        assert load_set(path).tried is None

    def test_other_poses_are_other_grasps(
        self, tmp_path: Path, few_grasps: GraspSet, imported: GraspSet
    ) -> None:
        keep_set(imported, tmp_path)
        with pytest.raises(InvalidValue, match=r"poses.csv.*sampled with seed 1"):
            keep_set(few_grasps, tmp_path)
        assert "imported" in origin(load_set(path_of(tmp_path, "brick")))


class TestSurfaces:
    def test_a_surface_comes_back_with_the_grasps_that_are_of_it(
        self, tmp_path: Path, brick: TriangleMesh, few_grasps: GraspSet
    ) -> None:
        assert load_surface(few_grasps, tmp_path) is None
        save_surface("brick", brick, tmp_path)
        found = load_surface(few_grasps, tmp_path)
        assert found is not None
        assert found.hash == brick.hash

    def test_a_surface_that_other_grasps_left_behind_is_not_used(
        self, tmp_path: Path, brick: TriangleMesh, few_grasps: GraspSet, imported: GraspSet
    ) -> None:
        save_surface("brick", TriangleMesh(brick.vertices * 1.1, brick.faces), tmp_path)
        assert load_surface(few_grasps, tmp_path) is None
        assert load_surface(imported, tmp_path) is None

    def test_what_is_no_surface_is_damaged(self, tmp_path: Path, few_grasps: GraspSet) -> None:
        for content in (b"nonsense", b""):
            surface_path(tmp_path, "brick").write_bytes(content)
            with pytest.raises(DamagedFile, match="no surface"):
                load_surface(few_grasps, tmp_path)
