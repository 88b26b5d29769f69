"""A scene that the controller knows nothing about: a depth image in, grasps out; then the can is moved."""

import sys
from pathlib import Path

import numpy as np

import optsc
from optsc.geometry import Pose
from optsc.perception import SceneObserver, SceneState, catalogue_templates
from optsc.sim.camera import DepthCamera
from optsc.viewers.drawing import save_figure
from optsc.viewers.figure_scene_state import scene_state_figure

robot = optsc.load_robot("panda")
world = optsc.sim.tabletop(robot, objects=("mug", "can", "box"), seed=1)
observer = SceneObserver(robot, catalogue_templates(("mug", "can", "box")))
rng = np.random.default_rng(0)


def report(events):
    for event in events:
        print(f"  {event.name}: {event.kind.value} ({event.words})")


with DepthCamera(world) as camera:
    # All that the observer gets: a depth image, and the arm's measured configuration.
    first = camera.capture(robot.home, rng=rng).image
    state, events = observer.observe(SceneState(), first, robot.home)
    print("the first image:")
    report(events)

    moved = {"can": Pose.from_translation([-0.04, 0.03, 0.0]) @ world.X_WO["can"]}
    image = camera.capture(robot.home, X_WO=moved, rng=rng, stamp=0.5).image
    after, events = observer.observe(state, image, robot.home)
    print("after the can was moved:")
    report(events)
    print(f"  its grasps are the very same set: {after.library['can'] is state.library['can']}")

# What a controller gets is candidates, as from any other source of grasps.
selector = optsc.GraspSelector(robot)
ranking = selector.rank(robot.forward(robot.home), robot.home, after.place())
print(f"the best of {len(after.place())} grasps is one of the {ranking.best}")

path = Path(sys.argv[1] if len(sys.argv) > 1 else "seen.png")
save_figure(scene_state_figure(state, first), path)
print(f"picture: {path}")
