"""Recorder: takes every tick out of the ring into a run folder, in a process of its own."""

from __future__ import annotations

import json
import platform
import struct
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow

import optsc
from optsc.geometry.rotation import Array
from optsc.live.frames import Frames
from optsc.live.layout import TERMS, SharedParts, Sizes, text_of
from optsc.live.run_folder import ABOUT, FORMAT, FRAMES, in_one_file, whole_frames
from optsc.live.scene import LiveScene, SceneChoice
from optsc.live.settings_block import COLUMNS as SETTINGS
from optsc.live.state_rows import BUTTONS, EVENTS, MODES, STATUSES

LOOK_EVERY = 0.02
"""From one look at the ring to the next [s]."""
FLUSH_EVERY = 0.5
"""From one batch of ticks to the next [s]: so much is lost at most where this process is killed."""
FRAME_PERIOD = 0.05
"""From one frame that is kept to the next [s]."""

MEANING = {
    "tick": "number of the tick since the scene began",
    "time": "time of the run [s]",
    "clock": "when the tick began, on the machine's monotonic clock [s]",
    "late": "how late it began [s]",
    "lost": "by how much the schedule was put off altogether [s]",
    "elapsed": "time that the controller took [s]",
    "mode": "index into modes",
    "status": "index into statuses",
    "event": "index into events, -1 for none",
    "arrival": "when the newest reading of the hand arrived, on the same clock [s]",
    "device_time": "when it was taken, on the device's clock [s]",
    "raw_p": "position of the hand in the station [m]",
    "raw_q": "its unit quaternion (w, x, y, z)",
    "sample": "1 where the controller was given a sample at this tick",
    "stamp": "stamp of that sample, on the same clock as its arrival [s]",
    "engaged": "1 while the hand holds the arm",
    "trigger": "1 where the sample had the trigger pressed",
    "buttons": "sum of 2^i over the pressed buttons i",
    "q": "commanded joint positions [rad]",
    "v": "commanded joint velocities [rad/s]",
    "a": "commanded joint accelerations [rad/s^2]",
    "opening": "commanded distance of the jaws [m]",
    "q_measured": "measured joint positions before the command [rad]",
    "v_measured": "measured joint velocities [rad/s]",
    "opening_measured": "measured distance of the jaws [m]",
    "measured_time": "time of that measurement [s]",
    "target": "pose that the tool is led along: position [m], unit quaternion (w, x, y, z)",
    "error": "reference minus commanded tool pose, in the tool frame [m, rad]",
    "intended": "index into objects of the intended one, -1 for none",
    "held": "index into objects of what the jaws hold, -1 for nothing, -2 for something else",
    "selected": "candidate that is its selected grasp",
    "terms": "costs of that grasp, see terms",
    "objects": "pose of each object: position [m], unit quaternion (w, x, y, z)",
    "observations": "how often the grasps of objects that moved were placed again",
    "seen": "poses of the objects that the grasps in use follow from: position [m], unit quaternion (w, x, y, z)",
    "seen_q": "joint positions that they were solved from [rad]",
    "settings": "settings in force, see settings",
    "reason": "why motion was held back or a request refused",
}


class RunWriter:
    """Writes a run folder.

    Args:
        path: the folder; made where it is not there.
        scene: of the session.
        parts: its shared memory.
    """

    def __init__(self, path: Path, scene: LiveScene, parts: SharedParts) -> None:
        path.mkdir(parents=True, exist_ok=True)
        self.path, self._columns = path, parts.tick_columns
        self._reason = self._columns["reason"]
        labels = self._columns.labels[: self._reason.start]
        fields = [pyarrow.field(label, pyarrow.float64()) for label in labels]
        self._schema = pyarrow.schema([*fields, pyarrow.field("reason", pyarrow.string())])
        number = 1 + len(list(path.glob("ticks-*.arrows")))
        if number == 1:
            about = json.dumps(about_run(scene, parts), indent=1)
            (path / ABOUT).write_text(about + "\n", encoding="utf-8")
        options = pyarrow.ipc.IpcWriteOptions(compression="zstd")
        # Appending and unbuffered, so that what is written is in the operating system's hands.
        self._file = open(path / f"ticks-{number}.arrows", "ab", buffering=0)  # noqa: SIM115
        self._stream = pyarrow.ipc.new_stream(self._file, self._schema, options=options)
        self._frames = open(path / FRAMES, "ab", buffering=0)  # noqa: SIM115
        whole = whole_frames((path / FRAMES).read_bytes())
        self._frames.truncate(whole)  # a recorder before this one may have been killed in the middle of one
        self._empty = whole == 0

    def ticks(self, rows: Array) -> None:
        """Append ticks (R, size) as one whole batch."""
        if not len(rows):
            return
        end = self._reason.start
        texts, known = [], (b"", "")
        for row in rows[:, end:]:
            data = row.tobytes()
            if data != known[0]:
                known = data, text_of(row)
            texts.append(known[1])
        arrays = [pyarrow.array(np.ascontiguousarray(column)) for column in rows[:, :end].T]
        self._stream.write_batch(pyarrow.record_batch([*arrays, pyarrow.array(texts)], schema=self._schema))

    def frame(self, frame: bytes) -> None:
        """Append a frame of the page."""
        self._frames.write(struct.pack("<I", len(frame)) + frame)
        self._empty = False

    @property
    def needs_scene(self) -> bool:
        """Whether no frame was written yet: the first is that of the scene."""
        return self._empty

    def close(self) -> int:
        """Make one file of all ticks, and return how many there are."""
        self._stream.close()
        self._file.close()
        self._frames.close()
        return in_one_file(self.path)


def about_run(scene: LiveScene, parts: SharedParts) -> dict[str, Any]:
    """Return what determines a run, and what its columns are."""
    return {
        "format": FORMAT,
        "begun": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "scene": asdict(scene.choice),
        "versions": {"optsc": optsc.__version__, "python": platform.python_version(), "numpy": np.__version__},
        "machine": platform.platform(),
        "columns": {name: MEANING[name] for name in parts.tick_columns},
        "modes": [mode.value for mode in MODES],
        "statuses": [status.value for status in STATUSES],
        "events": [event.value for event in EVENTS],
        "buttons": [button.name for button in BUTTONS],
        "objects": list(scene.names),
        "joints": list(scene.robot.joint_names),
        "settings": list(SETTINGS),
        "terms": [{"name": cost.name, "unit": cost.unit} for cost in TERMS],
    }


def run_recorder(
    say_ready: Callable[[Any], None],
    ended: Callable[[], bool],
    choice: SceneChoice,
    sizes: Sizes,
    name: str,
    path: Path,
) -> None:
    """Record until the session ends; what is still in the ring then is written too."""
    scene, parts = LiveScene(choice), SharedParts(sizes, name)
    writer, frames = RunWriter(path, scene, parts), Frames(scene, parts.state_columns)
    state, shown, lost = np.zeros(parts.state.size), 0, 0
    waiting: list[Array] = []
    flushed = framed = -np.inf
    if writer.needs_scene:
        writer.frame(frames.scene())
    say_ready(None)
    last = False
    while not last:
        last = ended()
        drained, now = parts.ticks.drain(), time.monotonic()
        waiting.append(drained.rows)
        lost += drained.lost
        if now - flushed >= FLUSH_EVERY or last:
            writer.ticks(np.concatenate(waiting))
            parts.ticks.kept()
            waiting, flushed = [], now
        newest = parts.state.count
        if now - framed >= FRAME_PERIOD and newest != shown and parts.state.read(state):
            writer.frame(frames.moment(state))
            shown, framed = newest, now
        if not last:
            time.sleep(LOOK_EVERY)
    count = writer.close()
    ending = {"ticks": count, "overwritten": lost}
    (path / "summary.json").write_text(json.dumps(ending) + "\n", encoding="utf-8")
