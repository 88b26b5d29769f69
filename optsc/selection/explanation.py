"""Explanation of a decision: every candidate as a row of a table, and in words what was chosen and why."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from optsc.selection.decision import Decision


class CandidateRow(NamedTuple):
    """One candidate of a ranking.

    Attributes:
        object_name: which object.
        candidate: index into the candidates.
        grasp_index: index into the object's grasp set.
        rank: place among the admissible grasps of its object, 1 for the chosen; None where a filter removed it.
        removed_by: the filter's reason or the stage that left it behind; "" for the chosen.
        half_turn: whether it stands for the jaws' half-turned twin.
        costs: every cost of the rule, and what decides in the end, by "name [unit]".
    """

    object_name: str
    candidate: int
    grasp_index: int
    rank: int | None
    removed_by: str
    half_turn: bool
    costs: Mapping[str, float]


def rows(decision: Decision) -> tuple[CandidateRow, ...]:
    """Return every candidate: object by object, the best first, those that a filter removed at the end."""
    layout, rule, turned = decision.layout, decision.rule, decision.situation.turned
    half_turns = np.zeros(len(layout.place), dtype=bool) if turned is None else layout.gather(turned)
    terms = {f"{c.name} [{c.unit}]": decision.cost_of(c) for c in (*rule.costs, rule.deciding_cost)}
    removed = decision.rejected_by()
    result = []
    for k, name in enumerate(layout.names):
        best_first = decision.order(k).tolist()
        known = set(best_first)
        others = [i for i in layout.index[k].tolist() if i >= 0 and i not in known]
        for place, i in enumerate([*best_first, *others], start=1):
            result.append(
                CandidateRow(
                    object_name=name,
                    candidate=i,
                    grasp_index=int(decision.candidates.grasp_index[i]),
                    rank=place if place <= len(best_first) else None,
                    removed_by=str(removed[i]),
                    half_turn=bool(half_turns[i]),
                    costs={term: float(values[i]) for term, values in terms.items()},
                )
            )
    return tuple(result)


def table(entries: tuple[CandidateRow, ...], limit: int | None = None) -> str:
    """Return one row or more as text in columns, at most ``limit`` of each object."""
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
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines
    )


def of_object(decision: Decision, k: int) -> str:
    """Return what was chosen for object ``k``, how many each filter and stage left, and the next best."""
    name = decision.layout.names[k]
    present = decision.layout.index[k] >= 0
    numbers = np.bincount(decision.rejected[k, present], minlength=len(decision.reasons))
    rejections = ", ".join(f"{n} {decision.reasons[r]}" for r, n in enumerate(numbers) if n and r)
    total = int(np.count_nonzero(present))
    count = f"{total} candidate{'' if total == 1 else 's'}"
    order = decision.order(k).tolist()
    if not order:
        return f"{name}: no grasp. {count}, {f'all rejected: {rejections}' if total else 'it has none stored'}."
    turn = ", turned by half a turn" if decision.half_turn(order[0]) else ""
    lines = [
        f"{name}: {_grasp(decision, order[0])}{turn}. {_sentence(decision, order[0])}",
        f"  {count}{f', {rejections}' if rejections else ''}; admissible {_stages(decision, k)}.",
    ]
    if len(order) > 1:
        lines.append(f"  Next best: {_grasp(decision, order[1])} ({_costs(decision, order[1])}).")
    return "\n".join(lines)


def of_candidate(decision: Decision, i: int) -> str:
    """Return why candidate ``i`` is or is not the chosen grasp of its object."""
    reason, costs = str(decision.rejected_by()[i]), _sentence(decision, i)
    layout, rule, selection = decision.layout, decision.rule, decision.selection
    k, column = divmod(int(layout.place[i]), layout.index.shape[1])
    head = f"{layout.names[k]} {_grasp(decision, i)}"
    if not reason:
        return f"{head}: chosen. {costs}"
    stage = int(selection.left_at()[k, column])
    if stage < 0:
        return f"{head}: rejected, {reason}. {costs}"
    kept = int(selection.survivors[stage + 1][k].sum())
    columns = selection.entering(k, stage)
    place = int(np.flatnonzero(columns == column)[0]) + 1
    cost = rule.costs[stage] if len(rule.stages) > 1 else rule.deciding_cost
    limit = cost.describe(float(decision.cost_of(cost)[layout.index[k, columns[kept - 1]]]))
    return (
        f"{head}: left behind at the {rule.stages[stage]}, place {place} of {len(columns)} "
        f"({kept} kept, the last with {limit}). {costs}"
    )


def _grasp(decision: Decision, i: int) -> str:
    return f"grasp {int(decision.candidates.grasp_index[i])}"


def _costs(decision: Decision, i: int) -> str:
    costs = dict.fromkeys((*decision.rule.costs, decision.rule.deciding_cost))
    return ", ".join(cost.describe(float(decision.cost_of(cost)[i])) for cost in costs)


def _sentence(decision: Decision, i: int) -> str:
    text = _costs(decision, i)
    return f"{text[:1].upper()}{text[1:]}."


def _stages(decision: Decision, k: int) -> str:
    numbers = [int(mask[k].sum()) for mask in decision.selection.survivors]
    after = (f" -> {n} ({stage})" for n, stage in zip(numbers[1:], decision.rule.stages, strict=True))
    return f"{numbers[0]}{''.join(after)}"
