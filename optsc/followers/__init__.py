"""What carries out the commands: an ideal arm, or one in a simulated world, by one protocol."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from optsc.followers.ideal import IdealFollower
from optsc.followers.protocol import Follower, FollowerState

if TYPE_CHECKING:
    from optsc.followers.bullet import PyBulletFollower

__all__ = ["Follower", "FollowerState", "IdealFollower", "PyBulletFollower"]


def __getattr__(name: str) -> Any:
    """Load PyBullet only when its follower is asked for."""
    if name == "PyBulletFollower":
        from optsc.followers.bullet import PyBulletFollower

        return PyBulletFollower
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
