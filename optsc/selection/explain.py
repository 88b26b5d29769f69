"""A ranking in words and numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from optsc.selection.ranking import Ranking


def _name(ranking: Ranking, i: int) -> str:
    candidates = ranking.view.situation.grid.table.candidates
    return (
        f"{candidates.object_names[int(candidates.object_index[i])]} grasp {int(candidates.grasp_index[i])}"
    )


def _costs(ranking: Ranking, i: int) -> str:
    rule = ranking.rule
    costs = dict.fromkeys((*rule.costs, rule.deciding_cost))
    parts = [cost.describe(float(ranking.cost_of(cost)[i])) for cost in costs]
    return ", ".join(parts)


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def _rejections(ranking: Ranking, k: int) -> list[str]:
    view = ranking.view
    present = view.situation.grid.layout.index[k] >= 0
    numbers = np.bincount(view.rejected[k, present], minlength=len(view.reasons))
    return [f"{n} {view.reasons[r]}" for r, n in enumerate(numbers) if n and r]


def _stages(ranking: Ranking, k: int) -> str:
    view, rule = ranking.view, ranking.rule
    survivors = view.selection.survivors
    text = str(int(survivors[0][k].sum()))
    for name, mask in zip(rule.stages, survivors[1:], strict=True):
        text += f" -> {int(mask[k].sum())} ({name})"
    return text


def _object(ranking: Ranking, k: int, name: str) -> str:
    present = int(np.count_nonzero(ranking.view.situation.grid.layout.index[k] >= 0))
    rejections = ", ".join(_rejections(ranking, k))
    chosen = ranking.chosen[name]
    if chosen is None:
        why = f"all rejected: {rejections}" if present else "it has none stored"
        return f"{name}: no grasp. {_count(present, 'candidate')}, {why}."
    target = ranking.target(name)
    turn = ", turned by half a turn" if target is not None and target.half_turn else ""
    grasp = _name(ranking, chosen).removeprefix(f"{name} ")
    lines = [f"{name}: {grasp}{turn}. {_sentence(_costs(ranking, chosen))}"]
    lines.append(
        f"  {_count(present, 'candidate')}"
        + (f", {rejections}" if rejections else "")
        + f"; admissible {_stages(ranking, k)}."
    )
    order = ranking.of(name)
    if len(order) > 1:
        runner_up = int(order[1])
        grasp = _name(ranking, runner_up).removeprefix(f"{name} ")
        lines.append(f"  Next best: {grasp} ({_costs(ranking, runner_up)}).")
    return "\n".join(lines)


def ranking(ranked: Ranking) -> str:
    """Return what was chosen for every object, and how."""
    lines = [] if not ranked.reason else [f"Kept from an earlier call: {ranked.reason}."]
    if ranked.best is not None:
        lines.append(f"The hand points at: {ranked.best}.")
    lines += [_object(ranked, k, name) for k, name in enumerate(ranked.object_names)]
    if ranked.stale:
        lines.append("Some grasps are judged by where the arm stood a moment ago.")
    return "\n".join(lines)


def candidate(ranked: Ranking, i: int) -> str:
    """Return why candidate ``i`` is or is not the chosen grasp of its object."""
    reason = str(ranked.rejected_by[i])
    head = _name(ranked, i)
    if not reason:
        return f"{head}: chosen. {_sentence(_costs(ranked, i))}"
    view, rule = ranked.view, ranked.rule
    layout = view.situation.grid.layout
    k, column = divmod(int(layout.place[i]), layout.index.shape[1])
    stage = int(view.selection.left_at()[k, column])
    if stage < 0:
        return f"{head}: rejected, {reason}. {_sentence(_costs(ranked, i))}"
    entering, kept = view.selection.survivors[stage][k], view.selection.survivors[stage + 1][k]
    columns = view.selection._ordered(k, np.flatnonzero(entering), stage)
    place = int(np.flatnonzero(columns == column)[0]) + 1
    cost = rule.costs[stage] if len(rule.stages) > 1 else rule.deciding_cost
    last = int(layout.index[k, columns[int(kept.sum()) - 1]])
    limit = cost.describe(float(ranked.cost_of(cost)[last]))
    kept_text = f"{int(kept.sum())} kept, the last with {limit}"
    return (
        f"{head}: left behind at the {rule.stages[stage]}, place {place} of {int(entering.sum())} "
        f"({kept_text}). {_sentence(_costs(ranked, i))}"
    )
