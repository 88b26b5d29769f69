"""Recorded depth images: a file of depths with the camera's intrinsics and pose.

Two forms. An ``.npz`` file holds everything: ``depth`` (H, W) and the entries of the JSON file below. A ``.png``
file of 16 bits holds depths in millimetres, 0 where nothing was measured; beside it, with the same name, a
``.json`` file says where the camera stands::

    {"format": "optsc depth image", "version": 1,
     "camera": {"width": 640, "height": 480, "fx": 609.5, "fy": 609.5, "cx": 319.5, "cy": 239.5},
     "X_WC": {"quaternion": [1, 0, 0, 0], "translation": [0, 0, 1]},
     "depth_unit": 0.001, "stamp": 0.0}

C is the camera's frame: z forward, x right, y down; pixels have whole coordinates at their centres. Quaternions are
w, x, y, z; lengths are in metres. ``depth_unit`` [m] is what one unit of the depths is: 0.001 for PNG and 1 for npz
files by default. ``stamp`` [s] is optional.
"""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import DepthImage, PinholeCamera, Pose
from optsc.geometry.camera import LARGEST_SIDE
from optsc.geometry.rotation import Array

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
            predicted = (left + up) // 2
        else:
            estimate = left + up - diagonal
            off = (abs(estimate - left), abs(estimate - up), abs(estimate - diagonal))
            predicted = (left, up, diagonal)[off.index(min(off))]
        done[i + _BYTES] = (value + predicted) & 0xFF
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


FORMAT, VERSION = "optsc depth image", 1
FARTHEST = 50.0
"""A median depth beyond this is taken for another unit [m]: no depth camera for a table sees so far."""
NEAREST = 0.02
"""So is one below this [m]."""


def load_depth_image(path: str | Path) -> DepthImage:
    """Return a recorded depth image from an ``.npz`` file, or from a ``.png`` with a ``.json`` beside it.

    An image in which nothing was measured is an image, too.

    Raises:
        DamagedFile: a file is missing, damaged, or written by a newer version.
        InvalidValue: an entry that is missing or out of range, a pose that is none, or depths that seem to be in
            another unit: it names the entry, its value and what would be valid.
    """
    path = Path(path)
    if path.suffix == ".npz":
        entries, depth, unit = *_npz(path), 1.0
    elif path.suffix == ".png":
        depth, entries, unit = read_png16(path).astype(float), _json(path.with_suffix(".json")), 1e-3
    else:
        raise InvalidValue(
            "depth image", str(path), "a .npz file, or a .png file with a .json file beside it"
        )
    _check_format(path, entries)
    unit = _number(entries, "depth_unit", unit)
    if not 1e-6 <= unit <= 1.0:
        raise InvalidValue("depth_unit", unit, "metres per unit of depth, 0.000001 to 1")
    camera = _camera(entries)
    if depth.shape != (camera.height, camera.width):
        valid = f"{camera.height} rows of {camera.width}, as camera.height and camera.width say"
        raise InvalidValue("shape of depth", depth.shape, valid)
    if np.isneginf(depth).any() or (depth < 0.0).any():
        raise InvalidValue("depth", float(np.nanmin(depth)), "0 or more; 0 or NaN where not measured")
    metres = np.where((depth > 0.0) & (depth < np.inf), depth * unit, np.nan)
    _check_unit(metres, unit)
    return DepthImage(metres, camera, _pose(entries), _number(entries, "stamp", 0.0))


def save_depth_image(path: str | Path, image: DepthImage) -> None:
    """Write a depth image so that `load_depth_image` returns it: ``.npz``, or ``.png`` with a ``.json`` beside it.

    An ``.npz`` file keeps every bit; a ``.png`` file rounds to millimetres, and what is farther than 65.5 m is lost.

    Raises:
        InvalidValue: another ending.
    """
    path = Path(path)
    entries = _entries(image)
    if path.suffix == ".npz":
        text = np.array(json.dumps({**entries, "depth_unit": 1.0}))
        np.savez_compressed(path, depth=image.depth, entries=text)
    elif path.suffix == ".png":
        millimetres = np.round(1e3 * np.nan_to_num(image.depth, nan=0.0))
        write_png16(path, np.where(millimetres <= 65535, millimetres, 0).astype(np.uint16))
        path.with_suffix(".json").write_text(json.dumps({**entries, "depth_unit": 1e-3}, indent=2) + "\n")
    else:
        raise InvalidValue("depth image", str(path), "a path that ends in .npz or .png")


def _entries(image: DepthImage) -> dict[str, object]:
    camera = {name: getattr(image.camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    pose = {
        "quaternion": image.X_WC.quaternion.tolist(),
        "translation": image.X_WC.translation.tolist(),
    }
    return {"format": FORMAT, "version": VERSION, "camera": camera, "X_WC": pose, "stamp": image.stamp}


def _npz(path: Path) -> tuple[Mapping[str, Any], Array]:
    try:
        with np.load(path, allow_pickle=False) as file:
            depth, text = np.asarray(file["depth"], dtype=float), str(file["entries"])
    except FileNotFoundError:
        raise DamagedFile(path, "no such file") from None
    except KeyError as error:
        raise DamagedFile(path, f"lacks an entry ({error.args[0]}); it holds depth and entries") from None
    except (OSError, ValueError, TypeError, EOFError, zlib.error, zipfile.BadZipFile) as error:
        raise DamagedFile(path, f"cannot be read as npz ({error})") from None
    return _parsed(path, text), depth


def _json(path: Path) -> Mapping[str, Any]:
    try:
        return _parsed(path, path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DamagedFile(path, "no such file: it says where the camera of the .png file stands") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DamagedFile(path, f"cannot be read ({error})") from None


def _parsed(path: Path, text: str) -> Mapping[str, Any]:
    try:
        entries = json.loads(text)
    except json.JSONDecodeError as error:
        raise DamagedFile(path, f"no JSON (line {error.lineno}: {error.msg})") from None
    if not isinstance(entries, dict):
        raise DamagedFile(path, "no JSON object")
    return entries


def _check_format(path: Path, entries: Mapping[str, Any]) -> None:
    name, version = entries.get("format"), entries.get("version")
    if name != FORMAT:
        raise DamagedFile(path, f"its format is {name!r} instead of {FORMAT!r}")
    if not isinstance(version, int) or version < 1:
        raise DamagedFile(path, f"its version is {version!r} instead of a whole number")
    if version > VERSION:
        raise DamagedFile(path, f"written by a newer version ({version}); this one reads up to {VERSION}")


def _entry(entries: Mapping[str, Any], name: str) -> Any:
    value: Any = entries
    for part in name.split("."):
        if not isinstance(value, Mapping) or part not in value:
            raise InvalidValue(name, None, "an entry of that name")
        value = value[part]
    return value


def _number(entries: Mapping[str, Any], name: str, default: float | None = None) -> float:
    if default is not None and name not in entries:
        return default
    value = _entry(entries, name)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < 1e300:
        raise InvalidValue(name, value, "a finite number")
    return float(value)


def _camera(entries: Mapping[str, Any]) -> PinholeCamera:
    focal = {name: _number(entries, f"camera.{name}") for name in ("fx", "fy", "cx", "cy")}
    width, height = (_entry(entries, f"camera.{name}") for name in ("width", "height"))
    try:
        camera = PinholeCamera(width, height, **focal)
    except InvalidValue as error:
        raise InvalidValue(f"camera.{error.field}", error.value, error.valid) from None
    for name, side in (("fx", camera.width), ("fy", camera.height)):
        if focal[name] < 0.1 * side:
            valid = f"pixels, {0.1 * side:g} or more for {side} pixels; millimetres or a share of the image?"
            raise InvalidValue(f"camera.{name}", focal[name], valid)
    return camera


def _pose(entries: Mapping[str, Any]) -> Pose:
    parts = []
    for name, count in (("X_WC.quaternion", 4), ("X_WC.translation", 3)):
        value = _entry(entries, name)
        try:
            array = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            array = np.full(0, np.nan)
        if array.shape != (count,) or not np.isfinite(array).all():
            raise InvalidValue(name, value, f"{count} finite numbers")
        parts.append(array)
    distance = float(np.linalg.norm(parts[1]))
    if distance > FARTHEST:
        valid = f"metres, within {FARTHEST:g} m of the arm's base; is it in millimetres?"
        raise InvalidValue("X_WC.translation", parts[1].tolist(), valid)
    try:
        return Pose.from_quaternion(*parts)
    except InvalidValue as error:
        raise InvalidValue("X_WC.quaternion", error.value, error.valid) from None


def _check_unit(depth: Array, unit: float) -> None:
    measured = depth[~np.isnan(depth)]
    if len(measured) == 0:
        return
    middle = float(np.median(measured))
    if middle > FARTHEST:
        valid = f"up to {FARTHEST:g} m; are the depths in millimetres? Then depth_unit is {unit * 1e-3:g}"
        raise InvalidValue("median of the depths [m]", middle, valid)
    if middle < NEAREST:
        valid = f"at least {NEAREST:g} m; are the depths in metres already? Then depth_unit is {unit * 1e3:g}"
        raise InvalidValue("median of the depths [m]", middle, valid)
