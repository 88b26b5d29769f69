"""Frames of the page: one stream of a scene and moments in it, from the socket or out of a file.

A frame is the length of its header (four bytes, little endian), the header in JSON, padded with spaces so that what
follows begins at a multiple of four, and numbers in single precision. The first frame of a stream is of the kind
``scene`` and names the numbers of the others.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from optsc.collision.link_visuals import CELL, LinkVisuals
from optsc.geometry import Pose, TriangleMesh
from optsc.geometry.rotation import Array
from optsc.live.columns import Columns
from optsc.live.hand_mailbox import PRESSABLE
from optsc.live.layout import TERMS, text_of
from optsc.live.scene import LiveScene
from optsc.live.settings_block import RULES, LiveSettings
from optsc.live.state_rows import EVENTS, MODES, STATUSES

STREAM = 1
"""Version of the stream."""
LIGHT_CELL = 0.02
"""Size of the cubes of the clustering [m] where nobody looks closely, such as in tests without a graphics card."""


def packed(header: Mapping[str, Any], numbers: Array) -> bytes:
    """Return a frame."""
    text = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
    text = text.ljust(-(-len(text) // 4) * 4)
    return struct.pack("<I", len(text)) + text + np.asarray(numbers, dtype="<f4").tobytes()


def unpacked(frame: bytes) -> tuple[dict[str, Any], Array]:
    """Return header and numbers of a frame."""
    (length,) = struct.unpack_from("<I", frame)
    return json.loads(frame[4 : 4 + length]), np.frombuffer(frame, "<f4", offset=4 + length).astype(float)


class Frames:
    """Makes the frames of a scene.

    Args:
        scene: what is driven.
        columns: of a state, as the control process writes it.
        light: whether surfaces are to be as coarse as can be.
    """

    def __init__(self, scene: LiveScene, columns: Columns, light: bool = False) -> None:
        self._scene = scene
        self._reason = columns["reason"]
        self._shown = {name: columns[name] for name in columns if name != "reason"}
        self._q, self._opening = columns["q_measured"], columns.at("opening_measured")
        self._time = columns.at("time")
        self._visuals = LinkVisuals(scene.robot, LIGHT_CELL if light else CELL)
        self._light = light

    def scene(self) -> bytes:
        """Return the first frame of a stream."""
        scene, visuals, numbers = self._scene, self._visuals, _Numbers()
        objects = [
            {"name": name, **numbers.mesh(model.mesh.clustered(LIGHT_CELL) if self._light else model.mesh)}
            for name, model in scene.world.objects.items()
        ]
        links = [
            {"name": v.link, "colour": list(v.colour) if v.given else None, **numbers.mesh(v.mesh)}
            for v in visuals.visuals
        ]
        gripper, candidates = scene.robot.gripper, scene.start.candidates
        widest = 0.0 if gripper is None else gripper.max_opening
        of_object = candidates.object_index.tolist()
        X_WO = Pose.stack([scene.world.X_WO[candidates.object_names[k]] for k in of_object])
        names = [candidates.object_names[k] for k in of_object]
        columns = {name: [part.start, part.stop] for name, part in self._shown.items()}
        end = max(stop for _, stop in columns.values())
        header = {
            "kind": "scene",
            "stream": STREAM,
            "robot": scene.robot.name,
            "joints": list(scene.robot.joint_names),
            "seed": scene.choice.seed,
            "follower": scene.choice.follower,
            "rate": scene.choice.rate,
            "links": links,
            "objects": objects,
            "hand": {
                "links": list(visuals.hand),
                "open": numbers.part(visuals.in_hand(widest)),
                "closed": numbers.part(visuals.in_hand(0.0)),
                "opening": widest,
            },
            "grasps": {
                "object": [scene.names.index(name) for name in names],
                "poses": numbers.part(_rows(X_WO.inverse() @ candidates.X_WG)),
            },
            "columns": {**columns, "links": [end, end + 7 * len(links)]},
            "modes": [mode.value for mode in MODES],
            "statuses": [status.value for status in STATUSES],
            "events": [event.value for event in EVENTS],
            "terms": [[cost.name, cost.unit] for cost in TERMS],
            "settings": asdict(LiveSettings()),
            "rules": list(RULES),
            "buttons": list(PRESSABLE),
        }
        return packed(header, numbers.all())

    def moment(self, state: Array, silent: float = 0.0) -> bytes:
        """Return the frame of a moment; ``silent`` is for how long the control process has said nothing [s]."""
        links = self._visuals.placements(state[self._q], float(state[self._opening]))
        header = {"kind": "moment", "t": round(float(state[self._time]), 4), "reason": text_of(state[self._reason])}
        if silent:
            header["silent"] = round(silent, 2)
        return packed(header, np.concatenate([state[: self._reason.start], links.ravel()]))


class _Numbers:
    """Numbers one after the other, each part known by where it begins and ends."""

    def __init__(self) -> None:
        self._parts: list[Array] = []
        self._end = 0

    def part(self, values: Array) -> list[int]:
        flat = np.asarray(values, dtype=float).ravel()
        self._parts.append(flat)
        start, self._end = self._end, self._end + len(flat)
        return [start, self._end]

    def mesh(self, mesh: TriangleMesh) -> dict[str, Sequence[int]]:
        # Indices up to 2^24 are whole in single precision.
        return {"vertices": self.part(mesh.vertices), "faces": self.part(mesh.faces)}

    def all(self) -> Array:
        return np.concatenate(self._parts)


def _rows(X: Pose) -> Array:
    return np.hstack([X.translation, X.quaternion])
