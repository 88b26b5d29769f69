"""The page in a real browser: a person drives the arm with mouse, keys and gamepad."""

import numpy as np
import pytest
from live_pages import opened

STUB_PAD = """() => {
  const buttons = Array.from({length: 17}, () => ({value: 0, pressed: false}));
  const rumbles = [];
  window.pad = {connected: true, axes: [0, 0, 0, 0], buttons, rumbles};
  window.pad.vibrationActuator = {playEffect: (kind, how) => rumbles.push(how)};
  navigator.getGamepads = () => [window.pad];
}"""
WATCH_STEPS = """() => {
  window.steps = [];
  let last = null;
  const ask = () => {
    const m = optsc.moment;
    if (m && (!last || m.time > last.time)) {
      const p = [...m.of('target')].slice(0, 3);
      if (last) window.steps.push([m.time - last.time, Math.hypot(...p.map((x, k) => x - last.p[k])), m.mode]);
      last = {time: m.time, p};
    }
  };
  setInterval(ask, 4);
}"""


def distance(a, b):
    return float(np.linalg.norm(np.subtract(a, b)))


def test_the_page_opens_and_shows_arm_objects_candidates_and_what_to_do(page):
    assert page.mode == "hold"
    counts = page.ask("[optsc.view.links.length, optsc.view.objects.length, optsc.view.candidates.count]")
    assert counts[0] >= 10
    assert counts[1:] == [3, 450]
    assert page.page.inner_text("#mode") == "Holding still"
    assert "ball" in page.page.inner_text("#coach")
    page.wait_for("optsc.view.ghosts.every((ghost) => ghost.visible)")
    assert page.page.locator("#actions button").count() >= 5


def test_a_dragged_ball_leads_the_arm_and_a_released_one_stops_it(page):
    before = page.tool
    page.drag(60, 80)
    page.wait_for("optsc.moment.mode === 'manual'")
    page.wait_for(f"Math.abs(optsc.moment.of('target')[2] - {before[2]}) > 0.05")
    page.wait_for("optsc.hand.mapped().toArray().every((x, k) => Math.abs(x - optsc.moment.of('target')[k]) < 0.005)")
    assert page.ask("optsc.hand.source") == "mouse"
    page.page.mouse.up()
    page.wait_for("optsc.moment.status === 'at rest'")
    assert page.ask("optsc.hand.source") is None


def test_the_wheel_moves_the_held_ball_in_depth(page):
    page.drag(10, 10)
    before = page.ask("optsc.hand.goal.position.distanceTo(optsc.view.camera.position)")
    page.page.mouse.wheel(0, 200)
    page.wait_for(f"optsc.hand.goal.position.distanceTo(optsc.view.camera.position) < {before} - 0.03")
    page.page.mouse.up()


def test_keys_lead_while_they_are_held(page):
    before = page.tool
    page.page.keyboard.down("KeyQ")
    page.wait_for(f"optsc.moment.of('target')[2] < {before[2]} - 0.04")
    assert page.ask("optsc.hand.source") == "keys"
    page.page.keyboard.up("KeyQ")
    page.wait_for("optsc.hand.source === null && optsc.moment.status === 'at rest'")
    rest = page.tool
    page.let_run(0.3)
    assert distance(page.tool, rest) < 1e-6


def test_a_gamepad_leads_while_its_bumper_is_held_and_rumbles_when_the_mode_changes(page):
    page.ask(STUB_PAD)
    before = page.tool
    page.ask("pad.axes[1] = -1")  # a stick alone moves nothing
    page.let_run(0.2)
    assert page.ask("optsc.hand.source") is None
    page.ask("pad.buttons[4] = {value: 0.5, pressed: false}")  # neither does half a press
    page.let_run(0.1)
    assert page.ask("optsc.hand.source") is None
    page.ask("pad.buttons[4] = {value: 1, pressed: true}")
    page.wait_for(f"Math.hypot(...[0, 1].map((k) => optsc.moment.of('target')[k] - {before}[k])) > 0.04")
    page.ask("pad.buttons[4] = {value: 0.5, pressed: false}")  # a finger that trembles goes on holding
    page.let_run(0.1)
    assert page.ask("optsc.hand.source") == "pad"
    page.ask("pad.buttons[4] = {value: 0, pressed: false}")
    page.wait_for("optsc.hand.source === null")
    assert page.ask("pad.rumbles.length") > 0


def test_the_robot_grasps_and_lifts_on_a_press_of_the_trigger(page):
    page.drag(60, 120)
    page.wait_for("optsc.moment.mode === 'manual'")
    page.page.mouse.up()
    page.page.keyboard.press("Space")
    page.wait_for("optsc.moment.mode === 'approach'")
    page.wait_for("document.getElementById('mode').textContent.startsWith('Robot goes to the ')")
    page.wait_for("optsc.moment.mode === 'carry'")
    page.wait_for("document.getElementById('mode').textContent.endsWith('is lifted')")


def test_taking_the_ball_in_mid_approach_gives_control_back_without_a_jump(page):
    page.ask(WATCH_STEPS)
    page.drag(60, 120)
    page.wait_for("optsc.moment.mode === 'manual'")
    page.page.mouse.up()
    page.page.keyboard.press("Space")
    page.wait_for("optsc.moment.mode === 'approach' && optsc.moment.one('elapsed') > 0")
    page.let_run(0.3)
    page.drag(-60, -30)
    page.wait_for("optsc.moment.mode === 'manual'")
    page.wait_for("Math.hypot(...optsc.moment.of('error').slice(0, 3)) < 0.01")
    page.page.mouse.up()
    steps = np.array([step[:2] for step in page.ask("steps")])
    # As quickly as a hand is led at most: the tool never covered more than its speed allows in the time of a step.
    assert np.all(steps[:, 1] <= 1.2 * steps[:, 0] + 1e-3)


def test_one_short_press_among_many_samples_is_not_lost(page):
    page.drag(10, 40)
    page.wait_for("optsc.moment.mode === 'manual'")
    for mode in ("approach", "manual", "approach", "manual"):
        page.page.keyboard.press("Space")
        page.wait_for(f"optsc.moment.mode === '{mode}'")
        page.let_run(0.2)  # presses that are closer together count as one
    page.page.mouse.up()


def test_sliders_change_which_grasp_is_selected(page):
    page.page.select_option("#rule", "weighted sum")
    page.wait_for("optsc.panel.values.rule === 'weighted sum'")
    seen = set()
    for name, value in (("orientation", 5), ("orientation", 0), ("manipulability", 5), ("position", 10)):
        page.page.locator(f"#set-{name}").fill(str(value))
        page.wait_for(f"optsc.panel.values.{name} === {value}")
        page.let_run(0.4)
        seen.add(tuple(page.ask("Array.from(optsc.moment.of('selected'))")))
    assert len(seen) > 1
    page.page.select_option("#rule", "cascade")
    page.wait_for("optsc.panel.values.rule === 'cascade'")


def test_the_scale_changes_how_far_the_arm_goes_for_the_hand(page):
    page.page.locator("#set-scale").fill("0.5")
    page.wait_for("optsc.hand.scale === 0.5")
    page.let_run(0.2)
    before = page.tool
    page.drag(0, 60)
    page.wait_for("optsc.moment.mode === 'manual'")
    page.wait_for("optsc.hand.position.distanceTo(optsc.hand.goal.position) < 1e-4")
    page.wait_for(f"Math.abs(optsc.moment.of('target')[2] - {before[2]}) > 0.01")
    page.wait_for("Math.hypot(...optsc.moment.of('error').slice(0, 3)) < 1e-3")
    hand = page.ask("optsc.hand.position.distanceTo(optsc.hand.start.hand)")
    assert distance(page.tool, before) == pytest.approx(0.5 * hand, abs=0.012)
    page.page.mouse.up()
    page.page.locator("#set-scale").fill("1")
    page.wait_for("optsc.hand.scale === 1")


def test_a_second_page_watches_until_the_first_is_closed(browser, session, page):
    with opened(browser, f"{session.access.address}?light") as other:
        other.wait_for("document.getElementById('role').textContent.includes('watch')")
        assert other.ask("optsc.hand.drives") is False
        tool = page.tool
        other.page.keyboard.down("KeyQ")
        other.page.keyboard.press("Space")
        other.let_run(0.3)
        other.page.keyboard.up("KeyQ")
        assert page.mode == "hold"
        assert distance(page.tool, tool) < 1e-9
        page.page.close()
        other.page.click("#claim")
        other.wait_for("optsc.hand.drives")


def test_a_page_that_is_closed_while_it_leads_lets_go(browser, session):
    with opened(browser, f"{session.access.address}?light") as leading:
        leading.wait_for("optsc.hand.drives")
        leading.drag(20, 20)
        leading.wait_for("optsc.moment.mode === 'manual' && optsc.moment.one('engaged') === 1")
        leading.page.close()
    with opened(browser, f"{session.access.address}?light") as next_one:
        next_one.wait_for("optsc.moment.one('engaged') === 0 && optsc.moment.status === 'at rest'")


def test_a_hidden_page_lets_go(page):
    page.drag(20, 20)
    page.wait_for("optsc.moment.one('engaged') === 1")
    page.ask(
        "Object.defineProperty(document, 'hidden', {value: true, configurable: true});"
        "dispatchEvent(new Event('visibilitychange'))"
    )
    page.wait_for("optsc.hand.source === null && optsc.moment.one('engaged') === 0")
