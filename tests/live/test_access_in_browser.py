"""Who is let in, in a real browser; and what happens when a process of the session dies."""

import os
import signal
import time

import pytest
from live_pages import PATIENCE, SCENE, opened

from optsc.errors import InvalidValue
from optsc.live.access import Access
from optsc.live.children import Child, ChildFailed
from optsc.live.layout import SharedParts
from optsc.live.live_session import LiveSession
from optsc.live.scene import LiveScene


def until(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "it never came true"
        time.sleep(0.02)


@pytest.fixture(scope="module")
def networked():
    """A session as for the network, at the loopback address: https and a token."""
    with LiveSession(LiveScene(SCENE), Access.network("127.0.0.1"), light=True, say=lambda text: None) as running:
        yield running


def test_over_https_with_a_certificate_of_its_own_the_page_opens_for_whoever_has_the_token(browser, networked):
    with opened(browser, f"{networked.access.address}&light", ignore_https_errors=True) as page:
        assert page.ask("isSecureContext") is True
        page.wait_for("optsc.hand.drives")


def test_a_certificate_that_nobody_trusts_yet_is_not_passed_over_in_silence(browser, networked):
    with browser.new_context() as context, pytest.raises(Exception, match="ERR_CERT"):
        context.new_page().goto(networked.access.address)


@pytest.mark.parametrize("token", ["", "?token=", "?token=guess"])
def test_without_the_token_there_is_no_page(browser, networked, token):
    address = networked.access.address.split("?")[0] + token
    with browser.new_context(ignore_https_errors=True) as context:
        page = context.new_page()
        assert page.goto(address).status == 403
        assert "token" in page.inner_text("body")


def test_another_page_in_the_same_browser_gets_no_socket(browser, networked):
    socket = networked.access.address.replace("https", "wss").replace("/?", "/socket?")
    with browser.new_context(ignore_https_errors=True) as context:
        page = context.new_page()
        page.route("https://evil.example/", lambda route: route.fulfill(body="<p>another page</p>"))
        page.goto("https://evil.example/")
        outcome = page.evaluate(
            "(address) => new Promise((done) => { const socket = new WebSocket(address);"
            "socket.onopen = () => done('open'); socket.onerror = () => done('refused'); })",
            socket,
        )
        assert outcome == "refused"


def test_a_page_server_that_is_killed_begins_again_and_the_page_finds_it(browser, networked):
    with opened(browser, f"{networked.access.address}&light", ignore_https_errors=True) as page:
        page.wait_for("optsc.hand.drives")
        page.drag(20, 20)
        page.wait_for("optsc.moment.mode === 'manual'")
        os.kill(networked.server.pid, signal.SIGKILL)
        page.wait_for("document.getElementById('mode').textContent === 'No connection'")
        before = networked.server.pid
        networked.watch(lambda: networked.server.pid != before)
        page.wait_for("optsc.hand.drives && optsc.moment && optsc.moment.one('engaged') === 0")
        page.page.mouse.up()
        page.drag(-20, 20)
        page.wait_for("optsc.moment.one('engaged') === 1")


def test_a_control_process_that_is_killed_ends_the_session_with_words(browser):
    with LiveSession(LiveScene(SCENE), Access.local(), light=True) as running:
        with opened(browser, f"{running.access.address}?light") as page:
            os.kill(running.control.pid, signal.SIGKILL)
            page.wait_for("document.getElementById('mode').textContent === 'The control process is silent'")
        with pytest.raises(ChildFailed, match="control process ended"):
            running.watch()


def say_parts(say_ready, sizes, name):
    say_ready(SharedParts(sizes, name).segment.name)
    time.sleep(1000.0)


def start_a_child_and_die(say_ready, sizes, name):
    child = Child("grandchild", say_parts, sizes, name)
    child.wait_until_ready()
    say_ready(child.pid)
    os.kill(os.getpid(), signal.SIGKILL)


def fail(say_ready):
    raise InvalidValue("scene", "none", "one")


def die(say_ready):
    os.kill(os.getpid(), signal.SIGKILL)


def is_running(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_children_end_with_a_parent_that_is_killed():
    sizes = LiveScene(SCENE).sizes
    parts = SharedParts(sizes)
    with Child("parent", start_a_child_and_die, sizes, parts.segment.name) as parent:
        grandchild = parent.wait_until_ready()
        until(lambda: not is_running(grandchild))
    parts.segment.close()


def test_a_process_that_cannot_begin_says_why():
    with Child("failing", fail) as child, pytest.raises(ChildFailed, match="scene is 'none'"):
        child.wait_until_ready()
    with Child("dying", die) as child, pytest.raises(ChildFailed, match="ended at once"):
        child.wait_until_ready()
