"""Clients of the page server: who may drive, how much each may say, and how late what they say is."""

from __future__ import annotations

from dataclasses import dataclass, field

RATE, BURST = 250.0, 100.0
"""Messages a client may send a second, and how many at once: a headset sends 120 a second."""
MOST_REFUSED = 500
"""A client of whose messages so many were refused is sent away."""
LATEST = 0.3
"""A message of the hand that was on its way for longer than the quickest by this [s] is of the past: after a lag,
nothing that was queued is done any more."""
DRIFT = 1e-3
"""How quickly the clocks of two machines part at most [s/s]."""


@dataclass(eq=False)
class Client:
    """One page.

    Attributes:
        name: for messages.
        refused: how many of its messages were.
        skipped: how many frames it was not sent because it had not taken those before.
    """

    name: str
    refused: int = 0
    skipped: int = 0
    _allowance: float = BURST
    _counted: float | None = None
    _offset: float | None = None
    _compared: float = 0.0

    def may_speak(self, now: float) -> bool:
        """Tell whether a message at ``now`` [s] is within what a client may send (a token bucket)."""
        if self._counted is not None:
            self._allowance = min(BURST, self._allowance + RATE * (now - self._counted))
        self._counted = now
        if self._allowance < 1.0:
            return False
        self._allowance -= 1.0
        return True

    def delay(self, sent: float, now: float) -> float:
        """Return how much longer than the quickest so far a message was on its way [s].

        ``sent`` is on the client's clock, which may be off by anything and drift.
        """
        offset = now - sent
        if self._offset is None or offset < self._offset:
            self._offset = offset
        else:
            self._offset = min(offset, self._offset + DRIFT * (now - self._compared))
        self._compared = now
        return offset - self._offset


@dataclass(eq=False)
class Clients:
    """All pages that are open. One of them is the operator's, the others watch.

    Attributes:
        operator: whose hand moves the arm; None where nobody's does.
    """

    operator: Client | None = None
    _all: list[Client] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self._all)

    def joined(self, client: Client) -> None:
        """Count a page that was opened."""
        self._all.append(client)

    def left(self, client: Client) -> bool:
        """Forget a page that was closed, and tell whether it was the operator's."""
        if client in self._all:
            self._all.remove(client)
        if self.operator is not client:
            return False
        self.operator = None
        return True

    def claimed(self, client: Client) -> bool:
        """Make a client the operator's where there is none, and tell whether it is."""
        if self.operator is None:
            self.operator = client
        return self.operator is client
