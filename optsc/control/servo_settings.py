"""Settings of the servo: how a stream of targets is followed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from optsc.checks import Checked, NonNegative, OneOf, Pair, Positive, Share
from optsc.ik import IkSettings
from optsc.operators.prediction import PredictionSettings


@dataclass(frozen=True)
class ServoSettings(Checked):
    """How a target is followed.

    Attributes:
        bandwidth: of the reference model [rad/s]: higher follows more closely and passes on more of the noise.
        led: share of the hand's acceleration that the reference is led along with. One is exact for a hand that
            accelerates steadily; less is smoother.
        lag: how far behind a stream of targets the tool is led [s]. Zero means to be where the hand is now, which
            has to be guessed; a few hundredths make the motion several times smoother.
        catching_up: speed at most with which a target is caught up with, beside its own [m/s, rad/s].
        timeout: age of the newest target after which the arm comes to rest [s].
        far: how far the reference goes ahead of the tool at most; a target further off than that counts as out of
            reach where nothing leads nearer [m, rad].
        spare_motion: where motion goes that the tool does not need: to the "preferred" configuration (home, or what
            `Servo.prefer` was given), or "stay": to the configuration in which the arm began to be led.
        prediction: how samples are carried on to the present.
        ik: weights and gains of the quadratic program.
    """

    bandwidth: Annotated[float, Positive] = 55.0
    lag: Annotated[float, NonNegative] = 0.028
    led: Annotated[float, Share] = 0.5
    catching_up: Annotated[tuple[float, float], Pair] = (0.5, 1.5)
    timeout: Annotated[float, Positive] = 0.1
    far: Annotated[tuple[float, float], Pair] = (0.05, 0.2)
    spare_motion: Annotated[str, OneOf(("preferred", "stay"), "spare motion")] = "preferred"
    prediction: PredictionSettings = field(default_factory=PredictionSettings)
    ik: IkSettings = field(default_factory=IkSettings)
