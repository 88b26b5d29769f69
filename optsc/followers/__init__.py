"""What executes the commands: the follower protocol and an ideal arm."""

from optsc.followers.ideal import IdealFollower
from optsc.followers.protocol import Follower, FollowerState

__all__ = ["Follower", "FollowerState", "IdealFollower"]
