"""The files of the page: served one by one, or put into one file together with a recorded stream."""

from __future__ import annotations

import base64
import json
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).parent / "page"
MODULES = {
    "three": "vendor/three.js",
    **{f"optsc/{path.stem}": path.name for path in sorted(FOLDER.glob("*.js"))},
}
"""Names under which modules of the page import each other, and their files."""
_TYPES = {".js": "text/javascript", ".css": "text/css", ".html": "text/html"}
_HOLES = ("<!--styles-->", "<!--modules-->", "<!--stream-->")


@cache
def file(path: str) -> tuple[bytes, str] | None:
    """Return content and type of a file of the page that may be served by itself; None for anything else."""
    if path not in {*MODULES.values(), "style.css"}:
        return None
    return (FOLDER / path).read_bytes(), f"{_TYPES[Path(path).suffix]}; charset=utf-8"


def page(nonce: str) -> bytes:
    """Return the page that asks for its files; ``nonce`` lets the browser tell its own script from any other."""
    modules = {name: f"./{path}" for name, path in MODULES.items()}
    script = f'<script type="importmap" nonce="{nonce}">{json.dumps({"imports": modules})}</script>'
    main = f'<script type="module" nonce="{nonce}">import "optsc/main";</script>'
    return _filled('<link rel="stylesheet" href="./style.css">', script + main, "")


def single_file(stream: bytes) -> bytes:
    """Return the page with everything in it, and a recorded stream to play: it asks for nothing.

    ``stream`` is frames one after the other, each behind its length in four bytes, little endian.
    """
    style = f"<style>{(FOLDER / 'style.css').read_text(encoding='utf-8')}</style>"
    modules = {
        name: "data:text/javascript;base64," + base64.b64encode((FOLDER / path).read_bytes()).decode()
        for name, path in MODULES.items()
    }
    script = f'<script type="importmap">{json.dumps({"imports": modules})}</script>'
    main = '<script type="module">import "optsc/main";</script>'
    data = f'<script type="application/octet-stream" id="stream">{base64.b64encode(stream).decode()}</script>'
    return _filled(style, script + main, data)


def _filled(*parts: str) -> bytes:
    text = (FOLDER / "index.html").read_text(encoding="utf-8")
    for hole, part in zip(_HOLES, parts, strict=True):
        before, after = text.split(hole)
        text = before + part + after
    return text.encode()


def security_headers(nonce: str) -> dict[str, str]:
    """Return headers that let the page run its own files alone, and no other page put it into a frame."""
    policy = (
        f"default-src 'none'; script-src 'self' 'nonce-{nonce}'; style-src 'self' 'unsafe-inline'; "
        "img-src 'self' data: blob:; connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    )
    return {
        "Content-Security-Policy": policy,
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cache-Control": "no-store",
    }
