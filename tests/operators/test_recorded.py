import numpy as np
import pytest

from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import Pose, rotation
from optsc.operators.recorded import COLUMNS, HandRecording, Recorded
from optsc.operators.sample import OperatorView, fault_of

HEADER = ",".join(COLUMNS)


def spiral(count=100, period=0.02, turn_per_sample=0.05):
    time = 5.0 + period * np.arange(count)
    angle = turn_per_sample * np.arange(count)
    p = np.column_stack([np.cos(angle), np.sin(angle), 0.1 * angle])
    return np.column_stack([time, p, rotation.exp(angle[:, None] * [0.0, 0.0, 1.0])])


def view(time):
    return OperatorView(time, Pose.identity(), False, False, {})


def play(operator, rate, duration, start=0.0):
    samples = [operator.read(view(start + k / rate)) for k in range(round(duration * rate) + 1)]
    return [s for s in samples if s is not None]


def test_a_recording_is_played_back_sample_by_sample():
    table = spiral()
    samples = play(Recorded(HandRecording.from_array(table)), rate=500.0, duration=3.0, start=11.0)
    assert len(samples) == len(table)
    np.testing.assert_allclose([s.stamp for s in samples], 11.0 + table[:, 0] - 5.0, atol=1e-9)
    np.testing.assert_array_equal([s.X_SH.translation for s in samples], table[:, 1:4])
    np.testing.assert_allclose([s.X_SH.quaternion for s in samples], table[:, 4:], atol=1e-15)
    assert all(s.clutch and not s.trigger for s in samples)
    assert all(fault_of(s, None) is None for s in samples)


def test_each_sample_is_handed_in_once_and_the_newest_wins():
    operator = Recorded(HandRecording.from_array(spiral()))
    assert operator.read(view(1.0)).stamp == pytest.approx(1.0)
    assert operator.read(view(1.019)) is None
    assert operator.read(view(1.10)).stamp == pytest.approx(1.10)
    assert operator.read(view(1.10)) is None


def test_after_the_last_sample_the_hand_falls_silent():
    operator = Recorded(HandRecording.from_array(spiral(count=10)))
    play(operator, rate=100.0, duration=0.17)
    assert not operator.finished
    assert operator.read(view(0.5)) is not None
    assert operator.finished
    assert operator.read(view(0.6)) is None


def test_the_clutch_is_let_go_of_for_a_moment_every_so_often():
    operator = Recorded(HandRecording.from_array(spiral(count=500)), reengage_every=2.0, release=0.1)
    samples = play(operator, rate=50.0, duration=9.98)
    released = np.array([s.stamp for s in samples if not s.clutch])
    np.testing.assert_allclose(released, [n + 0.02 * k for n in (2, 4, 6, 8) for k in range(5)], atol=1e-9)


def test_scaling_by_one_changes_nothing_and_by_zero_stands_still():
    recording = HandRecording.from_array(spiral())
    assert recording.scaled(1.0, 1.0).X_SH.almost_equal(recording.X_SH, 1e-9)
    still = recording.scaled(0.0, 0.0).X_SH
    assert still.almost_equal(Pose(np.tile(still.quaternion[0], (100, 1)), np.tile(still.translation[0], (100, 1))))


def test_rotations_are_scaled_past_half_a_turn_without_a_jump():
    recording = HandRecording.from_array(spiral(count=200, turn_per_sample=0.05))  # 10 rad in all
    scaled = recording.scaled(0.3, 0.3).X_SH
    steps = rotation.angle(scaled.quaternion[:-1], scaled.quaternion[1:])
    np.testing.assert_allclose(steps, 0.3 * 0.05, rtol=1e-9)
    np.testing.assert_allclose(
        np.diff(scaled.translation, axis=0), 0.3 * np.diff(recording.X_SH.translation, axis=0), atol=1e-15
    )


def test_a_file_is_read_with_its_columns_in_any_order_and_switches_if_it_has_them(tmp_path):
    path = tmp_path / "hand.csv"
    path.write_text("trigger,t,x,y,z,qw,qx,qy,qz\n0,0.00,1,2,3,1,0,0,0\n1,0.02,4,5,6,0,0,0,1\n\n")
    recording = HandRecording.from_csv(path)
    assert len(recording) == 2
    assert recording.duration == pytest.approx(0.02)
    np.testing.assert_array_equal(recording.X_SH.translation, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(recording.trigger, [False, True])
    assert recording.clutch.all()
    assert [s.trigger for s in play(Recorded(recording), 50.0, 0.02)] == [False, True]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no column named t"),
        ("t,x,y,z\n", "qw"),
        (HEADER + "\n", "at least 1 rows"),
        (HEADER + "\n0,0,0,0,1,0,0\n", "7 entries"),
        (HEADER + "\n0,0,0,0,1,0,0,zero\n", "zero"),
        (HEADER + "\n0,0,0,0,1,0,0,nan\n", "sample 0"),
        (HEADER + "\n0,0,0,0,1,0,0,0\n1,0,0,0,2,0,0,0\n", "quaternion of sample 1"),
        (HEADER + "\n0,0,0,0,1,0,0,0\n0,0,0,0,1,0,0,0\n", "time of sample 1"),
    ],
)
def test_a_damaged_file_is_refused_with_what_is_wrong_with_it(tmp_path, text, says):
    path = tmp_path / "hand.csv"
    path.write_text(text)
    with pytest.raises(DamagedFile, match=says):
        HandRecording.from_csv(path)


def test_a_file_that_is_no_text_is_refused(tmp_path):
    path = tmp_path / "hand.csv"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(DamagedFile, match="not a CSV"):
        HandRecording.from_csv(path)


def test_a_recording_cannot_be_changed_afterwards():
    recording = HandRecording.from_array(spiral())
    with pytest.raises(ValueError, match="read-only"):
        recording.time[0] = 0.0


@pytest.mark.parametrize(("every", "release"), [(1.0, 0.0), (1.0, 1.0), (0.05, 0.1), (float("nan"), 0.1)])
def test_a_release_that_does_not_fit_is_refused(every, release):
    with pytest.raises(InvalidValue):
        Recorded(HandRecording.from_array(spiral()), reengage_every=every, release=release)


def test_switches_of_another_length_are_refused():
    with pytest.raises(InvalidValue, match="clutch"):
        HandRecording.from_array(spiral(), clutch=[True])


def test_the_recording_that_comes_along_is_forty_seconds_of_a_quick_hand():
    recording = HandRecording.example()
    assert len(recording) == 2000
    assert recording.duration == pytest.approx(39.98)
    speed = np.linalg.norm(np.diff(recording.X_SH.translation, axis=0), axis=1) / np.diff(recording.time)
    assert np.median(speed) == pytest.approx(0.53, abs=0.01)
    assert recording.clutch.all()
    assert not recording.trigger.any()
