"""What the weights of the choice do: forty settings in three scenes, and those that none beats.

Rows are kept in a folder: run it again and nothing is computed anew.
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
settled = sweep.setting_results(rows)  # each setting by its means over the scenes

print(f"{'setting':>8} {'orient.':>8} {'position':>8} {'manip.':>8} {'travel':>8} {'path [m]':>9} {'M':>7}")
for setting in sorted(settled, key=lambda s: s.row["path_length_m"]):
    row = setting.row
    if setting.best or row["condition"] == "paper":
        weights = "".join(f" {row.get(f'at_{d.name}', '-'):>8.4}" for d in dimensions)
        print(f"{row['condition']:>8}{weights} {row['path_length_m']:9.3f} {row['target_yoshikawa']:7.4f}")
best = sum(setting.best for setting in settled)
print(f"{best} of {len(settled)} settings are on the front of path and manipulability")
