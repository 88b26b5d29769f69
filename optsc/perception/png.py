"""Depth maps as PNG files: one channel of 16 bits, the form in which depth cameras are recorded."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry.camera import LARGEST_SIDE

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_BYTES = 2


def read_png16(path: str | Path) -> np.ndarray:
    """Return the values of a PNG file with one channel of 16 bits (H, W) uint16.

    Raises:
        DamagedFile: it is missing, no PNG file, damaged, or of another kind; the reason says which.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise DamagedFile(path, f"cannot be read ({error.strerror})") from None
    if not content.startswith(_SIGNATURE):
        raise DamagedFile(path, "not a PNG file")
    header, data = _chunks(path, content)
    width, height, bits, colour, _, _, interlaced = struct.unpack(">IIBBBBB", header)
    if (bits, colour) != (16, 0):
        raise DamagedFile(
            path, f"{bits} bits of colour type {colour}; a depth map has 16 bits of grey (type 0)"
        )
    if interlaced:
        raise DamagedFile(path, "interlaced; save it without interlacing")
    if not (1 <= width <= LARGEST_SIDE and 1 <= height <= LARGEST_SIDE):
        raise DamagedFile(path, f"{width} x {height} pixels; at most {LARGEST_SIDE} along each side")
    size = height * (1 + _BYTES * width)
    try:
        rows = zlib.decompressobj().decompress(data, size + 1)
    except zlib.error as error:
        raise DamagedFile(path, f"damaged ({error})") from None
    if len(rows) != size:
        raise DamagedFile(path, f"holds {len(rows)} bytes of pixels, {width} x {height} take {size}")
    table = np.frombuffer(rows, np.uint8).reshape(height, 1 + _BYTES * width)
    if table[:, 0].max() > 4:
        raise DamagedFile(path, f"damaged (row filter {int(table[:, 0].max())})")
    return _unfiltered(table).view(">u2").astype(np.uint16)


def _chunks(path: str | Path, content: bytes) -> tuple[bytes, bytes]:
    """Return the header and the compressed pixels."""
    header, data, start, ended = b"", [], len(_SIGNATURE), False
    while start + 12 <= len(content):
        (length,) = struct.unpack_from(">I", content, start)
        kind, body = content[start + 4 : start + 8], content[start + 8 : start + 8 + length]
        if len(body) < length or start + 12 + length > len(content):
            raise DamagedFile(path, "ends early")
        if struct.unpack_from(">I", content, start + 8 + length)[0] != zlib.crc32(kind + body):
            raise DamagedFile(path, f"damaged (checksum of {kind.decode('ascii', 'replace')})")
        if kind == b"IHDR" and length == 13:
            header = body
        elif kind == b"IDAT":
            data.append(body)
        elif kind == b"IEND":
            ended = True
            break
        start += 12 + length
    if not header or not data or not ended:
        raise DamagedFile(path, "ends early")
    return header, b"".join(data)


def _unfiltered(table: np.ndarray) -> np.ndarray:
    """Return the bytes of all rows; PNG stores a row as differences to the bytes to the left and above."""
    result = np.zeros((len(table), table.shape[1] - 1), dtype=np.uint8)
    above = np.zeros(table.shape[1] - 1, dtype=np.uint8)
    for k, (kind, *_) in enumerate(table[:, :1].tolist()):
        row = table[k, 1:]
        if kind == 1:
            row = np.cumsum(row.reshape(-1, _BYTES), axis=0, dtype=np.uint8).ravel()
        elif kind == 2:
            row = row + above
        elif kind >= 3:
            row = _predicted(row.tolist(), above.tolist(), kind)
        result[k] = above = row
    return result


def _predicted(row: list[int], above: list[int], kind: int) -> np.ndarray:
    """Undo the filters that predict a byte from those already known: their average, or Paeth's choice."""
    done = [0] * _BYTES + row
    corner = [0] * _BYTES + above
    for i, value in enumerate(row):
        left, up, diagonal = done[i], above[i], corner[i]
        if kind == 3:
            guess = (left + up) // 2
        else:
            estimate = left + up - diagonal
            off = (abs(estimate - left), abs(estimate - up), abs(estimate - diagonal))
            guess = (left, up, diagonal)[off.index(min(off))]
        done[i + _BYTES] = (value + guess) & 0xFF
    return np.array(done[_BYTES:], dtype=np.uint8)


def write_png16(path: str | Path, values: np.ndarray) -> None:
    """Write values (H, W) uint16 as a PNG file with one channel of 16 bits; raise `InvalidValue` if none."""
    if values.ndim != 2 or values.dtype != np.uint16 or values.size == 0:
        raise InvalidValue("values", f"{values.dtype}{values.shape}", "uint16, shape (H, W)")
    height, width = values.shape
    rows = np.insert(values.astype(">u2").view(np.uint8).reshape(height, -1), 0, 0, axis=1)  # no filter

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    parts = (chunk(b"IHDR", header), chunk(b"IDAT", zlib.compress(rows.tobytes(), 6)), chunk(b"IEND", b""))
    Path(path).write_bytes(_SIGNATURE + b"".join(parts))
