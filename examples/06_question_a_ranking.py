"""Ask a ranking why: the best grasps as a table, one candidate in words, all of them as a picture; then veto one."""

import sys
from pathlib import Path

import optsc
from optsc.selection import Hysteresis
from optsc.viewers.drawing import save_figure
from optsc.viewers.figure_ranking import ranking_figure

robot = optsc.load_robot("panda")
world = optsc.sim.tabletop(robot, objects=("mug", "can", "box"), seed=0)
meshes = {name: model.mesh for name, model in world.objects.items()}
library = optsc.build_library(meshes, robot.gripper, seed=0)

# With hysteresis the choice rests while the hand trembles.
selector = optsc.GraspSelector(robot, hysteresis=Hysteresis())
ranking = selector.rank(robot.forward(robot.home), robot.home, library.place(world.X_WO))
print(ranking.table(limit=3))

rows = [row for row in ranking.rows() if row.object_name == ranking.best]
print()
print(ranking.explain(rows[10].candidate))  # why not that one?

chosen = ranking.target()
selector.veto(chosen.object_name, chosen.grasp_index)
again = selector.rank(robot.forward(robot.home), robot.home)
print()
print(f"after a veto of grasp {chosen.grasp_index}: grasp {again.target(chosen.object_name).grasp_index}")

path = Path(sys.argv[1] if len(sys.argv) > 1 else "ranking.png")
save_figure(ranking_figure(ranking), path)
print(f"picture: {path}")
