"""Recordings: what is kept when all goes well, and when it does not; and that a run can be run again."""

import json
import os
import signal
import time

import numpy as np
import pytest
from live_pages import PATIENCE, opened

import optsc.cli
from optsc.errors import DamagedFile
from optsc.live.children import Child
from optsc.live.frames import unpacked
from optsc.live.hand_mailbox import TRIGGER, HandReading, HandWriter
from optsc.live.layout import SharedParts
from optsc.live.live_session import run_control
from optsc.live.recorder import MEANING, run_recorder
from optsc.live.rerun import rerun
from optsc.live.run_folder import FRAMES, TICKS, RunFolder, in_one_file
from optsc.live.scene import LiveScene, SceneChoice
from optsc.live.settings_block import LiveSettings
from optsc.live.site import single_file

CHOICE = SceneChoice(follower="ideal", objects=("can",), timeout=5.0)


class Recorded:
    """A session without a page: control process and recorder, and a hand that the test moves."""

    def __init__(self, path):
        scene = LiveScene(CHOICE)
        self.path, self.parts = path, SharedParts(scene.sizes)
        self.shared = (CHOICE, scene.sizes, self.parts.segment.name)
        self.control = Child("control", run_control, *self.shared)
        self.recorder = self.recording()
        self.control.wait_until_ready()
        self.hand, self.p, self.state = HandWriter(self.parts.hand), np.zeros(3), np.zeros(self.parts.state.size)

    def recording(self):
        child = Child("recorder", run_recorder, *self.shared, self.path, finishes=True)
        child.wait_until_ready()
        return child

    def of(self, name):
        assert self.parts.state.read(self.state)
        return float(self.state[self.parts.state_columns.at(name)])

    def go(self, duration, velocity=(0.0, 0.0, 0.0), pressed=(), engaged=True):
        """Move the hand for a time of the run."""
        start = self.of("time")
        limit = time.monotonic() + PATIENCE
        while (now := self.of("time")) < start + duration:
            assert time.monotonic() < limit
            self.p = self.p + 0.01 * np.asarray(velocity)
            self.hand.post(HandReading(time.perf_counter(), self.p, (1.0, 0.0, 0.0, 0.0), engaged, pressed, now))
            pressed = ()
            time.sleep(0.01)

    def close(self):
        self.control.close()
        self.recorder.close()
        self.parts.segment.close()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run in which much happens, and whose recorder is killed in the middle."""
    path = tmp_path_factory.mktemp("recorded") / "run"
    session = Recorded(path)
    while not session.parts.state.count:
        time.sleep(0.01)
    session.go(0.3, engaged=False)
    session.go(0.8, velocity=(0.1, 0.0, -0.2))
    session.parts.settings.write(LiveSettings(rule="weighted sum", scale=0.5, cutoff=3.0).row())
    session.go(0.4, velocity=(0.0, 0.1, 0.0))
    os.kill(session.recorder.pid, signal.SIGKILL)
    session.go(0.5)
    session.recorder.close()
    session.recorder = session.recording()
    session.go(0.6, pressed=[TRIGGER])
    session.parts.settings.write(LiveSettings(scale=0.5, restarts=1).row())
    session.go(0.5, velocity=(0.1, 0.0, 0.0))
    session.close()
    return RunFolder(path)


def test_no_tick_is_lost_although_a_recorder_was_killed(run):
    table = run.ticks()
    ticks = table.column("tick").to_numpy()
    restart = int(np.flatnonzero(np.diff(ticks) < 0)[0])
    for part in (ticks[: restart + 1], ticks[restart + 1 :]):
        assert part.tolist() == list(range(1, len(part) + 1))
    assert np.all(np.diff(table.column("clock").to_numpy()) > 0.0)
    assert (run.path / TICKS).exists()
    assert run.streams == []


def test_a_recording_says_what_its_columns_are(run):
    assert run.choice == CHOICE
    assert set(run.about["columns"]) == set(MEANING)
    names = {name if name in MEANING else name.rpartition("_")[0] for name in run.ticks().column_names}
    assert names == set(MEANING)
    assert "optsc" in run.about["versions"]
    table = run.ticks()
    modes = {run.about["modes"][int(i)] for i in np.unique(table.column("mode").to_numpy())}
    assert {"hold", "manual"} < modes
    scales = np.unique(table.column(f"settings_{run.about['settings'].index('scale')}").to_numpy())
    assert scales.tolist() == [0.5, 1.0]


def test_a_recorded_session_run_again_gives_the_same_commands_bit_for_bit(run, capsys):
    outcome = rerun(run)
    assert outcome.ticks > 1000
    assert (outcome.differing, outcome.missing) == (0, 0)
    assert optsc.cli.main(["replay", str(run.path), "--again"]) == 0
    assert "0 with another command" in capsys.readouterr().out


def test_the_page_of_a_run_plays_from_a_file_and_asks_for_nothing(run, browser, tmp_path):
    assert optsc.cli.main(["replay", str(run.path), "--html", str(tmp_path / "replay.html")]) == 0
    requests = []
    with opened(browser, (tmp_path / "replay.html").as_uri(), ready=False) as page:
        page.page.on("request", lambda request: requests.append(request.url))
        page.wait_for("Boolean(window.optsc && optsc.player && optsc.moment)")
        page.ask("optsc.view.period = 100")
        page.ask("optsc.player.seek(optsc.player.moments.find((m) => m.mode === 'manual').at)")
        assert page.mode == "manual"
        assert page.page.inner_text("#mode") == "Yours to lead" or page.page.inner_text("#mode") == "You lead"
        for end in ("end", "begin"):
            page.ask(f"optsc.player.seek(optsc.player.{end})")
            assert page.ask(f"optsc.moment.at === optsc.player.{end}")
        page.ask("optsc.player.seek(optsc.player.end)")
        assert page.page.input_value("#set-scale") == "0.5"
        page.ask("optsc.player.play(true)")
        page.wait_for("optsc.player.time > optsc.player.begin + 0.2")
    assert [url for url in requests if not url.startswith(("data:", "file:"))] == []


def test_frames_are_kept_with_the_scene_first(run):
    data = run.frames()
    length = int.from_bytes(data[:4], "little")
    assert unpacked(data[4 : 4 + length])[0]["kind"] == "scene"
    assert len(single_file(data)) < 10_000_000


def test_half_a_batch_and_half_a_frame_at_the_end_are_left_out(run, tmp_path):
    session = Recorded(tmp_path / "killed")
    while not session.parts.state.count:
        time.sleep(0.01)
    session.go(1.5)
    os.kill(session.recorder.pid, signal.SIGKILL)
    session.recorder.close()
    session.control.close()
    written = session.parts.ticks.written
    session.parts.segment.close()
    folder = RunFolder(session.path)
    whole = len(folder.ticks())
    assert 0 < whole <= written
    (stream,) = folder.streams
    data = stream.read_bytes()
    stream.write_bytes(data[:-100])
    (session.path / FRAMES).write_bytes(folder.frames() + b"\x10\0\0\0half")
    assert 0 < len(folder.ticks()) < whole
    assert folder.frames()[-4:] != b"half"
    count = in_one_file(session.path)
    assert count == len(RunFolder(session.path).ticks())


def test_what_is_no_run_is_refused(tmp_path, run):
    with pytest.raises(DamagedFile, match="no recorded run"):
        RunFolder(tmp_path)
    (tmp_path / "about.json").write_text(json.dumps({**run.about, "format": 99}))
    with pytest.raises(DamagedFile, match="format 99"):
        RunFolder(tmp_path)
    (tmp_path / "about.json").write_text(json.dumps({**run.about, "scene": {"robot": "none"}}))
    with pytest.raises(DamagedFile, match="names no scene"):
        RunFolder(tmp_path).choice  # noqa: B018
