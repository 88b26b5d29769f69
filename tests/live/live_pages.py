"""A page that is open in a real browser, with what a person sees and does there."""

import time
from contextlib import contextmanager

from optsc.live.scene import SceneChoice

PATIENCE = 60.0
"""How long anything may take on a machine that does other things too [s]; nothing is asserted about time."""
SCENE = SceneChoice(follower="ideal", timeout=2.0)


class Page:
    """A page that is open, with what a person sees and does there."""

    def __init__(self, page):
        self.page, self.problems = page, []
        page.on("pageerror", lambda error: self.problems.append(str(error)))
        page.set_default_timeout(PATIENCE * 1000)

    def ask(self, expression):
        return self.page.evaluate(expression)

    def wait_for(self, expression):
        end = time.monotonic() + PATIENCE
        while not self.ask(expression):
            assert time.monotonic() < end, f"never came true: {expression}; {self.now()}"
            self.page.wait_for_timeout(30)

    def now(self):
        return self.ask("optsc.moment && [optsc.moment.mode, optsc.moment.status, optsc.moment.reason]")

    @property
    def mode(self):
        return self.ask("optsc.moment.mode")

    @property
    def tool(self):
        return self.ask("Array.from(optsc.moment.of('target'))")[:3]

    def let_run(self, duration):
        """Wait for a duration [s] of the arm's own time, which is less than the clock's on a loaded machine."""
        self.wait_for(f"optsc.moment && optsc.moment.time > {self.ask('optsc.moment.time')} + {duration}")

    def grab(self):
        """Press the mouse on the ball, which may still be on its way to the tool; return where that is [pixels]."""
        end = time.monotonic() + PATIENCE
        while True:
            at = self.ask("optsc.view.onScreen(optsc.handle.group.position.toArray())")
            self.page.mouse.move(at["x"], at["y"])
            self.page.mouse.down()
            self.page.wait_for_timeout(60)
            if self.ask("optsc.hand.source === 'mouse'"):
                return at["x"], at["y"]
            assert time.monotonic() < end, f"the ball cannot be taken; {self.now()}"
            self.page.mouse.up()
            self.page.wait_for_timeout(60)

    def drag(self, x, y, steps=8):
        """Move the held ball by pixels; return where the mouse is then."""
        left, top = self.grab()
        for k in range(1, steps + 1):
            self.page.mouse.move(left + x * k / steps, top + y * k / steps)
            self.page.wait_for_timeout(20)


@contextmanager
def opened(browser, address, ready=True, wear=None, **options):
    """Open a page; ``wear`` is a script that runs in it before its own."""
    context = browser.new_context(viewport={"width": 960, "height": 640}, **options)
    if wear is not None:
        context.add_init_script(wear)
    page = Page(context.new_page())
    try:
        page.page.goto(address)
        if ready:
            page.wait_for("Boolean(window.optsc && optsc.moment)")
        yield page
        assert page.problems == []
    finally:
        context.close()


def begin_again(page):
    count = page.ask("optsc.panel.values.restarts")
    page.page.click("[data-action=AGAIN]")
    page.wait_for(f"optsc.moment.settings.restarts > {count} && optsc.moment.mode === 'hold'")
