"""What the weights of the choice do: forty settings in three scenes, and those that none beats.

Rows are kept in a folder: run it again and nothing is computed again.
"""

import sys
from pathlib import Path

import optsc
from optsc.study import Cases, sweep

dimensions = [
    sweep.Dimension("weight.orientation"),
    sweep.Dimension("weight.position"),
    sweep.Dimension("weight.manipulability"),
    sweep.Dimension("weight.joint-travel"),
]
points = sweep.design("sobol", dimensions, count=40, levels=5, seed=1)  # levels are for the other designs
cases = Cases(robots=("panda",), scenes=3, seed=1)
jobs = cases.jobs([*sweep.conditions(points), optsc.study.PAPER])

store = sweep.RowStore(Path(sys.argv[1] if len(sys.argv) > 1 else "sweep-rows"))
# One process is enough for three scenes; leave `workers` out and there is one for each core.
rows = sweep.run_jobs(jobs, store, workers=0)
settings = sweep.setting_results(rows)  # each setting by its means over the scenes, as a pandas table

shown = settings[settings["best"] | (settings["condition"] == "paper")].sort_values("path_length_m")
columns = ["condition", *(f"at_{d.name}" for d in dimensions), "path_length_m", "target_yoshikawa"]
print(shown[columns].to_string(index=False, na_rep="-", float_format="{:.3f}".format))
print(f"{settings['best'].sum()} of {len(settings)} settings are on the front of path and manipulability")
