"""``optsc sweep``: many settings of the selection over many scenes, by a design or by a search."""

from __future__ import annotations

import argparse
import shutil
import textwrap
from typing import Any

from optsc.cli.cases import add_case_options, cases_of, compute, computing, kept_rows
from optsc.cli.options import command_line
from optsc.errors import InvalidValue

DEFAULT_VARIED = (
    "weight.orientation=0:1",
    "weight.position=0:1",
    "weight.manipulability=0:1",
    "weight.joint-travel=0:1",
)
DEFAULTS = {"count": 1000, "levels": 5, "base": (), "objectives": ()}
"""Of options that only some designs use; None on the command line tells that they were not given."""
USED_BY = {
    "grid": ("levels",),
    "random": ("count",),
    "sobol": ("count",),
    "simplex": ("levels",),
    "one-at-a-time": ("levels", "base"),
    "--tune": ("count", "objectives"),
}
"""Which of them each design uses."""


class _Help(argparse.Action):
    """Print the help with the names that options can have; what they are is loaded only now."""

    def __call__(self, parser: Any, *_: Any) -> None:
        width = shutil.get_terminal_size().columns - 2
        shape: Any = {"width": width, "subsequent_indent": "  ", "break_on_hyphens": False}
        lines = [textwrap.fill(f"{of}: {', '.join(names)}", **shape) for of, names in _names()]
        parser.description = textwrap.fill(parser.description, width)
        parser.epilog = "\n".join([*lines, "", textwrap.fill(parser.epilog, width)])
        parser.print_help()
        parser.exit()


def _names() -> list[tuple[str, list[str]]]:
    from optsc.people.parameters import TYPES
    from optsc.robot import ROBOT_NAMES
    from optsc.robot.manipulability import DEFINITIONS
    from optsc.study.scenes import LEVELS
    from optsc.study.sweep.designs import DESIGNS
    from optsc.study.sweep.results import MEANS
    from optsc.study.sweep.space import COSTS

    return [
        ("designs", list(DESIGNS)),
        ("costs, as in weight.COST", sorted(COSTS)),
        ("definitions of M, as in measure=A,B", list(DEFINITIONS)),
        ("objectives", list(MEANS)),
        ("people", [name for name, kind in TYPES.items() if kind.changes_mind_after is None]),
        ("levels", list(LEVELS)),
        ("arms", list(ROBOT_NAMES)),
    ]


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "sweep",
        add_help=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        help="vary the weights of the selection over many scenes",
        description="Tries every setting of a design in every scene. Geometry is computed once per scene, and a grasp "
        "is executed once however many settings choose it. Finished rows are kept in DIR/rows and skipped when the "
        "same command is started again. What can be varied: weight.COST, keep.orientation, keep.position, keep.pose, "
        "dof.x to dof.rz, dof.length, measure.",
        epilog="example: optsc sweep --design sobol --count 1000 --scenes 50 --vary weight.orientation=0:1 "
        "weight.position=0:1 weight.manipulability=0:1 measure=yoshikawa,simox --seed 1 --output sweep-output",
    )
    parser.add_argument("-h", "--help", action=_Help, nargs=0, help="show this help, with all names, and exit")
    parser.add_argument("--design", help="grid, random, sobol (default), simplex or one-at-a-time")
    parser.add_argument("--tune", action="store_true", help="search with Optuna instead of a design")
    parser.add_argument("--count", type=int, help="points of random, sobol and --tune (default 1000)")
    parser.add_argument("--levels", type=int, help="values per dimension of the others (default 5)")
    parser.add_argument(
        "--vary",
        nargs="+",
        default=list(DEFAULT_VARIED),
        metavar="NAME=RANGE",
        help="name=low:high, name=low:high:log, name=low:high:integer or name=a,b,c",
    )
    parser.add_argument("--base", nargs="+", metavar="NAME=VALUE", help="where one-at-a-time starts")
    parser.add_argument(
        "--objectives",
        nargs="+",
        metavar="NAME=DIRECTION",
        help="what --tune searches for, minimize or maximize (default path_length_m=minimize "
        "target_yoshikawa=maximize)",
    )
    parser.add_argument(
        "--stability", type=int, default=10, metavar="N", help="cases for rankings (default 10; 0: none)"
    )
    add_case_options(parser, robots=["panda"], scenes=50, output="sweep-output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the sweep and write tables, summary and report."""
    from optsc.study.conditions import MANIPULABILITY_ONLY, PAPER
    from optsc.study.sweep.designs import design
    from optsc.study.sweep.report import save_report
    from optsc.study.sweep.space import Dimension, conditions

    _check(options)
    dimensions = [Dimension.parse(text) for text in options.vary]
    cases, objectives = cases_of(options), _objectives(options)
    with kept_rows(options):
        if options.tune:
            points = _searched(options, cases, dimensions, objectives)
        else:
            named = {name: getattr(options, name) for name in ("count", "levels", "seed")}
            points = design(options.design, dimensions, base=_base(options, dimensions), **named)
        varied = conditions(points)
        print(f"{len(varied)} settings, {len(cases.pairs())} cases", flush=True)
        jobs = cases.jobs([*varied, PAPER, MANIPULABILITY_ONLY])
        rows = compute(options, jobs)
        page, best = save_report(
            rows,
            jobs,
            objectives,
            options.output,
            command_line(),
            searched=bool(options.objectives),
            stability_cases=options.stability,
            seed=options.seed,
        )
        print(f"{len(rows)} rows, {best} settings on the Pareto front\nreport: {page}")
        return 0


def _check(options: argparse.Namespace) -> None:
    """Put defaults in; raise where an option has a value it cannot have, or would not be used."""
    from optsc.errors import UnknownName

    if options.tune and options.design is not None:
        raise InvalidValue("--design", options.design, "left out with --tune, which proposes its own points")
    options.design = options.design or "sobol"
    mode = "--tune" if options.tune else options.design
    if mode not in USED_BY:
        raise UnknownName("design", mode, [name for name in USED_BY if name != "--tune"])
    for name, default in DEFAULTS.items():
        if getattr(options, name) is None:
            setattr(options, name, default)
        elif name not in USED_BY[mode]:
            others = ", ".join(other for other, names in USED_BY.items() if name in names)
            raise InvalidValue(f"--{name} with {mode}", getattr(options, name), f"only with {others}")
    lowest = {"count": 1, "levels": 1 if mode == "simplex" else 2, "stability": 0}
    for name, least in lowest.items():
        if getattr(options, name) < least:
            raise InvalidValue(f"--{name}", getattr(options, name), f"{least} or more")
    if options.workers is not None and options.workers < 0:
        raise InvalidValue("--workers", options.workers, "0 or more")


def _objectives(options: argparse.Namespace) -> dict[str, str]:
    from optsc.study.sweep.results import trade_off_of
    from optsc.study.sweep.tuning import OBJECTIVES

    if not options.objectives:
        return dict(OBJECTIVES)
    pairs = [text.partition("=")[::2] for text in options.objectives]
    if len(dict(pairs)) < max(2, len(pairs)):
        raise InvalidValue("--objectives", " ".join(options.objectives), "two measures or more, each once")
    trade_off_of(dict(pairs))
    return dict(pairs)


def _base(options: argparse.Namespace, dimensions: Any) -> Any:
    """Return the point that one-at-a-time starts from: the middle of each range, but for what was given."""
    from optsc.study.sweep.space import Dimension

    point = {dimension.name: dimension.at(0.5) for dimension in dimensions}
    for text in options.base:
        given = Dimension.parse(text)
        if len(given.values) != 1:
            raise InvalidValue("--base", text, "one value, as in weight.pose=0.5")
        point[given.name] = given.values[0]
    return point


def _searched(options: argparse.Namespace, cases: Any, dimensions: Any, objectives: dict[str, str]) -> Any:
    """Return the points that a search tried, in its order; what became of them is in the store."""
    from optsc.study.results_folder import save_rows
    from optsc.study.sweep.store import RowStore
    from optsc.study.sweep.tuning import tune

    with computing(options) as where:
        trials = tune(
            cases,
            dimensions,
            RowStore(options.output / "rows"),
            trials=options.count,
            seed=options.seed,
            objectives=objectives,
            **where,
        )
    rows = [{"trial": t.number, **t.point, **t.values, "success": t.success, "best": t.best} for t in trials]
    save_rows(rows, options.output, "trials")
    return [trial.point for trial in trials]
