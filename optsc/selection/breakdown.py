"""A ranking as a table: for every candidate its costs, its rank, and what removed it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from optsc.selection.ranking import Ranking


class CandidateRow(NamedTuple):
    """One candidate of a ranking.

    Attributes:
        object_name: which object.
        candidate: index into the candidates.
        grasp_index: index into the object's grasp set.
        rank: place among the admissible grasps of its object, 1 for the chosen; None where a filter removed it.
        removed_by: the filter's reason or the stage that left it behind; "" for the chosen.
        half_turn: whether the jaws' half-turned twin is meant.
        costs: every cost of the rule, and what decides in the end, by "name [unit]".
    """

    object_name: str
    candidate: int
    grasp_index: int
    rank: int | None
    removed_by: str
    half_turn: bool
    costs: Mapping[str, float]


def rows(ranking: Ranking) -> tuple[CandidateRow, ...]:
    """Return every candidate: object by object, the best first, those that a filter removed at the end."""
    if not ranking.chosen:
        return ()
    grid = ranking.view.situation.grid
    candidates, turned = grid.table.candidates, ranking.view.situation.turned
    half_turns = None if turned is None else grid.layout.gather(turned)
    terms = {
        f"{c.name} [{c.unit}]": ranking.cost_of(c) for c in (*ranking.rule.costs, ranking.rule.deciding_cost)
    }
    removed = ranking.rejected_by
    result = []
    for k, name in enumerate(ranking.object_names):
        best_first = [int(i) for i in ranking.of(name)]
        known = set(best_first)
        others = [int(i) for i in grid.layout.index[k] if i >= 0 and int(i) not in known]
        for place, i in enumerate([*best_first, *others]):
            result.append(
                CandidateRow(
                    object_name=name,
                    candidate=i,
                    grasp_index=int(candidates.grasp_index[i]),
                    rank=place + 1 if place < len(best_first) else None,
                    removed_by=str(removed[i]),
                    half_turn=half_turns is not None and bool(half_turns[i]),
                    costs={term: float(values[i]) for term, values in terms.items()},
                )
            )
    return tuple(result)


def text(ranking: Ranking, limit: int | None = None) -> str:
    """Return the rows as text in columns, at most ``limit`` of each object."""
    entries = rows(ranking)
    if not entries:
        return f"No ranking: {ranking.reason}."
    names = tuple(entries[0].costs)
    lines = [("object", "rank", "grasp", *names, "removed by")]
    shown: dict[str, int] = {}
    for row in entries:
        shown[row.object_name] = shown.get(row.object_name, 0) + 1
        if limit is not None and shown[row.object_name] > limit:
            continue
        grasp = f"{row.grasp_index}{' turned' if row.half_turn else ''}"
        rank = "-" if row.rank is None else str(row.rank)
        costs = (f"{row.costs[name]:.4g}" for name in names)
        lines.append((row.object_name, rank, grasp, *costs, row.removed_by or "chosen"))
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )
