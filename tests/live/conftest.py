"""A live session with a page in a real browser; one session for all tests of a file."""

import os
import shutil

import pytest
from live_pages import SCENE, begin_again, opened

from optsc.live.access import Access
from optsc.live.live_session import LiveSession
from optsc.live.scene import LiveScene

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="session")
def browser():
    path = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if path is None:
        reason = f"no browser here: none of {', '.join(BROWSERS)} is installed"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as driver:
        launched = driver.chromium.launch(executable_path=path, args=ARGUMENTS)
        yield launched
        launched.close()


@pytest.fixture(scope="module")
def session():
    with LiveSession(LiveScene(SCENE), Access.local(), light=True) as running:
        yield running


@pytest.fixture
def page(browser, session):
    with opened(browser, f"{session.access.address}?light") as shown:
        shown.wait_for("optsc.hand.drives")
        begin_again(shown)
        yield shown
