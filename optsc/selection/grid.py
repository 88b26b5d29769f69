"""Ranking grid: candidates and reach table as arrays with one line per object, its candidates along it.

The layout is the same whatever the order in which the candidates came, and all objects are handled by one
array operation each; shorter lines are padded with places that are never admissible.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import UnknownName
from optsc.geometry import rotation
from optsc.geometry.rotation import Array
from optsc.selection.reach import REACHED, ReachTable

if TYPE_CHECKING:
    from optsc.grasps import Candidates

TWIN_TOLERANCE = 1e-12
"""Two jaw twins whose |q . q_i| differ by less are equally near; then the stored one is taken."""
_HANDICAP = 2.0  # taken from |q . q_i| of a twin that cannot be used: more than any other can lack


@dataclass(frozen=True, eq=False)
class Layout:
    """Where each candidate stands in a grid of K objects with up to M places each.

    Attributes:
        candidates: the N candidates.
        names: the K object names, sorted.
        index: (K, M) candidate at each place, sorted by grasp index; -1 where a line is padded.
        place: (N,) number of each candidate's place, counted along the lines.
    """

    candidates: Candidates
    names: tuple[str, ...]
    index: np.ndarray
    place: np.ndarray

    @classmethod
    def of(cls, candidates: Candidates) -> Layout:
        """Return the layout of ``candidates``."""
        objects = np.asarray(candidates.object_index, dtype=np.int64)
        names = tuple(sorted(candidates.object_names))
        line = np.array([names.index(name) for name in candidates.object_names], dtype=np.int64)[objects]
        order = np.lexsort((candidates.grasp_index, line))
        counts = np.bincount(line, minlength=len(names))
        width = max(1, int(counts.max(initial=0)))
        first = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64) if len(names) else counts
        column = np.arange(len(order)) - first[line[order]]
        index = np.full((len(names), width), -1, dtype=np.int64)
        index[line[order], column] = order
        place = np.empty(len(order), dtype=np.int64)
        place[order] = line[order] * width + column
        return cls(candidates, names, index, place)

    def spread(self, values: ArrayLike, padding: ArrayLike = 0) -> np.ndarray:
        """Return values (N, ...) of the candidates at their places (K, M, ...)."""
        array = np.asarray(values)
        pad = np.broadcast_to(np.asarray(padding, dtype=array.dtype), (1, *array.shape[1:]))
        return np.concatenate([array, pad])[self.index]

    def gather(self, values: np.ndarray) -> np.ndarray:
        """Return values (K, M, ...) at the places as (N, ...), in the order of the candidates."""
        return values.reshape(-1, *values.shape[2:])[self.place]


class Grid:
    """A reach table at the places of a `Layout`: what ranking reads. Treat as read-only.

    Components come first and twins next, so that every operation runs along memory.

    Attributes:
        layout: which candidate stands where.
        table: the reach table.
        quaternions: (4, T, K, M) orientation of every twin.
        positions: (3, K, M) of the candidates; twins share it [m].
        status: (T, K, M), see `optsc.selection.reach.REASONS`.
        reachable: (K, M) places of which at least one twin can be used.
        manipulability: (T, K, M).
        first_rows: (K * M,) row of the table of the stored twin at each place.
        seeds: (N * T, n) configuration of the arm from which each row of the table was solved [rad].
    """

    def __init__(self, table: ReachTable) -> None:
        self.layout = Layout.of(table.candidates)
        self.table = table
        self._columns: dict[str, Array] = {}
        self._cached: dict[int, tuple[object, Array]] = {}
        self.positions = _components_first(self.layout.spread(table.X_WG.translation[:, 0]))
        quaternions = self._per_twin(table.X_WG.quaternion, [1.0, 0.0, 0.0, 0.0])
        self.quaternions = _components_first(quaternions)
        self._flat_quaternions = self.quaternions.reshape(4, -1)
        self.first_rows = self.layout.index.ravel() * table.twins
        self._read_status()

    def with_table(self, table: ReachTable) -> Grid:
        """Return the grid of a table of the same candidates, some of whose rows were solved again."""
        grid = copy.copy(self)
        grid.__dict__.pop("q_grasp", None)
        grid.table, grid._columns, grid._cached = table, {}, {}
        grid._read_status()
        return grid

    def _read_status(self) -> None:
        self.status = self._per_twin(self.table.status, -1)
        usable = self.status == REACHED
        self.reachable = usable.any(axis=0)
        self._handicap = np.where(usable, 0.0, _HANDICAP)
        self.manipulability = self._per_twin(self.table.manipulability)
        self.seeds = self.table.seed.reshape(self.table.rows, self.table.seed.shape[-1])

    def _per_twin(self, values: np.ndarray, padding: ArrayLike = 0) -> np.ndarray:
        spread = [self.layout.spread(values[:, t], padding) for t in range(self.table.twins)]
        return np.ascontiguousarray(np.stack(spread))

    @cached_property
    def rotations(self) -> Array:
        """Rotation matrices (3, 3, K, M) of the stored twins."""
        R = rotation.to_matrix(np.moveaxis(self.quaternions[:, 0], 0, -1))
        return np.ascontiguousarray(np.moveaxis(R, (2, 3), (0, 1)))

    @cached_property
    def q_grasp(self) -> Array:
        """Configurations at the grasps (n, T, K, M) [rad]."""
        return _components_first(self._per_twin(self.table.q_grasp))

    @cached_property
    def pregrasp_positions(self) -> Array:
        """Positions (3, K, M) of the pre-grasps; twins share them [m]."""
        return _components_first(self.layout.spread(self.table.X_WP.translation[:, 0]))

    def column(self, name: str) -> Array:
        """Return a column (T, K, M) of the table; raise `UnknownName` where it was not asked for."""
        if name not in self._columns:
            if name not in self.table.columns:
                raise UnknownName("column of the reach table", name, self.table.columns)
            self._columns[name] = self._per_twin(self.table.columns[name])
        return self._columns[name]

    def cached(self, key: object, compute: Callable[[Grid], Array]) -> Array:
        """Return ``compute(self)``, from the second call with the very same ``key`` object on without computing."""
        # The key itself is kept, so that its number cannot become another's.
        if id(key) not in self._cached:
            self._cached[id(key)] = key, compute(self)
        return self._cached[id(key)][1]

    @cached_property
    def quality(self) -> Array:
        """Quality of the grasps (K, M), in [0, 1]."""
        return self.layout.spread(self.table.candidates.quality)


def _components_first(values: Array) -> Array:
    return np.ascontiguousarray(np.moveaxis(values, -1, 0))


class Situation(NamedTuple):
    """A grid seen from one pose of the hand; what costs and filters are computed from.

    Attributes:
        grid: the candidates and their reach.
        quaternion: (4,) orientation of the tool that the operator moves, unit.
        position: (3,) [m].
        q: (n,) present configuration of the arm [rad].
        turned: (K, M) bool, True where the half-turned jaw twin is the one to use; None when there are no
            twins.
        similarity: (K, M) |q . q_i| in [0, 1] of the twin to use: cosine of half the angle between hand and
            grasp.
        shared: what several costs need of this situation, by name, kept by the first that works it out.
        endless: indices of the joints that turn without limits.
    """

    grid: Grid
    quaternion: Array
    position: Array
    q: Array
    turned: np.ndarray | None
    similarity: Array
    shared: dict[str, tuple[Array, ...]]
    endless: tuple[int, ...] = ()

    def chosen(self, per_twin: np.ndarray) -> np.ndarray:
        """Return of values (..., T, K, M) those of the twin to use (..., K, M)."""
        stored = per_twin[..., 0, :, :]
        return stored if self.turned is None else np.where(self.turned, per_twin[..., 1, :, :], stored)


def situate(grid: Grid, quaternion: Array, position: Array, q: Array, endless: tuple[int, ...] = ()) -> Situation:
    """Return ``grid`` as seen from a finite hand pose: unit quaternion (4,) and position (3,) [m].

    Of two jaw twins the nearer in orientation is used among those that the arm can reach; if it can
    reach both or none, simply the nearer; if both are equally near, the stored one.
    """
    similarity = np.abs(quaternion @ grid._flat_quaternions).reshape(grid.status.shape)
    if len(similarity) == 1:
        return Situation(grid, quaternion, position, q, None, similarity[0], {}, endless)
    score = similarity - grid._handicap
    turned = score[1] > score[0] + TWIN_TOLERANCE
    nearer = np.where(turned, similarity[1], similarity[0])
    return Situation(grid, quaternion, position, q, turned, nearer, {}, endless)
