"""Sets of grasps: stored with their surface, damage noticed, placed in the world."""

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optsc.errors import DamagedFile, InvalidValue, Mismatch, UnknownName
from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.grasps import Candidates, GraspLibrary, GraspSet, storage
from optsc.grasps.storage import load_surface, save_surface, surface_path
from optsc.robot.gripper import PANDA_HAND


def same(a: GraspSet, b: GraspSet) -> bool:
    arrays = [(s.X_OG.quaternion, s.X_OG.translation, s.opening, s.quality) for s in (a, b)]
    facts = [(s.object_name, s.object_hash, s.gripper, s.jaw_symmetric, dict(s.provenance)) for s in (a, b)]
    return all(x.tobytes() == y.tobytes() for x, y in zip(*arrays, strict=True)) and facts[0] == facts[1]


def rewrite(path: Path, change: Callable[[dict[str, np.ndarray]], None]) -> None:
    """Change the entries of a file and give it a checksum that agrees again."""
    with np.load(path) as archive:
        entries = dict(archive)
    entries.pop("checksum")
    change(entries)
    np.savez(path, **entries, checksum=storage._checksum(entries))  # type: ignore[arg-type]


def set_description(entries: dict[str, np.ndarray], **change: object) -> None:
    description = {**json.loads(entries["description"].tobytes()), **change}
    entries["description"] = np.frombuffer(json.dumps(description).encode(), dtype=np.uint8)


class TestFiles:
    def test_a_stored_set_comes_back_bit_for_bit(self, tmp_path: Path, few_grasps: GraspSet) -> None:
        path = storage.save_set(few_grasps, tmp_path / "new" / "folder")
        assert same(storage.load_set(path), few_grasps)

    def test_trials_are_stored_with_the_grasps(self, tmp_path: Path, few_grasps: GraspSet) -> None:
        held = np.arange(len(few_grasps)) % 3 > 0
        tried = replace(few_grasps, tried=np.ones(len(few_grasps), dtype=bool), held=held)
        loaded = storage.load_set(storage.save_set(tried, tmp_path))
        assert loaded.tried is not None
        assert loaded.tried.all()
        assert loaded.reliable.tolist() == held.tolist()
        assert storage.load_set(storage.save_set(few_grasps, tmp_path)).tried is None

    def test_a_file_of_the_first_format_is_read_as_never_tried(self, tmp_path: Path, few_grasps: GraspSet) -> None:
        path = storage.save_set(few_grasps, tmp_path)
        rewrite(path, lambda entries: set_description(entries, format=1))
        assert same(storage.load_set(path), few_grasps)
        assert storage.load_set(path).held is None

    def test_flipped_outcomes_do_not_agree_with_the_checksum(self, tmp_path: Path, few_grasps: GraspSet) -> None:
        all_of_them = np.ones(len(few_grasps), dtype=bool)
        path = storage.save_set(replace(few_grasps, tried=all_of_them, held=all_of_them), tmp_path)
        with np.load(path) as archive:
            entries = dict(archive)
        entries["held"] = ~entries["held"]
        np.savez(path, **entries)  # type: ignore[arg-type]
        with pytest.raises(DamagedFile, match="checksum"):
            storage.load_set(path)

    def test_the_same_set_gives_the_same_file(self, tmp_path: Path, few_grasps: GraspSet) -> None:
        first = storage.save_set(few_grasps, tmp_path / "a").read_bytes()
        again = storage.load_set(tmp_path / "a" / "brick.grasps.npz")
        assert storage.save_set(again, tmp_path / "b").read_bytes() == first

    def test_any_flipped_byte_is_noticed_or_harmless(self, tmp_path: Path, few_grasps: GraspSet) -> None:
        path = storage.save_set(few_grasps, tmp_path)
        content = path.read_bytes()
        noticed = 0
        for position in range(0, len(content), 5):
            path.write_bytes(content[:position] + bytes([content[position] ^ 0xFF]) + content[position + 1 :])
            try:
                assert same(storage.load_set(path), few_grasps)
            except DamagedFile:
                noticed += 1
        assert noticed > len(content) / 5 / 2

    def test_numbers_that_were_edited_do_not_agree_with_the_checksum(
        self, tmp_path: Path, few_grasps: GraspSet
    ) -> None:
        path = storage.save_set(few_grasps, tmp_path)
        with np.load(path) as archive:
            entries = dict(archive)
        entries["opening"] = entries["opening"] + 0.001
        np.savez(path, **entries)  # type: ignore[arg-type]
        with pytest.raises(DamagedFile, match="checksum"):
            storage.load_set(path)

    def test_a_file_cut_short_anywhere_is_damaged(self, tmp_path: Path, few_grasps: GraspSet) -> None:
        path = storage.save_set(few_grasps, tmp_path)
        content = path.read_bytes()
        for length in range(0, len(content), 101):
            path.write_bytes(content[:length])
            with pytest.raises(DamagedFile, match=r"brick\.grasps\.npz"):
                storage.load_set(path)

    @pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04", np.zeros(3).tobytes()])
    def test_what_is_no_grasp_file_is_damaged(self, tmp_path: Path, content: bytes) -> None:
        path = tmp_path / "x.grasps.npz"
        path.write_bytes(content)
        with pytest.raises(DamagedFile, match=r"x\.grasps\.npz"):
            storage.load_set(path)

    def test_other_numpy_files_are_damaged(self, tmp_path: Path) -> None:
        path = tmp_path / "x.grasps.npz"
        np.savez(path, something=np.zeros(3))
        with pytest.raises(DamagedFile, match="no grasp file"):
            storage.load_set(path)
        with path.open("wb") as file:
            np.save(file, np.zeros(3))
        with pytest.raises(DamagedFile, match="no grasp file"):
            storage.load_set(path)
        with pytest.raises(DamagedFile, match="cannot be read"):
            storage.load_set(tmp_path / "missing.grasps.npz")

    @pytest.mark.parametrize(
        ("entry", "value", "word"),
        [
            ("translation", np.nan, "position"),
            ("quaternion", np.nan, "orientation"),
            ("quaternion", 3.0, "orientation"),
            ("opening", np.inf, "opening"),
            ("quality", 1.5, "quality"),
        ],
    )
    def test_impossible_numbers_are_found_even_with_a_right_checksum(
        self, tmp_path: Path, few_grasps: GraspSet, entry: str, value: float, word: str
    ) -> None:
        path = storage.save_set(few_grasps, tmp_path)

        def spoil(entries: dict[str, np.ndarray]) -> None:
            entries[entry] = entries[entry].copy()
            entries[entry].flat[0] = value

        rewrite(path, spoil)
        with pytest.raises(DamagedFile, match=word):
            storage.load_set(path)

    def test_arrays_of_different_lengths_are_found(self, tmp_path: Path, few_grasps: GraspSet) -> None:
        for entry in ("translation", "quaternion", "opening", "quality"):
            path = storage.save_set(few_grasps, tmp_path)
            rewrite(path, lambda entries, entry=entry: entries.update({entry: entries[entry][1:]}))  # type: ignore[misc]
            with pytest.raises(DamagedFile, match="shape"):
                storage.load_set(path)

    def test_a_file_from_a_later_version_says_so(self, tmp_path: Path, few_grasps: GraspSet) -> None:
        path = storage.save_set(few_grasps, tmp_path)
        rewrite(path, lambda entries: set_description(entries, format=storage.FORMAT + 1))
        with pytest.raises(InvalidValue, match="later version"):
            storage.load_set(path)

    @pytest.mark.parametrize("change", [{"format": "one"}, {"gripper": None}, {"provenance": 3}])
    def test_an_incomplete_description_is_damage(
        self, tmp_path: Path, few_grasps: GraspSet, change: dict[str, object]
    ) -> None:
        path = storage.save_set(few_grasps, tmp_path)
        rewrite(path, lambda entries: set_description(entries, **change))
        with pytest.raises(DamagedFile, match=next(iter(change))):
            storage.load_set(path)

    def test_a_write_that_fails_leaves_the_old_file_and_no_other(
        self, tmp_path: Path, few_grasps: GraspSet, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = storage.save_set(few_grasps, tmp_path)

        def fail(*_: object) -> None:
            raise OSError("disk full")

        monkeypatch.setattr(os, "replace", fail)
        with pytest.raises(OSError, match="disk full"):
            storage.save_set(replace(few_grasps, quality=np.zeros(len(few_grasps))), tmp_path)
        assert same(storage.load_set(path), few_grasps)
        assert list(tmp_path.iterdir()) == [path]

    @pytest.mark.parametrize("name", ["", "../mug", "a/b", ".hidden", "mug\n"])
    def test_a_name_cannot_lead_out_of_the_directory(self, tmp_path: Path, few_grasps: GraspSet, name: str) -> None:
        with pytest.raises(InvalidValue, match="object name"):
            storage.save_set(replace(few_grasps, object_name=name), tmp_path)


class TestSet:
    def test_arrays_cannot_be_changed(self, few_grasps: GraspSet) -> None:
        for array in (few_grasps.opening, few_grasps.quality, few_grasps.X_OG.translation):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1.0
        with pytest.raises(TypeError):
            few_grasps.provenance["seed"] = 3  # type: ignore[index]

    def test_a_single_pose_and_a_wrong_length_are_refused(self, few_grasps: GraspSet) -> None:
        with pytest.raises(InvalidValue, match="batch shape"):
            replace(few_grasps, X_OG=Pose.identity())
        with pytest.raises(InvalidValue, match="opening"):
            replace(few_grasps, opening=few_grasps.opening[1:])

    def test_only_what_was_tried_can_have_held(self, few_grasps: GraspSet) -> None:
        none, some = np.zeros(len(few_grasps), dtype=bool), np.ones(len(few_grasps), dtype=bool)
        with pytest.raises(InvalidValue, match="held"):
            replace(few_grasps, tried=none, held=some)
        with pytest.raises(InvalidValue, match="tried and held"):
            replace(few_grasps, held=some)
        with pytest.raises(InvalidValue, match="tried"):
            replace(few_grasps, tried=some[1:], held=none)

    def test_some_of_a_set_keep_their_own_numbers(self, few_grasps: GraspSet) -> None:
        held = np.arange(len(few_grasps)) % 2 == 0
        tried = replace(few_grasps, tried=np.ones(len(few_grasps), dtype=bool), held=held)
        part = tried.select([3, 1])
        assert part.opening.tolist() == few_grasps.opening[[3, 1]].tolist()
        assert part.reliable.tolist() == held[[3, 1]].tolist()
        assert len(tried.select(held)) == held.sum()
        assert len(tried.select([])) == 0

    def test_a_moved_set_is_the_same_in_the_world(self, few_grasps: GraspSet) -> None:
        rng = np.random.default_rng(0)
        X_NO, X_WO = (Pose(rotation.random(rng), rng.normal(size=3)) for _ in range(2))
        moved = few_grasps.moved(X_NO)
        assert (X_WO @ X_NO.inverse() @ moved.X_OG).almost_equal(X_WO @ few_grasps.X_OG, 1e-12)
        with pytest.raises(InvalidValue, match="X_NO"):
            few_grasps.moved(Pose.identity((2,)))

    def test_age_and_visible_share_come_from_the_view(self, few_grasps: GraspSet) -> None:
        seen = replace(few_grasps, provenance={"stamp": 12.5, "visible_fraction": 0.6})
        assert seen.age(20.0) == 7.5
        assert seen.visible_fraction == 0.6
        assert few_grasps.age(20.0) is None
        assert few_grasps.visible_fraction is None


class TestLibrary:
    def other(self, grasps: GraspSet, **change: object) -> GraspSet:
        return replace(grasps, **{"object_name": "other", **change})  # type: ignore[arg-type]

    def test_what_is_saved_is_loaded(self, tmp_path: Path, few_grasps: GraspSet) -> None:
        both = GraspLibrary({"brick": few_grasps, "other": self.other(few_grasps)})
        both.save(tmp_path)
        loaded = GraspLibrary.load(tmp_path, PANDA_HAND)
        assert set(loaded) == {"brick", "other"}
        assert all(same(loaded[name], both[name]) for name in both)
        assert loaded.gripper == "panda_hand"

    def test_a_library_for_another_gripper_is_a_mismatch(self, tmp_path: Path, few_grasps: GraspSet) -> None:
        GraspLibrary({"brick": few_grasps}).save(tmp_path)
        with pytest.raises(Mismatch, match=r"brick.*panda_hand.*two_fingers"):
            GraspLibrary.load(tmp_path, replace(PANDA_HAND, name="two_fingers"))

    def test_sets_for_different_grippers_make_no_library(self, tmp_path: Path, few_grasps: GraspSet) -> None:
        storage.save_set(few_grasps, tmp_path)
        storage.save_set(self.other(few_grasps, gripper="two_fingers"), tmp_path)
        with pytest.raises(Mismatch, match="two_fingers"):
            GraspLibrary.load(tmp_path)

    def test_an_empty_or_missing_directory_is_no_library(self, tmp_path: Path) -> None:
        for directory in (tmp_path, tmp_path / "missing"):
            with pytest.raises(DamagedFile, match="no grasp library"):
                GraspLibrary.load(directory)

    def test_a_renamed_file_is_noticed(self, tmp_path: Path, few_grasps: GraspSet) -> None:
        storage.save_set(few_grasps, tmp_path).rename(tmp_path / "mug.grasps.npz")
        with pytest.raises(DamagedFile, match="brick"):
            GraspLibrary.load(tmp_path)

    def test_it_is_a_mapping_whose_lookup_error_lists_what_there_is(self, few_grasps: GraspSet) -> None:
        one = GraspLibrary({"brick": few_grasps})
        assert "brick" in one
        assert "mug" not in one
        assert one.get("mug") is None
        with pytest.raises(UnknownName, match=r"mug.*brick"):
            one["mug"]

    def test_placing_moves_every_grasp_with_its_object(self, few_grasps: GraspSet) -> None:
        both = GraspLibrary({"brick": few_grasps, "other": self.other(few_grasps)})
        rng = np.random.default_rng(0)
        X_WO = {n: Pose(rotation.random(rng), rng.normal(size=3)) for n in ("other", "brick")}
        placed, count = both.place(X_WO), len(few_grasps)
        assert placed.object_names == ("other", "brick")
        assert placed.object_index.tolist() == [0] * count + [1] * count
        assert placed.grasp_index.tolist() == [*range(count)] * 2
        for i in range(2 * count):
            name = placed.object_names[placed.object_index[i]]
            grasp = both[name].X_OG[placed.grasp_index[i]]
            assert placed.X_WG[i].almost_equal(X_WO[name] @ grasp, 1e-12)
        assert np.array_equal(placed.opening, np.tile(few_grasps.opening, 2))
        assert placed.jaw_symmetric

    def test_only_the_objects_that_are_there_are_placed(self, few_grasps: GraspSet) -> None:
        both = GraspLibrary({"brick": few_grasps, "other": self.other(few_grasps)})
        assert both.place({"other": Pose.identity()}).object_names == ("other",)
        nothing = both.place({})
        assert len(nothing) == 0
        assert nothing.X_WG.quaternion.shape == (0, 4)

    def test_placing_an_object_without_grasps_or_at_many_poses_is_refused(self, few_grasps: GraspSet) -> None:
        one = GraspLibrary({"brick": few_grasps})
        with pytest.raises(UnknownName, match=r"mug.*brick"):
            one.place({"mug": Pose.identity()})
        with pytest.raises(InvalidValue, match="pose of brick"):
            one.place({"brick": Pose.identity((2,))})

    def test_a_set_is_replaced_and_retired_without_touching_the_others(self, few_grasps: GraspSet) -> None:
        one = GraspLibrary({"brick": few_grasps})
        other = self.other(few_grasps)
        both = one.with_set(other)
        assert set(one) == {"brick"}
        assert both["brick"] is few_grasps
        newer = both.with_set(few_grasps.select([0, 1]))
        assert (len(newer["brick"]), len(both["brick"])) == (2, len(few_grasps))
        assert newer["other"] is other
        assert set(both.without("brick")) == {"other"}
        with pytest.raises(UnknownName, match=r"mug.*brick"):
            both.without("mug")
        with pytest.raises(Mismatch, match="two_fingers"):
            one.with_set(self.other(few_grasps, gripper="two_fingers"))


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
        self, tmp_path: Path, brick: TriangleMesh, few_grasps: GraspSet
    ) -> None:
        imported = replace(few_grasps, object_hash="imported:1")
        save_surface("brick", TriangleMesh(brick.vertices * 1.1, brick.faces), tmp_path)
        assert load_surface(few_grasps, tmp_path) is None
        assert load_surface(imported, tmp_path) is None

    def test_what_is_no_surface_is_damaged(self, tmp_path: Path, few_grasps: GraspSet) -> None:
        for content in (b"nonsense", b""):
            surface_path(tmp_path, "brick").write_bytes(content)
            with pytest.raises(DamagedFile, match="no surface"):
                load_surface(few_grasps, tmp_path)


def test_selected_candidates_are_these_rows_in_this_order() -> None:
    count = 4
    candidates = Candidates(
        object_names=("a", "b"),
        object_index=np.array([0, 0, 1, 1]),
        grasp_index=np.array([0, 1, 0, 1]),
        X_WG=Pose(np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), np.arange(12.0).reshape(count, 3)),
        opening=np.arange(4.0),
        quality=np.ones(count),
        jaw_symmetric=True,
    )
    some = candidates.select(np.array([3, 1, 3]))
    assert some.object_index.tolist() == [1, 0, 1]
    assert some.grasp_index.tolist() == [1, 1, 1]
    assert some.opening.tolist() == [3.0, 1.0, 3.0]
    np.testing.assert_array_equal(some.X_WG.translation[1], [3.0, 4.0, 5.0])
    assert (some.object_names, len(candidates.select(np.array([], dtype=int)))) == (("a", "b"), 0)
