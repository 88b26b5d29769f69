"""The transition table: its laws, and the page that is generated from it."""

from pathlib import Path

import pytest

from optsc.control.modes import TRANSITIONS, Event, Mode, markdown, next_mode

OPERATOR = {Event.ENGAGED, Event.TRIGGERED}


@pytest.mark.parametrize("mode", Mode)
def test_a_fault_reaches_hold_from_every_mode(mode):
    assert next_mode(mode, Event.FAULT) is Mode.HOLD


def test_hold_is_left_only_by_the_operator():
    assert {
        event for (mode, event), after in TRANSITIONS.items() if mode is Mode.HOLD and after is not mode
    } <= OPERATOR


def test_the_operator_may_step_in_at_any_moment_of_automatic_motion():
    for mode in Mode:
        if mode.automatic:
            assert next_mode(mode, Event.TRIGGERED) is Mode.MANUAL


def test_nothing_happens_without_an_event_or_on_one_that_is_not_listed():
    assert next_mode(Mode.LIFT, None) is Mode.LIFT
    assert next_mode(Mode.MANUAL, Event.ARRIVED) is Mode.MANUAL


def test_every_mode_can_be_reached_and_left():
    after = {(mode, next_) for (mode, _), next_ in TRANSITIONS.items()}
    assert {next_ for _, next_ in after} == set(Mode)
    reached = {Mode.HOLD}
    for _ in Mode:
        reached |= {next_ for mode, next_ in after if mode in reached}
    assert reached == set(Mode)


def test_the_documentation_is_the_table():
    page = Path(__file__).parents[2] / "docs" / "state-machine.md"
    assert page.read_text() == markdown()
