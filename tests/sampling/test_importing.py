"""Other people's grasps: ACRONYM's files and tables of poses, and everything that can be wrong with them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import Pose, rotation
from optsc.robot.gripper import PANDA_HAND
from optsc.sampling.importing import ACRONYM_X_HG, import_grasps

HEADER = "x,y,z,qw,qx,qy,qz"
ROW = "0.01,0.02,0.05,1,0,0,0"

WriteTable = Callable[[str], Path]


@pytest.fixture
def table(tmp_path: Path) -> WriteTable:
    def write(text: str) -> Path:
        path = tmp_path / "poses.csv"
        path.write_text(text)
        return path

    return write


def bring_in(path: Path, **change: object) -> object:
    return import_grasps(path, PANDA_HAND, name="mug", **change)  # type: ignore[arg-type]


class TestTables:
    def test_poses_openings_and_qualities_come_in_as_they_are(self, table: WriteTable) -> None:
        rows = f"quality,{HEADER},opening\n0.5,{ROW},0.04\n\n1.0,0,0,0.1,0,1,0,0,0.07\n"
        grasps = import_grasps(table(rows), PANDA_HAND, name="mug")
        assert np.allclose(grasps.X_OG.translation, [[0.01, 0.02, 0.05], [0.0, 0.0, 0.1]])
        assert np.allclose(grasps.X_OG.quaternion, [[1, 0, 0, 0], [0, 1, 0, 0]])
        assert grasps.opening.tolist() == [0.04, 0.07]
        assert grasps.quality.tolist() == [0.5, 1.0]
        assert grasps.object_hash.startswith("imported:")
        assert grasps.provenance["file"] == "poses.csv"

    def test_what_a_table_does_not_say_is_named_as_unknown(self, table: WriteTable) -> None:
        grasps = import_grasps(table(f"{HEADER}\n{ROW}\n"), PANDA_HAND, name="mug", object_hash="abc")
        assert grasps.opening.tolist() == [PANDA_HAND.max_opening]
        assert grasps.provenance["opening_known"] is False
        assert grasps.object_hash == "abc"

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("", "header"),
            (f"{HEADER}\n", "number of grasps is 0"),
            ("x,y,z\n1,2,3\n", "header"),
            (f"{HEADER},colour\n{ROW},3\n", "header"),
            (f"{HEADER}\n{ROW},7\n", "cells in row 1"),
            (f"{HEADER}\n{ROW}\n0.1,0.1,zero,1,0,0,0\n", "z in row 2"),
            (f"{HEADER}\nnan,0,0,1,0,0,0\n", "position of grasp 1"),
            (f"{HEADER}\n0,0,0,0.9,0,0,0\n", "qw..qz in row 1"),
            (f"{HEADER}\n0,0,0,nan,0,0,0\n", "qw..qz in row 1"),
            (f"{HEADER}\n10,20,50,1,0,0,0\n", "millimetres"),
            (f"{HEADER},opening\n{ROW},40\n", "opening of grasp 1 is 40.0.*millimetres"),
            (f"{HEADER},quality\n{ROW},1.5\n", "quality of grasp 1 is 1.5; valid: 0 to 1"),
        ],
    )
    def test_a_wrong_table_is_refused_with_the_field(self, table: WriteTable, text: str, words: str) -> None:
        with pytest.raises(InvalidValue, match=words):
            bring_in(table(text))

    def test_what_is_no_text_is_damaged(self, tmp_path: Path) -> None:
        path = tmp_path / "poses.csv"
        with pytest.raises(DamagedFile, match="cannot be read"):
            bring_in(path)
        path.write_bytes(b"\xff\xfe\x00")
        with pytest.raises(DamagedFile, match="UTF-8"):
            bring_in(path)
        with pytest.raises(InvalidValue, match="suffix"):
            bring_in(tmp_path / "poses.txt")


class TestAcronym:
    h5py = pytest.importorskip("h5py")

    def write(self, path: Path, matrices: np.ndarray, held: np.ndarray | None = None) -> Path:
        with self.h5py.File(path, "w") as file:
            file["grasps/transforms"] = matrices
            file["object/file"] = "meshes/Mug/10f6e09036350e92b3f21f1137c3c347.obj"
            file["object/scale"] = 0.01
            if held is not None:
                file["grasps/qualities/flex/object_in_gripper"] = held
        return path

    def hands(self, count: int = 5) -> Pose:
        rng = np.random.default_rng(0)
        return Pose(rotation.random(rng, (count,)), 0.05 * rng.normal(size=(count, 3)))

    def test_hand_poses_become_tool_poses_between_the_fingertips(self, tmp_path: Path) -> None:
        X_OH = self.hands()
        grasps = import_grasps(self.write(tmp_path / "mug.h5", X_OH.matrix()), PANDA_HAND, name="mug")
        # In their frame of the hand, fingers are at +-x and reach 0.1034 m + half a pad forwards.
        left = X_OH.apply(np.array([0.04, 0.0, 0.1034]))
        assert np.allclose(grasps.X_OG.apply(np.array([0.0, -0.04, 0.0])), left)
        assert np.allclose(grasps.X_OG.rotation_matrix()[:, :, 2], X_OH.rotation_matrix()[:, :, 2])
        assert (grasps.X_OG @ ACRONYM_X_HG.inverse()).almost_equal(X_OH, 1e-9)
        assert grasps.tried is None

    def test_their_outcomes_are_kept_and_so_is_where_the_object_is_from(self, tmp_path: Path) -> None:
        held = np.array([1, 0, 1, 1, 0])
        path = self.write(tmp_path / "mug.h5", self.hands().matrix(), held)
        grasps = import_grasps(path, PANDA_HAND, name="mug")
        assert grasps.reliable.tolist() == held.astype(bool).tolist()
        assert grasps.provenance["object_scale"] == 0.01
        assert str(grasps.provenance["object_file"]).startswith("meshes/Mug/")

    def test_another_hand_frame_can_be_given(self, tmp_path: Path) -> None:
        X_OH = self.hands()
        path = self.write(tmp_path / "mug.hdf5", X_OH.matrix())
        assert import_grasps(path, PANDA_HAND, name="mug", X_HG=Pose.identity()).X_OG.almost_equal(X_OH, 1e-9)

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (lambda M: M * 2.0, r"transforms\[0\]"),
            (lambda M: M * [[1, 1, 1, 1000.0]], "millimetres"),
            (lambda M: M * [[1, 1, 1, np.nan]], "position of grasp 1"),
            (lambda M: M[:0], "number of grasps"),
            (lambda M: M @ np.diag([1.0, 1.0, -1.0, 1.0]), "no rigid motion"),
        ],
    )
    def test_what_is_no_pose_is_refused(
        self, tmp_path: Path, change: Callable[[np.ndarray], np.ndarray], words: str
    ) -> None:
        path = self.write(tmp_path / "mug.h5", change(self.hands().matrix()))
        with pytest.raises(InvalidValue, match=words):
            bring_in(path)

    def test_other_files_are_damaged(self, tmp_path: Path) -> None:
        path = tmp_path / "mug.h5"
        with pytest.raises(DamagedFile, match="no such file"):
            bring_in(path)
        path.write_bytes(b"hello")
        with pytest.raises(DamagedFile, match="HDF5"):
            bring_in(path)
        with self.h5py.File(path, "w") as file:
            file["something"] = np.zeros(3)
        with pytest.raises(DamagedFile, match="ACRONYM"):
            bring_in(path)
        with pytest.raises(DamagedFile, match=r"\(3, 4\)"):
            bring_in(self.write(path, np.zeros((3, 4))))
