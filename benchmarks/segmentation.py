"""How well objects of cluttered tables are segmented from depth alone, and what every step costs.

    python -m benchmarks.segmentation --scenes 50 --output results --picture docs/images/perception.png

Scenes have three to five objects, upright and lying, brought to rest by physics close together, with the arm above
them. The simulator's labels judge: for every object that the camera measured at least 300 pixels of, the best overlap
of one segment with them, as intersection over union. What is in one segment with another object counts for both.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from benchmarks.machine import markdown_table, save
from optsc.geometry import PinholeCamera
from optsc.perception import robot_depth, robot_mask, segment_image
from optsc.perception.segments import Segment
from optsc.robot import load_robot
from optsc.sim.camera import CameraView, DepthCamera
from optsc.sim.clutter import ClutteredScene, cluttered_tabletop

ENOUGH = 300
"""Pixels of an object that count as seen, in an image of 640 x 480."""
FIRST_SEED = 1000
Result = TypeVar("Result")


class Found(NamedTuple):
    """How one object was found: its name, how it lay, its pixels, and the best overlap of a segment with them."""

    name: str
    lying: bool
    pixels: int
    overlap: float


class ObservedScene(NamedTuple):
    """One scene as the camera observed it."""

    view: CameraView
    arm: np.ndarray
    predicted: np.ndarray
    segments: tuple[Segment, ...]


class Clock:
    """Collects the processor time of each step [ms], which other work on the machine disturbs least."""

    def __init__(self) -> None:
        self.steps: dict[str, list[float]] = {}

    def timed(self, name: str, work: Callable[[], Result]) -> Result:
        start = time.process_time()
        result = work()
        self.steps.setdefault(name, []).append(1e3 * (time.process_time() - start))
        return result


def observed(scene: ClutteredScene, camera: PinholeCamera, seed: int, clock: Clock) -> ObservedScene:
    """Return what is seen of a scene, each step timed."""
    robot, q = scene.world.robot, scene.q
    with DepthCamera(scene.world, camera=camera) as depth_camera:
        rng = np.random.default_rng(seed)
        view = clock.timed("rendering and noise", lambda: depth_camera.capture(q, rng=rng))
    image = view.image
    predicted = clock.timed("the arm's depth", lambda: robot_depth(robot, q, image.camera, image.X_WC))
    arm = clock.timed("the arm's pixels", lambda: robot_mask(robot, q, image))
    segments = clock.timed("segmentation", lambda: segment_image(image, robot_mask=arm).segments)
    return ObservedScene(view, arm, predicted, segments)


def judged(scene: ClutteredScene, seen: ObservedScene) -> list[Found]:
    """Return how each object was found that enough was seen of."""
    found = []
    enough = ENOUGH * seen.view.labels.size / (640 * 480)
    for name in scene.world.objects:
        truth = seen.view.pixels_of(name) & seen.view.image.measured
        if truth.sum() < enough:
            continue
        overlaps = [(s.pixels & truth).sum() / (s.pixels | truth).sum() for s in seen.segments]
        found.append(Found(name, name in scene.lying, int(truth.sum()), float(max(overlaps, default=0.0))))
    return found


def row(name: str, found: list[Found]) -> list[str]:
    """Return a row of the table of overlaps."""
    overlap = np.array([f.overlap for f in found])
    if len(overlap) == 0:
        return [name, "0", "", "", "", ""]
    shares = [f"{100.0 * (overlap > limit).mean():.0f} %" for limit in (0.5, 0.75)]
    return [name, str(len(overlap)), f"{overlap.mean():.3f}", f"{np.median(overlap):.3f}", *shares]


def report(found: list[Found], clocks: dict[str, Clock]) -> str:
    """Return both tables."""
    names = sorted({f.name for f in found})
    groups = {
        "all": found,
        "upright": [f for f in found if not f.lying],
        "lying": [f for f in found if f.lying],
        **{name: [f for f in found if f.name == name] for name in names},
    }
    header = ["objects", "number", "mean overlap", "median", "above 0.5", "above 0.75"]
    text = markdown_table(header, [row(name, group) for name, group in groups.items()])
    steps = next(iter(clocks.values())).steps
    lines = [[s, *(f"{np.median(clock.steps[s]):.1f}" for clock in clocks.values())] for s in steps]
    return f"{text}\n\n{markdown_table(['processor time [ms]', *clocks], lines)}"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=50)
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--width", type=int, nargs="+", default=[640, 320], help="of the images; the first is judged")
    parser.add_argument("--output", type=Path)
    parser.add_argument("--picture", type=Path, help="where to write a picture of one scene")
    parser.add_argument("--pictured", type=int, default=1042, help="its seed")
    options = parser.parse_args(arguments)
    robot, found = load_robot(options.robot), []
    cameras = {
        f"{width} x {3 * width // 4}": PinholeCamera.from_field_of_view(width, 3 * width // 4, 0.75)
        for width in options.width
    }
    clocks = {name: Clock() for name in cameras}
    overlaps: dict[str, list[Found]] = {name: [] for name in cameras}
    for seed in range(FIRST_SEED, FIRST_SEED + options.scenes):
        scene = cluttered_tabletop(robot, seed)
        for name, camera in cameras.items():
            seen = observed(scene, camera, seed, clocks[name])
            overlaps[name] += judged(scene, seen)
    first = next(iter(cameras))
    found = overlaps[first]
    text = f"{options.scenes} scenes, judged at {first} pixels.\n\n{report(found, clocks)}"
    for name in list(cameras)[1:]:
        text += f"\n\nAt {name} pixels the mean overlap is {np.mean([f.overlap for f in overlaps[name]]):.3f}."
    facts: dict[str, Any] = {
        "found": {name: [f._asdict() for f in rows] for name, rows in overlaps.items()},
        "milliseconds": {name: clock.steps for name, clock in clocks.items()},
    }
    given = " ".join(arguments if arguments is not None else sys.argv[1:])
    save(options.output, "segmentation", facts, text, f"python -m benchmarks.segmentation {given}")
    if options.picture is not None:
        from benchmarks.segmentation_picture import save_segmentation_figure

        scene = cluttered_tabletop(robot, options.pictured)
        seen = observed(scene, cameras[first], options.pictured, Clock())
        save_segmentation_figure(options.picture, seen.view, seen.segments, seen.arm, seen.predicted)
    return 0


if __name__ == "__main__":
    sys.exit(main())
