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
import zlib
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from optsc.cache import arrays_of
from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import DepthImage, PinholeCamera, Pose
from optsc.geometry.camera import LARGEST_SIDE
from optsc.geometry.rotation import Array

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
        raise InvalidValue("depth image", str(path), "a .npz file, or a .png file with a .json file beside it")
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


def read_png16(path: str | Path) -> np.ndarray:
    """Return the values of a PNG file with one channel of 16 bits (H, W) uint16.

    Raises:
        DamagedFile: it is missing, no PNG file, damaged, or of another kind; the reason says which.
    """
    from PIL.PngImagePlugin import PngImageFile

    try:
        content = Path(path).read_bytes()
        with PngImageFile(BytesIO(content)) as image:
            _check_png(path, image.mode, image.size, bool(image.info.get("interlace")))
            image.verify()  # checksums, which reading the pixels leaves out
        _check_pixels(path, content, image.size)
        with PngImageFile(BytesIO(content)) as image:
            return np.array(image)
    except (OSError, SyntaxError, ValueError, struct.error, zlib.error) as error:
        raise DamagedFile(path, f"cannot be read as PNG ({error})") from None


def _check_png(path: str | Path, mode: str, size: tuple[int, int], interlaced: bool) -> None:
    if mode != "I;16":
        raise DamagedFile(path, f"pixels of kind {mode!r}; a depth map has one channel of 16 bits ('I;16')")
    if interlaced:
        raise DamagedFile(path, "interlaced; save it without interlacing")
    if max(size) > LARGEST_SIDE:
        raise DamagedFile(path, f"{size[0]} x {size[1]} pixels; at most {LARGEST_SIDE} along each side")


def _check_pixels(path: str | Path, content: bytes, size: tuple[int, int]) -> None:
    """Raise where the chunks hold fewer pixels than the header says: Pillow would take the others for zeros."""
    expected = size[1] * (1 + 2 * size[0])
    stream, kind, count, start = zlib.decompressobj(), b"", 0, 8
    while kind != b"IEND" and count <= expected:
        length, kind = struct.unpack_from(">I4s", content, start)
        if kind == b"IDAT":
            count += len(stream.decompress(content[start + 8 : start + 8 + length], expected + 1 - count))
        start += 12 + length
    if count != expected:
        raise DamagedFile(path, f"holds {count} bytes of pixels, {size[0]} x {size[1]} take {expected}")


def write_png16(path: str | Path, values: np.ndarray) -> None:
    """Write values (H, W) uint16 as a PNG file with one channel of 16 bits; raise `InvalidValue` for others."""
    from PIL import Image

    if values.ndim != 2 or values.dtype != np.uint16 or values.size == 0:
        raise InvalidValue("values", f"{values.dtype}{values.shape}", "uint16, shape (H, W)")
    Image.fromarray(values).save(path, format="PNG")


def _npz(path: Path) -> tuple[Mapping[str, Any], Array]:
    try:
        arrays = arrays_of(path.read_bytes())
        depth, text = np.asarray(arrays["depth"], dtype=float), str(arrays["entries"])
    except FileNotFoundError:
        raise DamagedFile(path, "no such file") from None
    except KeyError as error:
        raise DamagedFile(path, f"lacks an entry ({error.args[0]}); it holds depth and entries") from None
    except (OSError, ValueError, TypeError) as error:
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
        raise InvalidValue(f"camera.{error.field.rpartition('.')[2]}", error.value, error.valid) from None
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
