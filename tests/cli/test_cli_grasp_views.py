"""``optsc grasps build --image``: what is found in a recorded depth image, and what is said where nothing is."""

import json
from dataclasses import replace

import numpy as np
import pytest

import optsc
from optsc.cli import main
from optsc.geometry import PinholeCamera, Pose
from optsc.grasps import GraspLibrary
from optsc.perception import save_depth_image
from optsc.sim.camera import DepthCamera


@pytest.fixture(scope="module")
def view():
    robot = optsc.load_robot("panda")
    world = optsc.sim.tabletop(robot, objects=("can", "box"), seed=1)
    with DepthCamera(world, camera=PinholeCamera.from_field_of_view(320, 240, 0.75)) as camera:
        return camera.capture(robot.home, rng=np.random.default_rng(0)).image


@pytest.fixture
def file(tmp_path, view):
    path = tmp_path / "view.npz"
    save_depth_image(path, view)
    return path


def build(file, *words, count=3):
    folder = file.parent / "grasps"
    arguments = ["grasps", "build", "--image", str(file), "--output", str(folder), "--count", str(count)]
    return main([*arguments, *words]), folder


@pytest.fixture
def arm():
    return ["--robot", "panda", "--posture", *map(str, optsc.load_robot("panda").home)]


def test_known_and_unknown_objects_of_a_view_are_stored_with_how_they_were_seen(file, arm, capsys):
    code, folder = build(file, "--templates", "can", "--unknown", *arm)
    assert code == 0
    said = capsys.readouterr().out
    assert "can: " in said
    assert "recognised as can" in said
    assert "residual" in said
    assert "unknown: " in said
    assert "not recognised (" in said
    library = GraspLibrary.load(folder)
    assert set(library) == {"can", "unknown"}
    assert library["can"].provenance["made_from"] == "the template can"
    assert 0.3 < library["can"].visible_fraction <= 1.0
    seen = json.loads((folder / "summary.json").read_text())["view"]
    assert seen["can"]["template"] == "can"
    assert seen["unknown"]["refusal"]
    assert main(["grasps", "validate", str(folder), "--objects", "can", "--workers", "1"]) == 0
    assert "tried on the catalogue's can (1 convex piece, 0.3 kg" in capsys.readouterr().out
    assert main(["grasps", "validate", str(folder), "--objects", "unknown"]) == 1
    assert "--mesh" in capsys.readouterr().err


def test_what_was_seen_lying_is_tried_lying(tmp_path, arm, capsys):
    robot = optsc.load_robot("panda")
    world = optsc.sim.tabletop(robot, objects=("bottle",), seed=1)
    lying = Pose.from_rotation_vector([0.0, 0.5 * np.pi, 0.0], np.array([0.0, 0.0, 0.0300]))
    turned = Pose.from_translation(world.X_WO["bottle"].translation) @ lying
    with DepthCamera(world, camera=PinholeCamera.from_field_of_view(320, 240, 0.75)) as camera:
        image = camera.capture(robot.home, X_WO={"bottle": turned}, rng=np.random.default_rng(0)).image
    save_depth_image(tmp_path / "view.npz", image)
    code, folder = build(tmp_path / "view.npz", "--templates", "bottle", *arm)
    assert code == 0
    assert abs(GraspLibrary.load(folder)["bottle"].provenance["up"][2]) < 0.1
    assert main(["grasps", "validate", str(folder), "--workers", "1"]) == 0
    assert "3 of 3 tried held" in capsys.readouterr().out


def test_what_is_not_recognised_is_named_and_left_alone_unless_wanted(file, arm, capsys):
    code, folder = build(file, "--templates", "can", *arm)
    assert code == 0
    assert "--unknown has them looked for" in capsys.readouterr().out
    assert set(GraspLibrary.load(folder)) == {"can"}


def test_grasps_of_another_view_are_not_written_over(file, arm, capsys):
    assert build(file, "--templates", "can", *arm)[0] == 0
    assert build(file, "--templates", "can", *arm)[0] == 0  # the same once more is no other
    assert build(file, "--templates", "can", *arm, count=2)[0] == 1
    assert "--replace" in capsys.readouterr().err
    assert build(file, "--templates", "can", "--replace", *arm, count=2)[0] == 0


def test_a_template_may_be_a_file(file, arm, tmp_path, capsys):
    import trimesh

    from optsc.sim import object_model

    mesh = object_model("can").mesh
    tin = tmp_path / "tin.stl"
    trimesh.Trimesh(1e3 * mesh.vertices, mesh.faces, process=False).export(tin)
    code, folder = build(file, "--templates", str(tin), "--unit", "0.001", *arm)
    assert code == 0
    capsys.readouterr()
    assert main(["grasps", "validate", str(folder), "--workers", "1"]) == 0
    assert "tried on the surface that is stored with them" in capsys.readouterr().out
    assert build(file, "--templates", str(tin), *arm)[0] == 1
    assert "millimetres" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "words", "answer"),
    [
        (None, ["--templates", "can"], "no such file"),
        ({"depth": np.full((240, 320), np.nan)}, ["--unknown"], "nothing was measured"),
        ({"X_WC": 0.3}, ["--unknown"], r"--table-height 0.3"),
        ({}, ["--templates", "elephant"], "banana, bottle"),
        ({}, ["--templates", "elephant.stl"], "no such file"),
        ({}, ["--templates", "can", "can"], "each name once"),
        ({}, [], "--unknown"),
        ({}, ["--unknown", "--robot", "panda"], "both, or neither"),
        ({}, ["--unknown", "--name", "x"], "only with --mesh"),
        ({}, ["--unknown", "--unit", "0.001"], "only with --mesh"),
    ],
)
def test_bad_input_has_a_clear_answer(file, view, change, words, answer, capsys):
    if change is None:
        file.unlink()
    else:
        if "X_WC" in change:
            change = {"X_WC": Pose.from_translation([0.0, 0.0, change["X_WC"]]) @ view.X_WC}
        save_depth_image(file, replace(view, **change))
    code, folder = build(file, *words)
    assert code == 1
    assert answer in capsys.readouterr().err
    assert not folder.exists()
