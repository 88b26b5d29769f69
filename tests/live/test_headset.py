"""The page in an emulated headset (iwer, a WebXR runtime for tests): grip pose, squeeze, trigger and haptics."""

from pathlib import Path

import numpy as np
import pytest
from live_pages import begin_again, opened

IWER = Path(__file__).parent / "vendor" / "iwer.min.js"
WEAR = """
  window.headset = new IWER.XRDevice(IWER.metaQuest3);
  headset.installRuntime({forceInstall: true});
  headset.position.set(0, 1.6, 0);
  window.right = headset.controllers.right;
  right.position.set(0.2, 1.1, -0.4);
"""
COUNT_PULSES = """() => {
  window.pulses = [];
  for (const source of optsc.headset.session.inputSources) {
    const [actuator] = source.gamepad?.hapticActuators || [];
    if (actuator) actuator.pulse = (...how) => { window.pulses.push(how); return Promise.resolve(true); };
  }
  return optsc.headset.session.inputSources.length;
}"""


@pytest.fixture
def worn(browser, session):
    """A page whose headset is worn: an immersive session runs."""
    with opened(browser, f"{session.access.address}?light", ready=False, wear=IWER.read_text() + WEAR) as page:
        page.wait_for("Boolean(window.optsc && optsc.moment) && optsc.hand.drives")
        begin_again(page)
        page.page.click("#immersive-vr")
        page.wait_for("Boolean(optsc.headset.space)")
        page.wait_for("[...optsc.headset.session.inputSources].length >= 1")
        page.ask(COUNT_PULSES)
        yield page


def move(page, x, y, z, steps=12):
    """Move the controller by a way, as a hand does: in small steps."""
    for _ in range(steps):
        page.ask(
            "((x, y, z) => right.position.set(right.position.x + x, right.position.y + y, right.position.z + z))"
            f"({x / steps}, {y / steps}, {z / steps})"
        )
        page.page.wait_for_timeout(40)


def squeeze(page, value):
    page.ask(f"right.updateButtonValue('squeeze', {value})")


def tool(page):
    return np.array(page.tool)


def led_to(page, goal):
    at = [float(part) for part in goal]
    page.wait_for(f"{at}.every((x, k) => Math.abs(x - optsc.moment.of('target')[k]) < 0.015)")


def test_a_squeezed_controller_leads_the_tool_the_way_it_moves_and_a_free_one_does_not(worn):
    before = tool(worn)
    move(worn, 0.1, 0.1, 0.0)
    worn.let_run(0.2)
    assert np.linalg.norm(tool(worn) - before) < 1e-9
    squeeze(worn, 1)
    worn.wait_for("optsc.hand.source === 'xr' && optsc.moment.mode === 'manual'")
    # In the headset forward is -z and up is y; who wears it stands behind the arm and looks along x.
    move(worn, 0.0, -0.1, -0.08)
    led_to(worn, before + [0.08, 0.0, -0.1])
    squeeze(worn, 0)
    worn.wait_for("optsc.hand.source === null && optsc.moment.one('engaged') === 0")
    assert worn.ask("pulses.length") > 0


def test_a_controller_that_is_lost_holds_the_arm_and_one_that_returns_elsewhere_does_not_jump(worn):
    squeeze(worn, 1)
    worn.wait_for("optsc.moment.mode === 'manual'")
    move(worn, 0.0, -0.05, 0.0)
    worn.ask("right.connected = false")
    worn.wait_for("optsc.hand.source === null && optsc.moment.status === 'at rest'")
    rest = tool(worn)
    worn.ask("right.position.set(-0.3, 0.7, -0.2)")
    worn.ask("right.connected = true")
    squeeze(worn, 1)
    worn.wait_for("optsc.hand.source === 'xr' && optsc.moment.one('engaged') === 1")
    worn.let_run(0.4)
    assert np.linalg.norm(tool(worn) - rest) < 2e-3


def test_a_tracker_that_jumps_lets_go_instead_of_leading_the_arm_there(worn):
    squeeze(worn, 1)
    worn.wait_for("optsc.moment.mode === 'manual'")
    worn.let_run(0.2)
    before = tool(worn)
    worn.ask("right.position.set(right.position.x + 0.4, right.position.y, right.position.z)")
    worn.let_run(0.5)
    assert np.linalg.norm(tool(worn) - before) < 5e-3


def test_the_trigger_hands_over_and_the_headset_feels_it(worn):
    squeeze(worn, 1)
    worn.wait_for("optsc.moment.mode === 'manual'")
    move(worn, 0.0, -0.15, -0.08)
    pulses = worn.ask("pulses.length")
    worn.ask("right.updateButtonValue('trigger', 1)")
    worn.wait_for("optsc.moment.mode === 'approach'")
    worn.ask("right.updateButtonValue('trigger', 0)")
    worn.wait_for(f"pulses.length > {pulses}")
    squeeze(worn, 0)
    worn.wait_for("optsc.moment.one('engaged') === 0")
    squeeze(worn, 1)
    worn.wait_for("optsc.moment.mode === 'manual'")


def test_recentring_makes_forward_what_the_controller_points_at(worn):
    worn.ask("right.quaternion.set(0, Math.SQRT1_2, 0, Math.SQRT1_2)")  # it points at -x
    worn.page.wait_for_timeout(100)
    worn.ask("right.updateButtonValue('thumbstick', 1)")
    worn.wait_for("Math.abs(optsc.headset.heading) > 1.0")
    worn.ask("right.updateButtonValue('thumbstick', 0)")
    before = tool(worn)
    squeeze(worn, 1)
    worn.wait_for("optsc.moment.mode === 'manual'")
    move(worn, -0.08, 0.0, 0.0)
    led_to(worn, before + [0.08, 0.0, 0.0])
