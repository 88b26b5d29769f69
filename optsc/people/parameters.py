"""Parameters of simulated operators: motor habits, ready poses, intentions, and the kinds of people.

The source of each value is given with it; the others are tuned here.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from math import log2, pi, radians
from types import MappingProxyType
from typing import Annotated

import numpy as np

from optsc.checks import AtLeast, Between, Checked, Each, Finite, NonNegative, Ordered, Pair, Positive, Share
from optsc.errors import InvalidValue, UnknownName


@dataclass(frozen=True)
class HumanParameters(Checked):
    """A person with a hand-held tracker; every value with its unit and its source, see also ``docs/operators.md``.

    Attributes:
        sample_rate: of the tracker [Hz]; the display rate at which headsets hand out poses.
        initial_rest: before the first movement [s]; tuned here.
        misalignment: greatest angle between hand and tool at the start [rad]; tuned here. People work on without
            noticing up to about 20 degrees (Che et al. 2015).
        fitts_intercept: a of MT = a + b ID [s]; tuned here.
        fitts_slope: b [s/bit]; 1 / 2.88 bit/s with a master-slave arm (Draper, Handel, Hood 1990), by hand 16.98.
        position_tolerance: how near to where it is wanted the tool has to come [m]; tuned here.
        rotation_tolerance: the same for its orientation [rad]; tuned here.
        reaction: from seeing an error to moving against it [s]; 0.12 to 0.20 (Saunders and Knill 2005).
        patience: longest wait for a tool that has not come to rest [s]; tuned here.
        corrections: most corrective movements before the person abandons a pose; tuned here. The bare hand takes one
            (Meyer et al. 1988), with an arm that lags there are more (Ferrell 1965).
        attempts: how many other poses are then tried before the person takes one as it is; tuned here.
        motor_noise: standard deviation of the hand's velocity noise, as a share of its speed [-]: noise that
            grows with the signal (Harris and Wolpert 1998). Value tuned here: a reach of 1 s ends 4 % off.
        motor_noise_time: correlation time of that noise [s]: the muscle's low-pass of two stages of 30 and
            40 ms (van Beers, Haggard, Wolpert 2004).
        tremor: root mean square of the tremor, for each axis [m]; 0.015 to 0.25 mm with an instrument in hand
            (PMC3032442, Fig. 4). Of the empty hand it is less (Archives of Neurology 39, 358, 1982).
        tremor_rotation: the same for rotation [rad]; tuned here, 0.2 mm at 15 cm from the wrist.
        tremor_frequency: within the 6 to 12 Hz in which physiological tremor peaks [Hz] (Lakie et al. 2015).
        tremor_bandwidth: width of its peak at half power [Hz]; tuned here, most of it then is in that band.
        drift: root mean square of the slow wandering of an unsupported arm, for each axis [m]; tuned here.
        drift_rotation: the same for rotation [rad]; tuned here.
        drift_time: its correlation time [s]; tuned here.
        tracker_noise: standard deviation of the tracker, for each axis [m]; tuned here, consumer trackers reach
            0.15 mm at rest (Maciejewski 2021) and are worse in use.
        tracker_noise_rotation: the same for rotation [rad]; tuned here, ten times the 0.008 degrees there.
        dwell: between being content with the pose and pressing the trigger [s]; tuned here, as long as the dwell that
            selects in a study of pointing by gaze and head (Hansen et al. 2018).
        press: how long the trigger is held [s]; tuned here.
        retrigger: least time between a lost automation and the next trigger [s]; tuned here.
        grasp_tolerance: how near to a grasp the tool has to come to close the jaws by hand [m, rad]; tuned here.
        standoff: how far before it a person who grasps by hand pauses [m]; tuned here, the robot's own.
        misjudged: how far off the tool is seen, always by the same offset [m, rad]; tuned here, none.
        hand_start: where the hand rests at first, in S [m]; tuned here.
    """

    sample_rate: Annotated[float, Positive] = 90.0
    initial_rest: Annotated[float, NonNegative] = 0.3
    misalignment: Annotated[float, NonNegative] = radians(8.0)
    fitts_intercept: Annotated[float, NonNegative] = 0.1
    fitts_slope: Annotated[float, NonNegative] = 0.35
    position_tolerance: Annotated[float, Positive] = 0.02
    rotation_tolerance: Annotated[float, Positive] = radians(7.0)
    reaction: Annotated[float, NonNegative] = 0.2
    patience: Annotated[float, NonNegative] = 2.0
    corrections: Annotated[int, AtLeast(0)] = 4
    attempts: Annotated[int, AtLeast(0)] = 3
    motor_noise: Annotated[float, NonNegative] = 0.084
    motor_noise_time: Annotated[float, Positive] = 0.07
    tremor: Annotated[float, NonNegative] = 0.2e-3
    tremor_rotation: Annotated[float, NonNegative] = radians(0.08)
    tremor_frequency: Annotated[float, NonNegative] = 10.0
    tremor_bandwidth: Annotated[float, Positive] = 2.5
    drift: Annotated[float, NonNegative] = 1.0e-3
    drift_rotation: Annotated[float, NonNegative] = radians(0.3)
    drift_time: Annotated[float, Positive] = 2.0
    tracker_noise: Annotated[float, NonNegative] = 0.3e-3
    tracker_noise_rotation: Annotated[float, NonNegative] = radians(0.1)
    dwell: Annotated[float, NonNegative] = 0.3
    press: Annotated[float, NonNegative] = 0.12
    retrigger: Annotated[float, NonNegative] = 1.0
    grasp_tolerance: Annotated[tuple[float, float], Pair] = (0.006, radians(4.0))
    standoff: Annotated[float, NonNegative] = 0.1
    misjudged: Annotated[tuple[float, float], Each(NonNegative)] = (0.0, 0.0)
    hand_start: Annotated[tuple[float, float, float], Each(Finite)] = (0.35, -0.15, 1.05)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tremor_frequency + self.tremor_bandwidth >= 0.5 * self.sample_rate:
            valid = "below half the sample rate, bandwidth included"
            raise InvalidValue("HumanParameters.tremor_frequency", self.tremor_frequency, valid)
        if self.press * self.sample_rate < 1.0:
            raise InvalidValue("HumanParameters.press", self.press, "one sample period or longer")

    def movement_time(self, distance: float, angle: float) -> float:
        """Return how long a movement over ``distance`` [m] and ``angle`` [rad] takes [s].

        Fitts' law with MacKenzie's index of difficulty log2(D/W + 1); the indices of a translation and a
        rotation made together add up (Stoelen and Akin 2010). The target is as wide as both tolerances.
        """
        bits = log2(distance / (2.0 * self.position_tolerance) + 1.0)
        bits += log2(angle / (2.0 * self.rotation_tolerance) + 1.0)
        return self.fitts_intercept + self.fitts_slope * bits


@dataclass(frozen=True)
class AimParameters(Checked):
    """The ready poses that a person likes; every value is tuned here, after how people reach for things on a table.

    Attributes:
        elevation: range of the approach's angle above the horizontal [rad].
        azimuth: greatest angle about the vertical between the approach and the direction from the robot's
            base to the object [rad]: never from behind the object.
        distance: range of the distance from the tool to the object's middle [m].
        roll: greatest turn of the closing axis out of the horizontal, about the tool's z axis [rad].
        middle: height of an object's middle over the centre of its base [m].
        nearest: horizontal distance that the tool keeps from the robot's base, if it can [m].
        clearance: distance that the tool keeps from the middles of other objects, if it can [m].
        draws: how many ready poses are considered for it.
        adjustment: how much of each range a renewed attempt may change [-].
    """

    elevation: Annotated[tuple[float, float], Each(Between(0.0, 0.5 * pi)), Ordered] = (
        radians(35.0),
        radians(90.0),
    )
    azimuth: Annotated[float, Between(0.0, pi)] = radians(60.0)
    distance: Annotated[tuple[float, float], Each(NonNegative), Ordered] = (0.12, 0.20)
    roll: Annotated[float, Between(0.0, pi)] = radians(20.0)
    middle: Annotated[float, Finite] = 0.05
    nearest: Annotated[float, NonNegative] = 0.33
    clearance: Annotated[float, NonNegative] = 0.14
    draws: Annotated[int, AtLeast(1)] = 12
    adjustment: Annotated[float, Share] = 0.15


@dataclass(frozen=True)
class Intention(Checked):
    """One intention: bring the tool near an object and let the robot take over.

    Attributes:
        object: name of the object.
        then_take_over_after: how long after the trigger the person takes over again [s]; None: not at all.
        put_down: whether the person has the object put down once it has been carried, and goes on with the plan.
        place: where: x, y of the tool in W [m]; None for below where it was carried.
    """

    object: str
    then_take_over_after: Annotated[float | None, Positive] = None
    put_down: bool = False
    place: Annotated[tuple[float, float] | None, Each(Finite)] = None


@dataclass(frozen=True)
class OperatorType:
    """A kind of person.

    Attributes:
        name: for tables and records.
        about: what sets these people apart, in words.
        human: motor habits.
        changes_mind_after: first goes for another object, and for the wanted one this long after the trigger [s];
            None: not at all.
    """

    name: str
    about: str
    human: HumanParameters = field(default_factory=HumanParameters)
    changes_mind_after: float | None = None

    def plan(self, wanted: str, objects: Collection[str], seed: int) -> tuple[Intention, ...]:
        """Return what a person of this kind does to get ``wanted``, one of ``objects``; raise `UnknownName`."""
        if wanted not in objects:
            raise UnknownName("object", wanted, sorted(objects))
        others = sorted(set(objects) - {wanted})
        if self.changes_mind_after is None or not others:
            return (Intention(wanted),)
        # A separate stream: what the hand does must not depend on which object came first.
        first = others[int(np.random.default_rng([seed, 1]).integers(len(others)))]
        return (Intention(first, then_take_over_after=self.changes_mind_after), Intention(wanted))


TYPES: Mapping[str, OperatorType] = MappingProxyType(
    {
        kind.name: kind
        for kind in (
            OperatorType("typical", "the middle of what is known; the default elsewhere"),
            OperatorType(
                "patient",
                "slow, exact, looks twice before handing over",
                HumanParameters(
                    fitts_slope=0.45,
                    position_tolerance=0.012,
                    rotation_tolerance=radians(4.0),
                    corrections=6,
                    dwell=0.8,
                    patience=4.0,
                ),
            ),
            OperatorType(
                "hasty",
                "quick, hence noisy, hands over from wherever the first movement ended",
                HumanParameters(
                    fitts_slope=0.2,
                    position_tolerance=0.05,
                    rotation_tolerance=radians(15.0),
                    corrections=1,
                    motor_noise=0.15,
                    dwell=0.1,
                    patience=0.5,
                    retrigger=0.5,
                ),
            ),
            OperatorType(
                "biased",
                "sees the tool 3 cm and 10 degrees off, always the same way",
                HumanParameters(misjudged=(0.03, radians(10.0))),
            ),
            OperatorType(
                "mind-changing",
                "goes for another object first, steps in on the way and wants this one",
                changes_mind_after=0.8,
            ),
        )
    }
)
"""The built-in kinds by name; what makes them different is tuned here, after `HumanParameters`."""


def operator_type(name: str) -> OperatorType:
    """Return the kind of that name; raise `UnknownName`."""
    if name not in TYPES:
        raise UnknownName("operator type", name, TYPES)
    return TYPES[name]
