"""What is called held is between the jaws: judged by their measured opening, of which no single reading is believed."""

import numpy as np
import pytest

from optsc.control.jaws import GripStatus, Jaws, JawSettings
from optsc.control.modes import Event
from optsc.geometry import Pose
from optsc.selection import Target

SETTINGS = JawSettings()
AT = ((0.4, 0.0, 0.1), (0.0, 1.0, 0.0, 0.0))
NAN = float("nan")
SEEDS = range(12)


def target(width):
    X = Pose.identity()
    return Target("can", 0, 0, False, X, X, np.zeros(7), np.zeros(7), width, 1.0)


def closing(rng, *, width, between, widest=0.08, rate=500.0, noise=0.0, speed=0.1, delay=0.0, longest=4.0, spoil=None):
    """Jaws that close on something ``between`` [m] wide, read until they have told something: jaws, event, time."""
    period = 1.0 / rate
    jaws = Jaws()
    for _ in range(10):
        jaws, _ = jaws.updated(SETTINGS, widest, period, widest)
    jaws = jaws.closing(None if width is None else target(width), AT)
    for tick in range(round(longest * rate)):
        time = tick * period
        reading = max(between, widest - speed * max(time - delay, 0.0)) + noise * rng.normal()
        if spoil is not None:
            reading = spoil(rng, reading)
        jaws, change = jaws.updated(SETTINGS, widest, period, reading)
        if change.event is not None:
            return jaws, change, time
    return jaws, change, longest


def hands(seed):
    """A random hand: its widest opening, its speed, its delay, the rate of the loop and the noise of its readings."""
    rng = np.random.default_rng(seed)
    how = {
        "widest": float(rng.uniform(0.05, 0.14)),
        "rate": float(rng.choice([20.0, 60.0, 250.0, 500.0, 1000.0])),
        "speed": float(rng.uniform(0.03, 0.3)),
        "delay": float(rng.uniform(0.0, 0.4)),
        "noise": float(rng.uniform(0.0, 3e-4)),
    }
    return rng, how


@pytest.mark.parametrize("seed", SEEDS)
def test_jaws_that_rest_at_the_grasps_width_hold_whatever_the_hand(seed):
    rng, how = hands(seed)
    width = float(rng.uniform(0.005, how["widest"] - 0.012))
    between = width + float(rng.uniform(-0.4, 0.4)) * min(width, 0.01)
    jaws, change, time = closing(rng, width=width, between=between, **how)
    assert change.event is Event.HELD
    assert jaws.held.object_name == "can"
    assert jaws.held.opening == pytest.approx(between, abs=5e-4)
    assert time < how["delay"] + how["widest"] / how["speed"] + 1.0


@pytest.mark.parametrize("seed", SEEDS)
def test_jaws_that_meet_hold_nothing_and_say_so_in_numbers(seed):
    rng, how = hands(seed)
    width = float(rng.uniform(0.006, how["widest"] - 0.012))
    jaws, change, _ = closing(rng, width=width, between=4e-4, **how)
    assert change.event is Event.EMPTY
    assert jaws.held is None
    assert f"expected {1e3 * width:.1f} mm for the can" in change.reason


@pytest.mark.parametrize("seed", SEEDS)
def test_jaws_that_are_stopped_early_hold_nothing_that_was_meant(seed):
    rng, how = hands(seed)
    width = float(rng.uniform(0.006, how["widest"] - 0.02))
    between = float(rng.uniform(width + 0.012, how["widest"]))
    jaws, change, _ = closing(rng, width=width, between=between, **how)
    assert change.event is Event.TOO_WIDE
    assert jaws.held is None
    assert jaws.grip.may_drop


@pytest.mark.parametrize("width", [None, NAN, 0.0, 0.08])
def test_where_the_width_is_unknown_held_is_more_than_closed_and_less_than_open(width):
    rng = np.random.default_rng(0)
    for between, event in ((4e-4, Event.EMPTY), (0.01, Event.HELD), (0.07, Event.HELD), (0.08, Event.TOO_WIDE)):
        assert closing(rng, width=width, between=between)[1].event is event


@pytest.mark.parametrize("seed", SEEDS)
def test_glitches_and_missing_readings_are_no_evidence(seed):
    rng, how = hands(seed)
    width = 0.6 * how["widest"]
    wrong = [NAN, np.inf, -np.inf, -1.0, 0.0, how["widest"], 1e300, None, "open"]

    def spoil(rng, reading):
        spoil.since += 1
        if spoil.since < 5 or rng.random() < 0.7:
            return reading
        spoil.since = 0
        return wrong[rng.integers(len(wrong))]

    spoil.since = 0
    jaws, change, _ = closing(rng, width=width, between=width, spoil=spoil, longest=8.0, **how)
    assert change.event is Event.HELD
    for _ in range(round(2.0 * how["rate"])):
        jaws, change = jaws.updated(SETTINGS, how["widest"], 1.0 / how["rate"], spoil(rng, width))
        assert change.event is None
    assert jaws.held is not None


def test_jaws_that_are_not_measured_hold_nothing_and_are_blind():
    rng = np.random.default_rng(0)
    jaws, change, _ = closing(rng, width=0.05, between=0.05, spoil=lambda rng, reading: NAN)
    assert change.event is None
    assert jaws.held is None
    assert jaws.blind(1 / 500.0)


@pytest.mark.parametrize("seed", SEEDS)
def test_what_slips_is_said_and_what_is_gone_is_not_called_held(seed):
    rng, how = hands(seed)
    width, period = float(rng.uniform(0.02, how["widest"] - 0.012)), 1.0 / how["rate"]
    jaws, _, _ = closing(rng, width=width, between=width, **how)

    def read(jaws, opening, seconds):
        events, gone = [], None
        for tick in range(round(seconds * how["rate"])):
            reading = opening + how["noise"] * rng.normal()
            jaws, change = jaws.updated(SETTINGS, how["widest"], period, reading)
            if change.event is not None:
                events.append(change.event)
            if jaws.held is None and gone is None:
                gone = tick * period
        return jaws, events, gone

    jaws, events, _ = read(jaws, width, 1.0)
    assert events == []
    jaws, events, _ = read(jaws, width - 0.0055, 1.0)
    assert events == [Event.SLIPPED]
    assert jaws.held.opening == pytest.approx(width - 0.0055, abs=1e-3)
    jaws, events, gone = read(jaws, 0.0, 2.0)
    assert events == [Event.LOST, Event.EMPTY]
    assert gone < 0.3
    assert jaws.grip is GripStatus.EMPTY


def test_what_had_stopped_the_jaws_may_go_and_then_they_are_judged_again():
    rng = np.random.default_rng(0)
    jaws, change, _ = closing(rng, width=0.03, between=0.06)
    assert change.event is Event.TOO_WIDE
    events = []
    for tick in range(800):
        jaws, change = jaws.updated(SETTINGS, 0.08, 0.002, max(0.03, 0.06 - 0.0002 * tick))
        events += [change.event] if change.event is not None else []
    assert events == [Event.HELD]
