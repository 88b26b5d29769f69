"""Time laws along a path: how far along it at each moment, jerk-limited, by Ruckig."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

from optsc.checks import Checked, NonNegative, Positive
from optsc.errors import SolverFailure


class PathPoint(NamedTuple):
    """Distance travelled, its rate and acceleration, in the path's unit and seconds."""

    s: float
    rate: float
    acceleration: float


@dataclass(frozen=True)
class TimeLaw(Checked):
    """The quickest motion over ``length`` from rest to rest within speed, acceleration and jerk limits.

    The unit of length is the caller's (a path in metres, a share of a path); limits are in it per s, s^2, s^3.
    """

    length: Annotated[float, NonNegative]
    speed: Annotated[float, Positive]
    acceleration: Annotated[float, Positive]
    jerk: Annotated[float, Positive]

    def __post_init__(self) -> None:
        super().__post_init__()
        from ruckig import InputParameter, Result, Ruckig, RuckigError, Trajectory

        plan, trajectory = InputParameter(1), Trajectory(1)
        plan.target_position = [self.length]
        plan.max_velocity, plan.max_acceleration = [self.speed], [self.acceleration]
        plan.max_jerk = [self.jerk]
        try:
            result = Ruckig(1).calculate(plan, trajectory)
        except RuckigError as error:
            raise SolverFailure(f"no time law over {self.length}: {error}") from None
        if result not in (Result.Working, Result.Finished):
            raise SolverFailure(f"no time law over {self.length}: Ruckig answers {result}")
        object.__setattr__(self, "_trajectory", trajectory)

    @property
    def duration(self) -> float:
        """Time from rest to rest [s]."""
        return self._trajectory.duration  # type: ignore[attr-defined]

    def at(self, time: float) -> PathPoint:
        """Return the point at ``time`` [s] since the start; the ends hold before and after."""
        if time >= self.duration:
            return PathPoint(self.length, 0.0, 0.0)
        s, rate, acceleration = self._trajectory.at_time(max(time, 0.0))[:3]  # type: ignore[attr-defined]
        return PathPoint(s[0], rate[0], acceleration[0])
