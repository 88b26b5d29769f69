"""User-defined objects on the command line: their mesh, others' grasps of them, and what these are tried on."""

import numpy as np
import pytest
import trimesh

from optsc.cli import main
from optsc.geometry import Pose
from optsc.grasps import GraspLibrary
from optsc.sampling.importing import ACRONYM_X_HG, PANDA_X_HG
from optsc.sim.objects.solids import cuboid

OFF = np.array([0.3, 0.1, -0.2])  # where the mesh file has the centre of the part's base


@pytest.fixture
def part(tmp_path):
    """A brick in millimetres whose frame is somewhere else."""
    mesh = cuboid([-0.02, -0.03, 0.0], [0.02, 0.03, 0.06])
    path = tmp_path / "part.stl"
    trimesh.Trimesh(1e3 * (mesh.vertices + OFF), mesh.faces, process=False).export(path)
    return path


@pytest.fixture
def poses(tmp_path):
    def write(X_HG=None):
        """Two grasps from above, along the short side and along the long one, of a hand frame."""
        down = Pose.from_rotation_vector([np.pi, 0.0, 0.0], [0.0, 0.0, 0.04])
        turns = [Pose.from_rotation_vector([0.0, 0.0, turn], np.zeros(3)) for turn in (0.0, np.pi / 2)]
        both = Pose.stack([down @ turn for turn in turns])
        both = Pose.from_translation(OFF) @ both
        both = both if X_HG is None else both @ X_HG.inverse()
        rows = [
            ",".join(map(repr, [*p.tolist(), *q.tolist()]))
            for p, q in zip(both.translation, both.quaternion, strict=True)
        ]
        path = tmp_path / "poses.csv"
        path.write_text("x,y,z,qw,qx,qy,qz\n" + "\n".join(rows) + "\n")
        return path

    return write


def bring_in(path, folder, *words, name="widget"):
    return main(["grasps", "import", str(path), "--name", name, "--output", str(folder), *words])


def validate(folder, *words):
    return main(["grasps", "validate", str(folder), "--workers", "1", *words])


def test_grasps_of_a_mesh_file_are_found_and_tried_on_it(part, tmp_path, capsys):
    folder = tmp_path / "g"
    build = ["grasps", "build", "--mesh", str(part), "--output", str(folder), "--count", "3"]
    assert main(build) == 1
    assert "millimetres" in capsys.readouterr().err
    assert main([*build, "--unit", "0.001"]) == 0
    assert "part: 40.0 x 60.0 x 60.0 mm" in capsys.readouterr().out
    assert validate(folder) == 0
    said = capsys.readouterr().out
    assert "tried on the surface that is stored with them (1 convex piece, 0.144 kg" in said
    assert "3 of 3 tried held" in said
    assert main([*build, "--unit", "0.001", "--seed", "2"]) == 1
    assert "tried" in capsys.readouterr().err


def test_imported_grasps_are_tried_on_the_surface_that_came_with_them(part, poses, tmp_path, capsys):
    table, folder = poses(PANDA_X_HG), tmp_path / "g"
    surface = ["--mesh", str(part), "--unit", "0.001"]
    assert bring_in(table, folder, *surface, "--frame", "panda_hand") == 0
    assert "grasps moved by (-300.0, -100.0, 200.0) mm" in capsys.readouterr().out
    np.testing.assert_allclose(GraspLibrary.load(folder)["widget"].X_OG.translation, [[0, 0, 0.04]] * 2, atol=1e-6)
    elsewhere = tmp_path / "tried"
    assert validate(folder, "--output", str(elsewhere)) == 0
    assert "2 of 2 tried held" in capsys.readouterr().out
    assert validate(elsewhere) == 0  # the surface went with them


def test_a_surface_may_come_with_the_trial_instead(part, poses, tmp_path, capsys):
    folder = tmp_path / "g"
    assert bring_in(poses(), folder) == 0
    assert validate(folder) == 1
    assert "--mesh" in capsys.readouterr().err
    assert validate(folder, "--mesh", str(part), "--unit", "0.001", "--mass", "0.2") == 0
    said = capsys.readouterr().out
    assert "part.stl, in whose frame the grasps are taken to be" in said
    assert "0.2 kg" in said
    assert "2 of 2 tried held" in said
    about = GraspLibrary.load(folder)["widget"].provenance["validation"]
    assert (about["held"], about["mass"]) == (2, 0.2)


def test_another_surface_than_that_of_the_grasps_is_refused(part, poses, tmp_path, capsys):
    folder, other = tmp_path / "g", tmp_path / "other.stl"
    trimesh.creation.box([40.0, 40.0, 40.0]).export(other)
    assert bring_in(poses(), folder, "--mesh", str(part), "--unit", "0.001") == 0
    assert validate(folder, "--mesh", str(part), "--unit", "0.001") == 0
    assert validate(folder, "--mesh", str(other), "--unit", "0.001") == 1
    assert "other.stl" in capsys.readouterr().err


def test_an_imported_mug_tried_on_the_catalogues_says_so(poses, tmp_path, capsys):
    folder = tmp_path / "g"
    assert bring_in(poses(), folder, name="mug") == 0
    assert validate(folder) == 0
    assert "the catalogue's mug: the imported grasps name no surface" in capsys.readouterr().out
    assert "nobody knows" in GraspLibrary.load(folder)["mug"].provenance["validation"]["on"]
    assert main(["grasps", "build", "--objects", "mug", "--output", str(folder)]) == 1
    assert "imported from poses.csv, tried" in capsys.readouterr().err


def test_grasps_that_are_nowhere_near_their_surface_are_pointed_out(part, poses, tmp_path, capsys):
    assert bring_in(poses(ACRONYM_X_HG), tmp_path / "g", "--mesh", str(part), "--unit", "0.001") == 0
    assert "2 of 2 grasps are more than 30 mm away" in capsys.readouterr().out


def test_an_acronym_file_says_itself_how_its_mesh_is_scaled(part, tmp_path, capsys):
    h5py = pytest.importorskip("h5py")
    above = Pose.from_rotation_vector([np.pi, 0.0, 0.0], OFF + [0.0, 0.0, 0.04])
    path = tmp_path / "poses.h5"
    with h5py.File(path, "w") as file:
        file["grasps/transforms"] = (above @ ACRONYM_X_HG.inverse()).matrix()[None]
        file["object/scale"] = 0.001
    assert bring_in(path, tmp_path / "g", "--mesh", str(part)) == 0
    assert "40.0 x 60.0 x 60.0 mm" in capsys.readouterr().out
    assert validate(tmp_path / "g") == 0
    assert "1 of 1 tried held" in capsys.readouterr().out


@pytest.mark.parametrize("frame", [["tool"], ["0", "0", "0", "1", "0", "0", "0"]])
def test_a_frame_is_a_name_or_seven_numbers(poses, tmp_path, frame):
    assert bring_in(poses(), tmp_path / "g", "--frame", *frame) == 0
    grasps = GraspLibrary.load(tmp_path / "g")["widget"]
    np.testing.assert_allclose(grasps.X_OG.translation, [OFF + [0.0, 0.0, 0.04]] * 2, atol=1e-12)


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        (["--frame", "thumb"], "panda_hand"),
        (["--frame", "0", "0", "0"], "seven numbers"),
        (["--frame", "0", "0", "103.4", "1", "0", "0", "0"], "millimetres"),
        (["--frame", "0", "0", "0", "0", "0", "0", "0"], "quaternion"),
        (["--mesh", "nowhere.stl"], "no such file"),
        (["--unit", "0.001"], "only with --mesh"),
    ],
)
def test_bad_words_of_an_import_have_a_clear_answer(poses, tmp_path, words, answer, capsys):
    assert bring_in(poses(), tmp_path / "g", *words) == 1
    assert answer in capsys.readouterr().err
    assert not (tmp_path / "g").exists()


def test_a_flat_mesh_is_refused(tmp_path, capsys):
    flat = tmp_path / "flat.stl"
    corners = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]])
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]]).export(flat)
    assert main(["grasps", "build", "--mesh", str(flat), "--output", str(tmp_path / "g")]) == 1
    assert "volume" in capsys.readouterr().err


def test_one_surface_is_not_for_several_objects(part, poses, tmp_path, capsys):
    folder = tmp_path / "g"
    assert bring_in(poses(), folder) == 0
    assert bring_in(poses(), folder, name="thing") == 0
    assert validate(folder, "--mesh", str(part), "--unit", "0.001") == 1
    assert "--objects" in capsys.readouterr().err
