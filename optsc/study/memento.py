"""Going back in time: what a controller was at one moment, to be made so again as often as is wanted.

A controller is Python objects, arrays, and compiled functions that keep nothing between two calls but the arrays they
were given. So its state is the attributes of its objects and the contents of its arrays; both are put back in place,
because the compiled functions know the arrays by their addresses.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from optsc.robot import RobotModel

_VALUES = (str, bytes, int, float, complex, bool, type(None), RobotModel)


class Memento:
    """The state of ``root`` now, but for what lies behind ``shared`` objects.

    Followed are attributes of this library's objects, lists, dictionaries, tuples and deques; frozen dataclasses are
    values and only looked into for arrays. Robots are shared, and never change.
    """

    def __init__(self, root: object, shared: Sequence[object] = ()) -> None:
        self._arrays: list[tuple[np.ndarray, np.ndarray]] = []
        self._attributes: list[tuple[Any, dict[str, Any]]] = []
        self._containers: list[tuple[Any, Any]] = []
        seen = {id(item): item for item in shared}
        waiting = [root]
        while waiting:
            item = waiting.pop()
            if id(item) in seen or isinstance(item, _VALUES):
                continue
            seen[id(item)] = item  # held, so that no address is used twice
            waiting.extend(self._taken(item))

    def restore(self) -> None:
        """Make everything what it was."""
        for array, content in self._arrays:
            array[...] = content
        for item, attributes in self._attributes:
            vars(item).clear()
            vars(item).update(attributes)
        for container, content in self._containers:
            container.clear()
            (container.update if isinstance(container, dict) else container.extend)(content)

    def _taken(self, item: Any) -> Iterator[object]:
        if isinstance(item, np.ndarray):
            if item.flags.writeable:
                self._arrays.append((item, item.copy()))
        elif isinstance(item, (list, deque)):
            self._containers.append((item, list(item)))
            yield from item
        elif isinstance(item, dict):
            self._containers.append((item, dict(item)))
            yield from item.values()
        elif isinstance(item, tuple):
            yield from item
        elif type(item).__module__.startswith("optsc."):
            yield from self._parts(item)

    def _parts(self, item: Any) -> Iterator[object]:
        attributes = getattr(item, "__dict__", None)
        if attributes is not None:
            parameters = getattr(item, "__dataclass_params__", None)
            frozen = parameters is not None and parameters.frozen
            if not frozen:
                self._attributes.append((item, dict(attributes)))
            yield from attributes.values()
        for kind in type(item).__mro__:
            slots = getattr(kind, "__slots__", ())
            for name in (slots,) if isinstance(slots, str) else slots:
                if hasattr(item, name):
                    yield getattr(item, name)
