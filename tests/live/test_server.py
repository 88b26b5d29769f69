"""The page server by itself: who is let in, what is refused, and who is skipped."""

import asyncio
import json
import socket
import time
from pathlib import Path

import numpy as np
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from optsc.errors import InvalidValue, UnknownName
from optsc.live import site
from optsc.live.access import Access
from optsc.live.certificates import server_context
from optsc.live.clients import BURST, LATEST, RATE, Client, Clients
from optsc.live.frames import Frames, packed, unpacked
from optsc.live.hand_mailbox import COLUMNS, PRESSABLE
from optsc.live.layout import REASON, SharedParts, text_numbers
from optsc.live.messages import LARGEST_MESSAGE, HandMessage, parsed
from optsc.live.scene import LiveScene, SceneChoice
from optsc.live.server import PageServer
from optsc.live.settings_block import LiveSettings

HAND = {"kind": "hand", "p": [0.1, 0.2, 0.3], "q": [1, 0, 0, 0], "engaged": True, "pressed": [], "time": 1.0}


def hand(**changes):
    return json.dumps({**HAND, "time": time.perf_counter(), **changes})


@pytest.fixture(scope="module")
def scene():
    return LiveScene(SceneChoice(follower="ideal", objects=("can",)))


@pytest.fixture(scope="module")
def frames(scene):
    parts = SharedParts(scene.sizes)
    made = Frames(scene, parts.state_columns, light=True)
    parts.segment.close()
    return made


class Served:
    """A server in this process, whose control process is the test."""

    def __init__(self, scene, frames, access):
        self.scene = scene
        self.parts = SharedParts(scene.sizes)
        self.server = PageServer(self.parts, frames, access)
        self.row = np.zeros(COLUMNS.size)

    def connect(self, origin=None, path="/socket", **options):
        access = self.server.access
        scheme, plain = ("wss", "https") if access.secure else ("ws", "http")
        uri = f"{scheme}://127.0.0.1:{access.port}{path}"
        own = f"{plain}://127.0.0.1:{access.port}"
        return connect(uri, origin=own if origin is None else origin, compression=None, max_size=None, **options)

    def hand(self):
        assert self.parts.hand.read(self.row)
        return self.row

    async def until(self, condition):
        for _ in range(2000):
            if condition():
                return
            await asyncio.sleep(0.005)
        raise AssertionError("it never came true")

    def show(self, value):
        row = np.zeros(self.parts.state.size)
        row[self.parts.state_columns["time"]] = value
        row[self.parts.state_columns["reason"]] = text_numbers(f"moment {value}", REASON)
        self.parts.state.write(row)


def served(scene, frames, test, access=None, context=None):
    async def run():
        rig = Served(scene, frames, access or Access.local())
        sending = None
        try:
            async with await rig.server.start(context):
                sending = asyncio.create_task(rig.server.send_frames())
                await asyncio.wait_for(test(rig), 60.0)
        finally:
            if sending is not None:
                sending.cancel()
            rig.parts.segment.close()

    asyncio.run(run())


async def said(connection, kind):
    """Return the next message of a kind."""
    while True:
        message = await connection.recv()
        if isinstance(message, str) and json.loads(message)["kind"] == kind:
            return json.loads(message)


async def flood(connection):
    for _ in range(20_000):
        await connection.send(hand())
    await said(connection, "nothing")


async def get(rig, path, host=None):
    reader, writer = await asyncio.open_connection("127.0.0.1", rig.server.access.port)
    writer.write(f"GET {path} HTTP/1.1\r\nHost: {host or f'127.0.0.1:{rig.server.access.port}'}\r\n\r\n".encode())
    answer = await reader.read()
    writer.close()
    return answer


def test_the_page_gets_its_scene_then_moments_and_its_hand_reaches_the_mailbox(scene, frames):
    async def test(rig):
        async with rig.connect() as page:
            header, numbers = unpacked(await page.recv())
            assert header["kind"] == "scene"
            assert len(numbers) > 1000
            assert len(header["grasps"]["object"]) == scene.sizes.candidates
            assert (await said(page, "role"))["drives"]
            rig.show(2.5)
            message = await page.recv()
            while isinstance(message, str):
                message = await page.recv()
            header, numbers = unpacked(message)
            assert header["t"] == 2.5
            assert header["reason"] == "moment 2.5"
            await page.send(hand(pressed=["TRIGGER", "NEXT"]))
            await rig.until(lambda: rig.parts.hand.count == 1)
            assert rig.hand()[COLUMNS["p"]].tolist() == [0.1, 0.2, 0.3]
            pressed = rig.hand()[COLUMNS["presses"]]
            assert [name for name, count in zip(PRESSABLE, pressed, strict=True) if count] == ["TRIGGER", "NEXT"]

    served(scene, frames, test)


def test_another_origin_and_another_host_are_refused(scene, frames):
    async def test(rig):
        for origin in ("https://evil.example", "null", f"http://evil.example:{rig.server.access.port}"):
            with pytest.raises(InvalidStatus) as refused:
                async with rig.connect(origin=origin):
                    pass
            assert refused.value.response.status_code == 403
        assert b" 421 " in await get(rig, "/", host=f"rebound.example:{rig.server.access.port}")
        assert b" 200 " in await get(rig, "/")

    served(scene, frames, test)


def test_no_file_outside_of_the_page_is_served(scene, frames):
    async def test(rig):
        for path in (
            "/../server.py",
            "/%2e%2e/server.py",
            "/index.html",
            "/vendor/build.sh",
            "/server.py",
            "//etc/passwd",
        ):
            assert b" 404 " in await get(rig, path)
        assert b" 200 " in await get(rig, "/vendor/three.js")

    served(scene, frames, test)


def test_on_a_network_the_token_is_needed_and_the_certificate_has_the_names(scene, frames, tmp_path):
    import ssl

    access = Access.network("127.0.0.1")
    context = server_context(["127.0.0.1", "localhost"], tmp_path)
    assert list(tmp_path.iterdir()) == []  # no key is left behind
    trusting = ssl.create_default_context()
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE

    async def test(rig):
        for path in ("/socket", "/socket?token=", "/socket?token=wrong"):
            with pytest.raises(InvalidStatus) as refused:
                async with rig.connect(path=path, ssl=trusting):
                    pass
            assert refused.value.response.status_code == 403
        async with rig.connect(path=f"/socket?token={access.token}", ssl=trusting) as page:
            header, _ = unpacked(await page.recv())
            assert header["kind"] == "scene"

    served(scene, frames, test, access, context)


def test_messages_that_are_malformed_are_refused_and_change_nothing(scene, frames):
    async def test(rig):
        async with rig.connect() as page:
            await page.send("{")
            assert (await said(page, "refused"))["why"]
            for bad in (hand(p=[float("nan"), 0, 0]), hand(q=[2, 0, 0, 0]), hand(extra=1), b"\0\1", "[" * 1500):
                await page.send(bad)
            await page.send(hand())
            await rig.until(lambda: rig.parts.hand.count == 1)
            assert rig.parts.settings.count == 0

    served(scene, frames, test)


def test_a_message_that_is_too_large_ends_the_connection_and_lets_go(scene, frames):
    async def test(rig):
        async with rig.connect() as page:
            await page.send(hand())
            await rig.until(lambda: rig.parts.hand.count == 1)
            await page.send("x" * (LARGEST_MESSAGE + 1))
            with pytest.raises(ConnectionClosed):
                await said(page, "nothing")
        await rig.until(lambda: rig.hand()[COLUMNS.at("engaged")] == 0.0)

    served(scene, frames, test)


def test_a_flood_is_refused_and_its_sender_is_sent_away(scene, frames):
    async def test(rig):
        async with rig.connect() as page:
            with pytest.raises(ConnectionClosed):
                await flood(page)
        assert rig.parts.hand.count < 5_000
        async with rig.connect() as page:  # and others are served as before
            assert (await said(page, "role"))["drives"]

    served(scene, frames, test)


def test_one_page_drives_and_the_others_watch_until_it_leaves(scene, frames):
    async def test(rig):
        async with rig.connect() as second:
            async with rig.connect() as first:
                pass
            assert (await said(second, "role"))["drives"]
            async with rig.connect() as first:
                role = await said(first, "role")
                assert not role["drives"]
                assert not role["free"]
                await first.send(hand(pressed=["TRIGGER"]))
                assert "watches" in (await said(first, "refused"))["why"]
                await first.send(json.dumps({"kind": "settings", "values": {"scale": 2.0}}))
                await second.close()
                while not (await said(first, "role"))["free"]:
                    pass
                await first.send(json.dumps({"kind": "claim"}))
                assert (await said(first, "role"))["drives"]
                await first.send(hand())
                await rig.until(lambda: rig.parts.hand.count >= 1)
                assert rig.parts.settings.count == 0

    served(scene, frames, test)


def test_a_page_that_does_not_read_is_skipped_and_the_others_are_not(scene, frames):
    class LargeFrames:
        """The operating system holds megabytes for a page that does not read, so frames of the usual size take long."""

        def moment(self, state, silent):
            return packed({"kind": "moment", "t": float(state[0])}, np.zeros(100_000))

    async def test(rig):
        async with rig.connect(max_queue=1) as slow, rig.connect() as page:
            await said(page, "role")
            rig.server._frames = LargeFrames()
            slow.transport.pause_reading()
            value, clients = 0, rig.server._open
            while not any(client.skipped > 3 for client in clients.values()):
                value += 1
                assert value < 1000
                rig.show(float(value))
                await page.recv()
            before = clients.copy()
            rig.show(1e6)
            while isinstance(message := await page.recv(), str) or unpacked(message)[0]["t"] != 1e6:
                pass
            assert sorted(client.skipped > 3 for client in before.values()) == [False, True]
            slow.transport.abort()

    served(scene, frames, test)


def test_a_page_that_goes_away_lets_go_at_once(scene, frames):
    async def test(rig):
        async with rig.connect() as page:
            await page.send(hand())
            await rig.until(lambda: rig.parts.hand.count == 1)
            await page.send(json.dumps({"kind": "away"}))
            await rig.until(lambda: rig.hand()[COLUMNS.at("engaged")] == 0.0)

    served(scene, frames, test)


def test_a_server_that_takes_the_place_of_one_that_died_goes_on_from_its_settings(scene, frames):
    parts = SharedParts(scene.sizes)
    parts.settings.write(LiveSettings(scale=2.0, restarts=3).row())
    server = PageServer(parts, frames, Access.local())
    assert server._settings == LiveSettings(scale=2.0, restarts=3)
    parts.segment.close()


def test_a_port_that_is_taken_is_said_to_be(scene, frames):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()

        async def test(rig):
            raise AssertionError("it was served")

        with pytest.raises(InvalidValue, match="free"):
            served(scene, frames, test, Access.local(taken.getsockname()[1]))


@pytest.mark.parametrize(
    "changes",
    [
        {"p": [0, 0]},
        {"p": [0, 0, 11]},
        {"p": [0, 0, True]},
        {"p": [0, 0, 10**400]},
        {"p": ["0", 0, 0]},
        {"q": [0, 0, 0, 0]},
        {"engaged": 1},
        {"pressed": ["FIRE"]},
        {"pressed": ["TRIGGER"] * 9},
        {"pressed": "TRIGGER"},
        {"pressed": [[]]},
        {"time": None},
        {"time": float("inf")},
        {"kind": "shell"},
        {"kind": ["hand"]},
        {"more": 1},
    ],
)
def test_a_hand_that_is_none_is_refused(changes):
    with pytest.raises((InvalidValue, UnknownName)):
        parsed(json.dumps({**HAND, **changes}))


def test_a_hand_is_taken_as_it_is():
    message = parsed(json.dumps(HAND))
    assert message == HandMessage((0.1, 0.2, 0.3), (1.0, 0.0, 0.0, 0.0), True, (), 1.0)


def test_a_client_may_send_what_a_headset_does_and_no_flood():
    client, now = Client("page"), 0.0
    for _ in range(1000):
        now += 1.0 / 120.0
        assert client.may_speak(now)
    allowed = sum(client.may_speak(now + 1e-6 * k) for k in range(1000))
    assert allowed <= BURST + 1
    assert client.may_speak(now + 2.0 / RATE)


def test_what_was_queued_during_a_lag_is_known_by_its_delay_whatever_the_clocks_show():
    client = Client("page")
    for k in range(100):
        assert client.delay(5000.0 + 0.01 * k, 1.0 + 0.01 * k + 0.002 * (k % 3)) < 0.01
    assert client.delay(5001.0, 3.0) > LATEST
    assert client.delay(5003.0, 4.01) < 0.03


def test_a_client_that_leaves_frees_the_arm_only_if_it_drove():
    clients, first, second = Clients(), Client("first"), Client("second")
    clients.joined(first)
    clients.joined(second)
    assert clients.claimed(first)
    assert not clients.claimed(second)
    assert not clients.left(second)
    assert clients.left(first)
    assert clients.claimed(second)


def test_a_frame_comes_back_as_it_was_packed():
    header, numbers = unpacked(packed({"kind": "moment", "t": 1.5, "reason": "größer"}, np.arange(5.0)))
    assert header == {"kind": "moment", "t": 1.5, "reason": "größer"}
    assert numbers.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_the_vendored_bundle_is_the_one_that_its_hash_names_with_its_licence():
    import hashlib

    folder = site.FOLDER / "vendor"
    named = (folder / "three.js.sha256").read_text().split()[0]
    assert hashlib.sha256((folder / "three.js").read_bytes()).hexdigest() == named
    assert "MIT" in (folder / "three.LICENSE").read_text()


def test_the_page_asks_for_nothing_from_elsewhere():
    for path in [*site.FOLDER.glob("*.js"), site.FOLDER / "index.html", site.FOLDER / "style.css"]:
        text = Path(path).read_text()
        assert "http:" not in text.replace("http://www.w3.org", "")
        assert "https:" not in text.replace('"https:"', "")


def test_only_an_address_of_this_machine_can_be_listened_at():
    with pytest.raises(InvalidValue, match="--listen"):
        Access.network("robot.local")
    with pytest.raises(InvalidValue, match="--port"):
        Access.local(70000)
    assert len(Access.network("0.0.0.0").token) >= 16
    assert Access.network("0.0.0.0").token != Access.network("0.0.0.0").token
