"""Files of runs: what does not belong is refused with a reason."""

import json

import numpy as np
import pytest

import optsc
from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import Pose
from optsc.operators import OperatorSample
from optsc.records import FORMAT, load_inputs
from optsc.robot import load_robot


class Still:
    """A hand that rests; every third sample is not a number."""

    def read(self, view):
        q = [0.0, 1.0, 0.0, 0.0] if round(view.time * 500) % 3 else [np.nan] * 4
        return OperatorSample(view.time, Pose(np.array(q), np.zeros(3)), clutch=view.time > 0.02)


def controller():
    robot = load_robot("panda")
    return optsc.SharedController(robot, optsc.GraspSelector(robot))


def short_run(**arguments):
    settings = {"operator": Still(), "follower": optsc.IdealFollower(load_robot("panda")), "duration": 0.1}
    return optsc.run(controller(), **{**settings, **arguments})


def test_a_run_with_bad_samples_in_it_survives_the_file_and_replays(tmp_path):
    run = short_run()
    run.save(tmp_path / "run.npz")
    inputs = load_inputs(tmp_path / "run.npz")
    assert len(inputs.samples) == len(run) == 50
    assert optsc.replay(controller(), inputs).commands.tobytes() == run.commands.tobytes()


def test_files_that_are_no_runs_are_refused(tmp_path):
    with pytest.raises(DamagedFile):
        load_inputs(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("hello")
    with pytest.raises(DamagedFile, match="no recorded run"):
        load_inputs(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    with pytest.raises(DamagedFile):
        load_inputs(tmp_path / "other.npz")


def test_a_file_of_a_newer_version_is_refused(tmp_path):
    short_run().save(tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz") as file:
        arrays = dict(file)
    arrays["about"] = np.array(json.dumps({**json.loads(str(arrays["about"])), "format": FORMAT + 1}))
    np.savez(tmp_path / "newer.npz", **arrays)
    with pytest.raises(DamagedFile, match="format"):
        load_inputs(tmp_path / "newer.npz")


@pytest.mark.parametrize("wrong", [{"rate": 0.0}, {"duration": -1.0}, {"start": [0.0]}])
def test_impossible_runs_are_refused(wrong):
    with pytest.raises(InvalidValue):
        short_run(**wrong)
