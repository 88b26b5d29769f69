"""What executes the commands: the follower protocol, an ideal arm, an arm at the pace of the clock."""

from optsc.followers.ideal import IdealFollower
from optsc.followers.protocol import Follower, FollowerState
from optsc.followers.recorded import RecordedFollower

__all__ = ["Follower", "FollowerState", "IdealFollower", "RecordedFollower"]
