"""Mailbox between a device and the control loop: it holds the newest sample, and only that."""

from __future__ import annotations

from threading import Lock

from optsc.operators.sample import OperatorSample, OperatorView


class Mailbox:
    """An `Operator` whose samples come from elsewhere, such as a device's own thread or a network callback.

    A queue would hand in old poses after a pause, and the arm would replay them; a mailbox forgets what was overtaken.
    Safe for any number of threads that post and one that reads.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._sample: OperatorSample | None = None
        self._overtaken = 0

    def post(self, sample: OperatorSample) -> None:
        """Put in a sample in place of whatever is there; the caller keeps none of its arrays."""
        with self._lock:
            self._overtaken += self._sample is not None
            self._sample = sample

    def read(self, view: OperatorView | None = None) -> OperatorSample | None:
        """Take out the newest sample; None when there is none since the last call."""
        with self._lock:
            sample, self._sample = self._sample, None
            return sample

    @property
    def overtaken(self) -> int:
        """How many samples were replaced before anyone read them."""
        return self._overtaken
