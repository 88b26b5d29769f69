"""The whole loop: an operator's hand, the grasps of a scene, the controller and a simulated arm."""

import optsc

robot = optsc.load_robot("panda")
world = optsc.sim.tabletop(robot, objects=("bottle", "can"), seed=1)
meshes = {name: model.mesh for name, model in world.objects.items()}
library = optsc.build_library(meshes, robot.gripper, seed=0)

selector = optsc.GraspSelector(robot, rule=optsc.Cascade.paper())
hand = optsc.ClutchSettings(R_WS=optsc.people.R_WS_DEFAULT)
controller = optsc.SharedController(robot, selector, approach=optsc.Approach(speed=0.1), clutch=hand)

with optsc.PyBulletFollower(world) as follower:
    run = optsc.run(
        controller,
        operator=optsc.people.Simulated(seed=1),
        follower=follower,
        candidates=library.place(world.X_WO),
        rate=500.0,
    )
    heights = {name: follower.height(name) for name in world.objects}

modes = [run.modes[0], *(run.modes[i] for i in run.switches())]
print(" → ".join(mode.value for mode in modes))
print({name: f"{height:.2f} m" for name, height in heights.items()})
