"""``optsc sweep``: many settings of the selection over many scenes."""

from __future__ import annotations

import argparse
from typing import Any

from optsc.cli.cases import add_case_options, cases_of, compute, executor_of
from optsc.cli.options import checked_seed, command_line
from optsc.cli.progress import shown_progress

DEFAULT_VARIED = (
    "weight.orientation=0:1",
    "weight.position=0:1",
    "weight.manipulability=0:1",
    "weight.joint-travel=0:1",
)


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "sweep",
        help="vary the weights of the selection over many scenes",
        description="Tries every setting of a design in every scene. Geometry is computed once per scene, and a grasp "
        "is executed once however many settings choose it. Finished rows are kept in DIR/rows and skipped when the "
        "same command is started again. What can be varied: weight.COST, keep.orientation, keep.position, keep.pose, "
        "dof.x to dof.rz, dof.length, measure.",
        epilog="example: optsc sweep --design sobol --count 1000 --scenes 50 --vary weight.orientation=0:1 "
        "weight.position=0:1 weight.manipulability=0:1 measure=yoshikawa,simox --seed 1 --output sweep-output",
    )
    parser.add_argument("--design", default="sobol", help="grid, random, sobol, simplex or one-at-a-time")
    parser.add_argument("--count", type=int, default=1000, help="points of random and sobol (default 1000)")
    parser.add_argument(
        "--levels", type=int, default=5, help="values per dimension of the others (default 5)"
    )
    parser.add_argument(
        "--vary",
        nargs="+",
        default=list(DEFAULT_VARIED),
        metavar="NAME=RANGE",
        help="name=low:high, name=low:high:log, name=low:high:integer or name=a,b,c",
    )
    parser.add_argument(
        "--base", nargs="+", default=[], metavar="NAME=VALUE", help="where one-at-a-time starts"
    )
    parser.add_argument(
        "--stability", type=int, default=10, metavar="N", help="cases for rankings (default 10)"
    )
    parser.add_argument("--tune", action="store_true", help="search with Optuna instead of a design")
    add_case_options(parser, robots=["panda"], scenes=50, output="sweep-output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the sweep and write tables, summary and report."""
    from optsc.study.conditions import MANIPULABILITY_ONLY, PAPER
    from optsc.study.sweep.space import Dimension, conditions, design

    checked_seed(options)
    dimensions = [Dimension.parse(text) for text in options.vary]
    if options.tune:
        return _tune(options, dimensions)
    points = design(
        options.design,
        dimensions,
        count=options.count,
        levels=options.levels,
        seed=options.seed,
        base=_base(options, dimensions),
    )
    varied = conditions(points)
    references = [PAPER, MANIPULABILITY_ONLY]
    cases = cases_of(options)
    print(f"{len(varied)} settings, {len(cases.pairs())} cases", flush=True)
    rows = compute(options, cases.jobs([*varied, *references]))
    return _report(options, cases, rows, varied, references)


def _base(options: argparse.Namespace, dimensions: Any) -> Any:
    """Return the point that one-at-a-time starts from: the middle of each range, but for what was given."""
    from optsc.study.sweep.space import Dimension

    given = [Dimension.parse(text) for text in options.base]
    middle = {dimension.name: dimension.at(0.5) for dimension in dimensions}
    return {**middle, **{d.name: d.values[0] if d.values else d.low for d in given}}


def _report(options: argparse.Namespace, cases: Any, rows: Any, varied: Any, references: Any) -> int:
    from optsc.study.output import save_rows, save_summary
    from optsc.study.stability import stability
    from optsc.study.sweep.report import build, rows_of
    from optsc.study.sweep.results import settle

    names = {condition.name for condition in references}
    settled = settle([row for row in rows if row["condition"] not in names])
    compared = settle([row for row in rows if row["condition"] in names])
    save_rows(rows, options.output)
    save_rows(rows_of([*compared, *settled]), options.output, "settings")
    middle = varied[len(varied) // 2 : len(varied) // 2 + 1]
    pairs = cases.pairs()[: options.stability]
    stabilities = (
        stability(pairs, [references[0], *middle], settings=cases.settings, seed=options.seed)
        if pairs
        else []
    )
    page = build(settled, compared, stabilities, command_line()).save(options.output)
    best = [s.row for s in settled if s.best]
    facts = {
        "command": command_line(),
        "seed": options.seed,
        "settings": len(varied),
        "cases": len(cases.pairs()),
    }
    save_summary(
        {
            **facts,
            "rows": len(rows),
            "front": best,
            "references": [s.row for s in compared],
            "stability": [s._asdict() for s in stabilities],
        },
        options.output,
    )
    print(f"{len(rows)} rows, {len(best)} settings on the Pareto front\nreport: {page}")
    return 0


def _tune(options: argparse.Namespace, dimensions: Any) -> int:
    from optsc.study.output import save_rows, save_summary
    from optsc.study.sweep.store import RowStore
    from optsc.study.sweep.tuning import tune

    with executor_of(options) as executor:
        trials = tune(
            cases_of(options),
            dimensions,
            RowStore(options.output / "rows"),
            trials=options.count,
            seed=options.seed,
            executor=executor,
            workers=options.workers,
            on_progress=shown_progress(),
        )
    rows = [{"trial": t.number, **t.point, **t.values, "arrived": t.arrived, "best": t.best} for t in trials]
    save_rows(rows, options.output, "trials")
    best = [row for row in rows if row["best"]]
    facts = {"command": command_line(), "seed": options.seed, "trials": len(rows), "best": best}
    save_summary(facts, options.output)
    for row in best:
        print(", ".join(f"{name} {value:.4g}" for name, value in row.items() if isinstance(value, float)))
    print(
        f"{len(best)} of {len(rows)} trials are on the Pareto front; all of them: {options.output / 'trials.csv'}"
    )
    return 0
