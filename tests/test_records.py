"""Files of runs: what does not belong is refused with a reason."""

import json

import numpy as np
import pytest

import optsc
from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import Pose
from optsc.operators import Button, OperatorSample
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


class Busy(Still):
    """A hand that presses and nudges, sometimes with what is not a number."""

    def read(self, view):
        tick = round(view.time * 500)
        nudge = (None, (0.0, 1e-3, 0.0, 0.0, 0.0, -0.02), (np.nan,) * 6)[tick % 3]
        buttons = frozenset(list(Button)[: tick % (len(Button) + 1)])
        X_SH = Pose(np.array([0.0, 1.0, 0.0, 0.0]), np.zeros(3))
        return OperatorSample(view.time, X_SH, True, tick % 7 == 0, buttons, nudge)


def test_buttons_and_nudges_survive_the_file(tmp_path):
    run = short_run(operator=Busy())
    run.save(tmp_path / "run.npz")
    for tick, sample in zip(run, load_inputs(tmp_path / "run.npz").samples, strict=True):
        assert sample.buttons == tick.sample.buttons
        assert repr(sample.nudge) == repr(tick.sample.nudge)
        assert (sample.stamp, sample.clutch, sample.trigger) == tick.sample[:1] + tick.sample[2:4]


def test_a_file_of_the_first_format_is_read(tmp_path):
    run = short_run()
    run.save(tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz") as file:
        arrays = dict(file)
    arrays["samples"] = arrays["samples"][:, :10]
    arrays["about"] = np.array(json.dumps({**json.loads(str(arrays["about"])), "format": 1}))
    np.savez(tmp_path / "old.npz", **arrays)
    samples = load_inputs(tmp_path / "old.npz").samples
    assert all(sample.buttons == frozenset() and sample.nudge is None for sample in samples)
    assert optsc.replay(controller(), load_inputs(tmp_path / "old.npz")).commands.tobytes() == run.commands.tobytes()


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
