"""Three objects in a row: grasped, carried and put down again by a person with nothing but a hand and a trigger."""

import optsc
from optsc.people import Intention, Simulated
from optsc.study.episode_setup import controller_with, true_scene
from optsc.study.observed_objects import ObservedObjects

robot = optsc.load_robot("panda")
world = optsc.sim.tabletop(robot, objects=("can", "box", "mug"), seed=1)
meshes = {name: model.mesh for name, model in world.objects.items()}
library = optsc.build_library(meshes, robot.gripper, seed=0)
scene = true_scene(world, library)
controller = controller_with(optsc.GraspSelector(robot), optsc.Approach())


def show(tick):
    """Print what happens, and what the jaws are measured to hold."""
    step = tick.step
    if step.event is not None:
        held = "nothing" if step.held is None else f"the {step.held.object_name}, {1e3 * step.held.opening:.0f} mm"
        print(f"{step.time:5.1f} s  {step.mode.value:8}  {step.event.value}; held: {held}")


with optsc.PyBulletFollower(world) as follower:
    optsc.run(
        controller,
        operator=Simulated(1, [Intention(name, put_down=True) for name in world.objects]),
        follower=follower,
        candidates=scene.candidates,
        clear=scene.clear,
        watch=ObservedObjects(world, library, follower),
        rate=250.0,
        duration=120.0,
        tasks=3,
        on_tick=show,
        keep=False,
    )
print(f"{controller.state.tasks} objects carried")
