"""The paper's selection, and what another rule would have chosen, with reasons."""

import optsc
from optsc.selection import ManipulabilityLoss, PoseDistance

robot = optsc.load_robot("panda")
can = optsc.sim.object_model("can")
library = optsc.build_library({"can": can.mesh}, robot.gripper, seed=0)
candidates = library.place({"can": optsc.Pose.from_translation([0.5, 0.1, 0.0])})
hand = robot.forward(robot.home)

rules = {
    "the paper": optsc.Cascade.paper(),
    "manipulability only": optsc.Cascade.manipulability_only(),
    # Distance along the approach axis and roll about it count little: the paper's future work.
    "weights per degree of freedom": optsc.WeightedSum(
        ((PoseDistance(position=(1.0, 1.0, 0.2), rotation=(1.0, 1.0, 0.3)), 1.0), (ManipulabilityLoss(), 0.5))
    ),
}
for name, rule in rules.items():
    ranking = optsc.GraspSelector(robot, rule).rank(hand, robot.home, candidates)
    target = ranking.target("can")
    print(f"{name}: grasp {target.grasp_index}, M = {target.manipulability:.4f}")
print()
print(ranking.explain())
