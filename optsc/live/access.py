"""Access to the page: addresses, origins and the token, so that no other page and no stranger drives the arm."""

from __future__ import annotations

import secrets
import socket
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from hmac import compare_digest
from ipaddress import ip_address
from urllib.parse import parse_qs, urlsplit

from optsc.errors import InvalidValue

LOOPBACK = "127.0.0.1"
LOOPBACK_NAMES = ("127.0.0.1", "localhost", "[::1]")


@dataclass(frozen=True)
class Access:
    """Where the page is served, and to whom.

    Attributes:
        host: address to listen at.
        port: of it; 0 for one that is free.
        token: that has to be in the address of the page; empty where none is needed.
        names: by which this machine may be called.
    """

    host: str = LOOPBACK
    port: int = 0
    token: str = ""
    names: tuple[str, ...] = field(default=LOOPBACK_NAMES)

    @classmethod
    def local(cls, port: int = 0) -> Access:
        """Return access from this machine alone: plain http, which browsers trust there, and no token."""
        return cls(port=_checked_port(port))

    @classmethod
    def network(cls, host: str, port: int = 0) -> Access:
        """Return access from the network, for whoever knows a new random token; raise `InvalidValue`."""
        try:
            address = ip_address(host)
        except ValueError:
            raise InvalidValue("--listen", host, "an IP address of this machine, or 0.0.0.0 for all of them") from None
        own = machine_names() if address.is_unspecified else (_as_host(host), socket.gethostname())
        names = tuple(dict.fromkeys([*own, *LOOPBACK_NAMES]))
        return cls(host, _checked_port(port), secrets.token_urlsafe(16), names)

    @property
    def secure(self) -> bool:
        """Whether the page is served over https: everywhere but on this machine alone."""
        return bool(self.token)

    @property
    def address(self) -> str:
        """The address of the page as it is to be opened."""
        scheme, query = ("https", f"/?token={self.token}") if self.secure else ("http", "/")
        return f"{scheme}://{self.names[0]}:{self.port}{query}"

    def accepts_host(self, host: str | None) -> bool:
        """Tell whether a request was for this machine by one of its names, and no rebound name of a stranger's."""
        return host in self._hosts()

    def accepts_origin(self, origin: str | None) -> bool:
        """Tell whether a socket is asked for by this page, and by no other that is open in the same browser."""
        scheme = "https" if self.secure else "http"
        return origin in {f"{scheme}://{host}" for host in self._hosts()}

    def accepts_token(self, path: str) -> bool:
        """Tell whether the path of a request carries the token, where one is needed."""
        given = parse_qs(urlsplit(path).query).get("token", [""])[-1]
        return not self.token or compare_digest(given.encode(), self.token.encode())

    def _hosts(self) -> set[str]:
        with_port = {f"{name}:{self.port}".lower() for name in self.names}
        default = 443 if self.secure else 80
        return with_port | ({name.lower() for name in self.names} if self.port == default else set())


def machine_names() -> tuple[str, ...]:
    """Return the names and addresses by which others may reach this machine, the most useful first."""
    name = socket.gethostname()
    found = [_outward_address(), name, f"{name}.local"]
    with suppress(OSError):  # a machine whose own name is not known to it is reached by its address
        found += [str(entry[4][0]) for entry in socket.getaddrinfo(name, None, type=socket.SOCK_STREAM)]
    return tuple(dict.fromkeys(_as_host(entry) for entry in found if entry and "%" not in entry))


def _outward_address() -> str:
    """Return this machine's address towards the network; nothing is sent for it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # an address for documentation; a datagram socket only looks up the route
            return str(probe.getsockname()[0])
        except OSError:
            return ""


def _as_host(name: str) -> str:
    return f"[{name}]" if ":" in name and not name.startswith("[") else name


def plain_names(names: Iterable[str]) -> list[str]:
    """Return names as a certificate has them: without the brackets of an address."""
    return [name.strip("[]") for name in names]


def _checked_port(port: int) -> int:
    if not 0 <= port <= 65535:
        raise InvalidValue("--port", port, "0 to 65535")
    return port
