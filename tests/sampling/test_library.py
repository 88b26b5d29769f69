"""Libraries of sampled grasps: only what is missing is sampled, and stored grasps are never lost unsaid."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optsc.cache import cache_directory
from optsc.errors import InvalidValue
from optsc.geometry import TriangleMesh
from optsc.grasps import GraspLibrary, GraspSet, storage
from optsc.grasps.storage import load_set, path_of, save_set
from optsc.robot.gripper import PANDA_HAND
from optsc.sampling import build_library
from optsc.sampling import library as sampling_library
from optsc.sampling.importing import import_grasps
from optsc.sampling.library import keep_set, origin
from optsc.sampling.settings import AntipodalSettings


@pytest.fixture
def imported(tmp_path: Path) -> GraspSet:
    table = tmp_path / "poses.csv"
    table.write_text("x,y,z,qw,qx,qy,qz\n0,0,0.1,0,1,0,0\n")
    return import_grasps(table, PANDA_HAND, name="brick")


def same(a: GraspSet, b: GraspSet) -> bool:
    arrays = [(s.X_OG.quaternion, s.X_OG.translation, s.opening, s.quality) for s in (a, b)]
    facts = [(s.object_name, s.object_hash, s.gripper, s.jaw_symmetric, dict(s.provenance)) for s in (a, b)]
    return all(x.tobytes() == y.tobytes() for x, y in zip(*arrays, strict=True)) and facts[0] == facts[1]


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
        cloud = replace(few_grasps, object_hash="cloud:1", provenance={"source": "cloud", "made_from": "a template"})
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
            build_library(meshes, PANDA_HAND, seed=1, directory=tmp_path, settings=replace(few, clearance=0.004))
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

    def test_other_poses_are_other_grasps(self, tmp_path: Path, few_grasps: GraspSet, imported: GraspSet) -> None:
        keep_set(imported, tmp_path)
        with pytest.raises(InvalidValue, match=r"poses.csv.*sampled with seed 1"):
            keep_set(few_grasps, tmp_path)
        assert "imported" in origin(load_set(path_of(tmp_path, "brick")))


class TestBuilding:
    @pytest.fixture
    def built(self, tmp_path: Path, brick: TriangleMesh, few: AntipodalSettings) -> GraspLibrary:
        return build_library({"brick": brick}, PANDA_HAND, seed=1, directory=tmp_path, settings=few)

    @pytest.fixture
    def sampled(self, built: GraspLibrary, monkeypatch: pytest.MonkeyPatch) -> list[str]:
        """Names of the objects that are sampled after the library was built once."""
        names: list[str] = []

        def spy(*_: object, name: str, **__: object) -> GraspSet:
            names.append(name)
            return replace(built["brick"], object_name=name)

        monkeypatch.setattr(sampling_library, "sample_grasps", spy)
        return names

    def test_what_is_built_is_what_sampling_gives(self, built: GraspLibrary, few_grasps: GraspSet) -> None:
        assert same(built["brick"], few_grasps)

    def test_a_stored_set_is_taken_when_everything_agrees(
        self,
        tmp_path: Path,
        brick: TriangleMesh,
        few: AntipodalSettings,
        built: GraspLibrary,
        sampled: list[str],
    ) -> None:
        calls: list[tuple[str, int, int]] = []
        again = build_library(
            {"brick": brick},
            PANDA_HAND,
            seed=1,
            directory=tmp_path,
            settings=few,
            progress=lambda *a: calls.append(a),
        )
        assert sampled == []
        assert same(again["brick"], built["brick"])
        assert calls == [("brick", 1, 1)]

    @pytest.mark.parametrize("what", ["seed", "settings", "mesh", "gripper name", "gripper shape", "damage", "name"])
    def test_anything_that_differs_makes_it_sample_anew_if_it_may(
        self, tmp_path: Path, brick: TriangleMesh, few: AntipodalSettings, sampled: list[str], what: str
    ) -> None:
        hand, mesh, seed, name = PANDA_HAND, brick, 1, "brick"
        if what == "seed":
            seed = 2
        elif what == "settings":
            few = replace(few, clearance=0.004)
        elif what == "mesh":
            mesh = TriangleMesh(brick.vertices * 1.01, brick.faces)
        elif what == "gripper name":
            hand = replace(PANDA_HAND, name="two_fingers")
        elif what == "gripper shape":
            hand = replace(PANDA_HAND, body=PANDA_HAND.body * 1.01)
        elif what == "damage":
            (tmp_path / "brick.grasps.npz").write_bytes(b"nonsense")
        else:
            name = "stone"
        build_library({name: mesh}, hand, seed=seed, directory=tmp_path, settings=few, replace=True)
        assert sampled == [name]
        assert (tmp_path / f"{name}.grasps.npz").exists()

    def test_a_file_from_a_later_version_is_not_overwritten(
        self,
        tmp_path: Path,
        brick: TriangleMesh,
        few: AntipodalSettings,
        built: GraspLibrary,
        sampled: list[str],
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        path = tmp_path / "brick.grasps.npz"
        with monkeypatch.context() as later:
            later.setattr(storage, "FORMAT", storage.FORMAT + 1)
            storage.save_set(built["brick"], tmp_path)
        before = path.read_bytes()
        with pytest.raises(InvalidValue, match="later version"):
            build_library({"brick": brick}, PANDA_HAND, seed=1, directory=tmp_path, settings=few)
        assert path.read_bytes() == before

    def test_without_a_directory_nothing_is_stored(
        self, tmp_path: Path, brick: TriangleMesh, few: AntipodalSettings, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.chdir(tmp_path)
        build_library({"brick": brick}, PANDA_HAND, seed=1, settings=few)
        assert list(tmp_path.iterdir()) == []
