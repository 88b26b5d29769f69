"""Page server: serves the page, sends it frames, and takes its messages into the operator's mailbox."""

from __future__ import annotations

import asyncio
import json
import secrets
import ssl
import time
from collections.abc import Callable
from dataclasses import replace
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from websockets.asyncio.server import Server, ServerConnection, broadcast, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from optsc.errors import InvalidValue, OptscError
from optsc.live import site
from optsc.live.access import Access
from optsc.live.clients import LATEST, MOST_REFUSED, Client, Clients
from optsc.live.frames import Frames
from optsc.live.hand_mailbox import HandReading, HandWriter
from optsc.live.layout import SharedParts
from optsc.live.messages import (
    LARGEST_MESSAGE,
    AwayMessage,
    ClaimMessage,
    HandMessage,
    SettingsMessage,
    parsed,
)
from optsc.live.settings_block import COLUMNS as SETTINGS
from optsc.live.settings_block import LiveSettings

FRAME_RATE = 60.0
"""Frames sent a second."""
MOST_UNSENT = 64 * 1024
"""A client with more bytes than this still to be sent is skipped."""
SILENT = 0.25
"""After so long without a tick of the control process the page says so [s]."""
_TOO_MANY = 1008


class PageServer:
    """Serves one scene to any number of pages, one of which drives.

    Args:
        parts: the memory that is shared with the control process.
        frames: makes what is sent.
        access: where and to whom.
        latest: how much longer than the quickest a message of the hand may be on its way [s].
        clock: of arrivals [s]; that of the control process.
    """

    def __init__(
        self,
        parts: SharedParts,
        frames: Frames,
        access: Access,
        latest: float = LATEST,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.access, self._parts, self._frames, self._clock = access, parts, frames, clock
        self._scene, self._latest = frames.scene(), latest
        self._hand = HandWriter(parts.hand)
        self._settings = LiveSettings()
        row = np.zeros(SETTINGS.size)
        if parts.settings.read(row):  # of a server before this one
            self._settings = LiveSettings.of_row(row)
        self._clients = Clients()
        self._open: dict[ServerConnection, Client] = {}
        self._ready: set[ServerConnection] = set()
        self._names = 0

    async def start(self, context: ssl.SSLContext | None = None) -> Server:
        """Begin to serve, and return what does; `access` then has the port."""
        try:
            server = await self._serving(context)
        except OSError as error:
            where = f"{self.access.host}:{self.access.port}"
            raise InvalidValue("address of the page", where, f"one that is free here ({error.strerror})") from None
        self.access = replace(self.access, port=next(iter(server.sockets)).getsockname()[1])
        return server

    async def _serving(self, context: ssl.SSLContext | None) -> Server:
        return await serve(
            self._talk,
            self.access.host,
            self.access.port,
            process_request=self._answer,
            ssl=context,
            max_size=LARGEST_MESSAGE,
            max_queue=32,
            compression=None,
            ping_interval=5.0,
            ping_timeout=10.0,
            open_timeout=5.0,
            close_timeout=1.0,
            server_header=None,
        )

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request for a file, refuse what is not for this page, or let a socket be opened (None)."""
        path = urlsplit(request.path).path
        if not self.access.accepts_host(request.headers.get("Host", "").lower()):
            return _response(HTTPStatus.MISDIRECTED_REQUEST, b"this machine has no such name here\n")
        if path == "/socket":
            if not self.access.accepts_origin(request.headers.get("Origin")):
                return _response(HTTPStatus.FORBIDDEN, b"the socket is for this page alone\n")
            return None if self.access.accepts_token(request.path) else _wrong_token()
        if path == "/":
            if not self.access.accepts_token(request.path):
                return _wrong_token()
            nonce = secrets.token_urlsafe(12)
            return _response(HTTPStatus.OK, site.page(nonce), "text/html; charset=utf-8", nonce)
        found = site.file(path.lstrip("/"))
        if found is None:
            return _response(HTTPStatus.NOT_FOUND, b"there is no such file\n")
        return _response(HTTPStatus.OK, *found)

    async def _talk(self, connection: ServerConnection) -> None:
        self._names += 1
        client = Client(f"page {self._names}")
        self._clients.joined(client)
        self._open[connection] = client
        try:
            await connection.send(self._scene)
            self._say_settings([connection])
            self._clients.claimed(client)
            self._ready.add(connection)
            self._say_roles()
            async for message in connection:
                why = self._hear(client, message)
                if why:
                    client.refused += 1
                    if client.refused % 20 == 1:
                        broadcast([connection], json.dumps({"kind": "refused", "why": why, "count": client.refused}))
                    if client.refused >= MOST_REFUSED:
                        await connection.close(_TOO_MANY, "too many messages that were refused")
        except ConnectionClosed:
            pass
        finally:
            self._open.pop(connection, None)
            self._ready.discard(connection)
            if self._clients.left(client):
                self._hand.let_go()
            self._say_roles()

    def _hear(self, client: Client, text: str | bytes) -> str:
        """Do what a message says, and return why not, in words, where it was refused."""
        now = self._clock()
        if not client.may_speak(now):
            return "more messages than a page has to send"
        try:
            message = parsed(text)
            if isinstance(message, ClaimMessage):
                self._clients.claimed(client)
                self._say_roles()
                return ""
            if self._clients.operator is not client:
                return "this page watches; another one drives"
            if isinstance(message, SettingsMessage):
                self._settings = self._settings.changed(message.values)
                self._parts.settings.write(self._settings.row())
                self._say_settings(list(self._ready))
                return ""
        except OptscError as error:
            return str(error)
        if isinstance(message, AwayMessage):
            self._hand.let_go()
            return ""
        return self._take_hand(client, message, now)

    def _take_hand(self, client: Client, message: HandMessage, now: float) -> str:
        delay = client.delay(message.time, now)
        if delay > self._latest:
            self._hand.let_go()
            return "it comes too late"
        # By the page's own clock: what arrives in bunches was not moved in bunches.
        reading = HandReading(now - delay, message.p, message.q, message.engaged, message.pressed, message.time)
        self._hand.post(reading)
        return ""

    def _say_settings(self, to: list[ServerConnection]) -> None:
        values = {name: getattr(self._settings, name) for name in SETTINGS}
        broadcast(to, json.dumps({"kind": "settings", "values": values}))

    def _say_roles(self) -> None:
        for connection in list(self._ready):
            client, operator = self._open[connection], self._clients.operator
            role: dict[str, Any] = {
                "kind": "role",
                "drives": operator is client,
                "free": operator is None,
                "pages": len(self._clients),
            }
            broadcast([connection], json.dumps(role))

    async def send_frames(self) -> None:
        """Send the newest moment to every page that keeps up, until cancelled."""
        state = np.zeros(self._parts.state.size)
        count, since = 0, self._clock()
        while True:
            await asyncio.sleep(1.0 / FRAME_RATE)
            now, newest = self._clock(), self._parts.state.count
            silent = now - since
            if newest == count and silent < SILENT:
                continue
            if newest != count:
                count, since, silent = newest, now, 0.0
            if not self._parts.state.read(state):
                continue
            listening = []
            for connection in self._ready:
                if connection.transport.get_write_buffer_size() > MOST_UNSENT:
                    self._open[connection].skipped += 1
                else:
                    listening.append(connection)
            if listening:
                broadcast(listening, self._frames.moment(state, silent))


def _response(status: HTTPStatus, body: bytes, kind: str = "text/plain", nonce: str = "") -> Response:
    headers = Headers(site.security_headers(nonce or "none"))
    headers["Content-Type"], headers["Content-Length"] = kind, str(len(body))
    headers["Connection"] = "close"
    return Response(status.value, status.phrase, headers, body)


def _wrong_token() -> Response:
    return _response(HTTPStatus.FORBIDDEN, b"the address needs the token that was printed with it\n")
