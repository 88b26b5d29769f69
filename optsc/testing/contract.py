"""The base of all contract tests: how a suite is run without pytest, and how an error is expected."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class Contract:
    """A suite of tests, the methods that begin with ``test_``; each runs on an instance of its own.

    A test that does not apply to a part is left out of its subclass with ``test_... = None``.
    """

    @classmethod
    def check(cls) -> tuple[str, ...]:
        """Run every test, in alphabetical order, and return their names; for scripts and notebooks.

        Raises `AssertionError` for the first that fails, with its name.
        """
        names = tuple(name for name in dir(cls) if name.startswith("test_") and callable(getattr(cls, name)))
        for name in names:
            try:
                getattr(cls(), name)()
            except AssertionError as error:
                raise AssertionError(f"{cls.__name__}.{name}: {error}") from error
        return names


@contextmanager
def refused(kind: type[Exception], word: str) -> Iterator[None]:
    """Expect an error of that kind whose message has ``word``; raise `AssertionError` where there is none."""
    try:
        yield
    except kind as error:
        if word in str(error):
            return
        raise AssertionError(f"the error does not name {word!r}: {error}") from error
    raise AssertionError(f"no {kind.__name__} that names {word!r}")
