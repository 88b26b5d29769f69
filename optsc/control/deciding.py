"""Decision in the making: which grasp the robot goes to, worked out from one moment, a little at every tick.

At the trigger the pose of the tool and the configuration of the arm are kept, and everything follows from them: the
ranking, the finalists that are solved again from there, and the look ahead along the paths. The hand goes on leading
meanwhile. Every piece of work is bounded by counts, never by time, so a replay decides the same.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from optsc.control.approach import Approach
from optsc.control.modes import Event
from optsc.control.path_feasibility import PathFeasibility
from optsc.control.path_search import PathSearch, SearchScene, advanced
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.grasps import Candidates
from optsc.robot import RobotModel
from optsc.selection import GraspSelector, Ranking, Target
from optsc.selection.reach import ClearRows

DECISION_TIME = 0.02
"""From the trigger to the decision at most [s]."""
PIECE_TIME = 0.002
"""A tick does one piece of work for each such time [s] in its period, or part of it."""
PIECES = round(DECISION_TIME / PIECE_TIME)
"""Pieces of work of a decision at most; the first is done at the tick of the trigger."""
SHORT = 0.004
"""Ticks no longer than this [s] leave it to the next one to act on a decision that they have brought to its end."""
CHOICES = 40
"""How many grasps are tried, best first, for one that the arm can go to on a straight path."""
ROUNDS_AGAIN = 4
"""Pieces of work on finalists that were solved from too far away, in a decision that must not take long ..."""
THOROUGH_ROUNDS = 32
"""... and in one that may."""
UNCHECKED = "there was no time to check the whole path to this grasp"


class Deciding(NamedTuple):
    """A decision in the making.

    Attributes:
        purpose: the event that a grasp found leads to.
        start, q: where the tool was led, and the configuration (n,) [rad], at the moment of the decision.
        candidates, clear: the grasps of the scene then, and their collision check.
        done: what was refused already, in words.
        best: the intended object, where that is known; else the ranking tells.
        instead_of: the grasp that another one is looked for.
        ranking: by which it is decided; None before it is made, and when it has to be made again.
        rounds: pieces of work on finalists that were solved from too far away.
        order: the grasps that are tried, best first.
        search: of a path to one of them; None before the ranking is settled.
        pieces: pieces of work done so far.
        spent: how many of them at this tick.
    """

    purpose: Event
    start: Pose
    q: Array
    candidates: Candidates
    clear: ClearRows | None
    done: str = ""
    best: str | None = None
    instead_of: Target | None = None
    ranking: Ranking | None = None
    rounds: int = 0
    order: tuple[int, ...] = ()
    search: PathSearch | None = None
    pieces: int = 0
    spent: int = 0

    def among(self, ranking: Ranking, order: tuple[int, ...]) -> Deciding:
        """Return the decision once it is known which grasps are tried."""
        return self._replace(ranking=ranking, order=order, search=PathSearch(self.start, self.q, order))

    def over(self, thorough: bool) -> bool:
        """Whether there is nothing left to do, or no time, where the decision need not be ``thorough``."""
        return (self.search is not None and self.search.over) or (not thorough and self.pieces >= PIECES)

    def chosen(self) -> tuple[Target | None, tuple[int, ...], str]:
        """Return the grasp, if there is any, those that come after it, best first, and what is to be said of it."""
        search, ranking = self.search, self.ranking
        if search is None or ranking is None:
            return None, (), ""
        taken, words = search.taken, ""
        if search.paths and search.best >= PathFeasibility.COLLIDING:
            # It is no worse than what there is, whatever it might touch.
            taken, words = search.paths[0].candidate, UNCHECKED
        if taken is None:
            return None, (), ""
        return ranking.target_of(taken), self.order[self.order.index(taken) + 1 :], words


def worked(
    deciding: Deciding, robot: RobotModel, approach: Approach, selector: GraspSelector, thorough: bool
) -> Deciding:
    """Return the decision after another piece of work."""
    deciding = deciding._replace(pieces=deciding.pieces + 1)
    search, ranking = deciding.search, deciding.ranking
    if ranking is None:
        return _ranked(deciding, selector, thorough)
    if search is None:
        selector.refresh_piece(deciding.q, ranking.best, finalists_only=True)
        rounds = deciding.rounds + 1
        goes_on = rounds < _rounds(thorough) and selector.is_outdated(ranking.best)
        return deciding._replace(rounds=rounds, ranking=ranking if goes_on else None)
    scene = SearchScene(robot, approach, deciding.candidates, deciding.clear, ranking.target_of)
    return deciding._replace(search=advanced(search, scene))


def _ranked(deciding: Deciding, selector: GraspSelector, thorough: bool) -> Deciding:
    if not deciding.rounds:
        selector.decides_from(deciding.q)
    ranking = selector.rank(deciding.start, deciding.q, refresh_limit=0)
    if deciding.best is not None and ranking.chosen.get(deciding.best) is not None:
        ranking = replace(ranking, best=deciding.best)
    best, other = ranking.best, deciding.instead_of
    if best is not None and deciding.rounds < _rounds(thorough) and selector.is_outdated(best):
        return deciding._replace(ranking=ranking)
    if best is None or (other is not None and best != other.object_name):
        return deciding.among(ranking, ())
    order = ranking.of(best)
    if other is not None:
        order = order[deciding.candidates.grasp_index[order] != other.grasp_index]
    return deciding.among(ranking, tuple(order[:CHOICES].tolist()))


def _rounds(thorough: bool) -> int:
    return THOROUGH_ROUNDS if thorough else ROUNDS_AGAIN
