import json
import struct
import zlib

import numpy as np
import pytest

from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import DepthImage, PinholeCamera, look_at
from optsc.perception import load_depth_image, save_depth_image
from optsc.perception.depth_files import read_png16, write_png16

RNG = np.random.default_rng(0)
VALUES = RNG.integers(0, 65536, (7, 5), dtype=np.uint16)


@pytest.fixture
def image():
    depth = RNG.uniform(0.4, 2.0, (6, 8))
    depth[2, 3] = np.nan
    camera = PinholeCamera(8, 6, 9.5, 9.25, 3.5, 2.75)
    return DepthImage(depth, camera, look_at([1.0, 0.2, 0.6], [0.4, 0.0, 0.0]), 12.5)


def test_an_npz_file_keeps_every_bit(tmp_path, image):
    save_depth_image(tmp_path / "view.npz", image)
    loaded = load_depth_image(tmp_path / "view.npz")
    assert loaded.depth.tobytes() == image.depth.tobytes()
    assert loaded.camera == image.camera
    assert loaded.stamp == 12.5
    assert loaded.X_WC.almost_equal(image.X_WC)


def test_a_png_file_keeps_millimetres_and_what_was_not_measured(tmp_path, image):
    save_depth_image(tmp_path / "view.png", image)
    loaded = load_depth_image(tmp_path / "view.png")
    np.testing.assert_array_equal(np.isnan(loaded.depth), np.isnan(image.depth))
    assert np.nanmax(np.abs(loaded.depth - image.depth)) <= 0.5e-3 + 1e-9
    assert loaded.camera == image.camera


def filtered(values, kind):
    """Return the rows of a PNG file with one of its five filters, straight from the standard's definitions."""
    rows = values.astype(">u2").view(np.uint8).reshape(len(values), -1).astype(int)
    result = []
    for k, row in enumerate(rows):
        above = rows[k - 1] if k else np.zeros_like(row)
        left, corner = (np.concatenate([[0, 0], a[:-2]]) for a in (row, above))
        estimate = left + above - corner
        off = np.abs([estimate - left, estimate - above, estimate - corner])
        paeth = np.choose(np.argmin(off, axis=0), [left, above, corner])
        predicted = [0 * row, left, above, (left + above) // 2, paeth][kind]
        result.append(np.concatenate([[kind], (row - predicted) % 256]).astype(np.uint8))
    return np.array(result)


def png(rows, width, height, bits=16, colour=0, interlaced=0):
    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, interlaced)
    body = zlib.compress(rows.tobytes())
    parts = chunk(b"IHDR", header) + chunk(b"IDAT", body[:9]) + chunk(b"IDAT", body[9:]) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + parts


@pytest.mark.parametrize("kind", range(5))
def test_every_filter_of_png_is_undone(tmp_path, kind):
    path = tmp_path / "depth.png"
    path.write_bytes(png(filtered(VALUES, kind), 5, 7))
    np.testing.assert_array_equal(read_png16(path), VALUES)


def test_a_written_png_file_is_read_back_and_by_others_too(tmp_path):
    from matplotlib import image as reader

    path = tmp_path / "depth.png"
    write_png16(path, VALUES)
    np.testing.assert_array_equal(read_png16(path), VALUES)
    np.testing.assert_allclose(reader.imread(path) * 65535.0, VALUES, atol=0.01)
    with pytest.raises(InvalidValue):
        write_png16(path, VALUES.astype(float))


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"GIF89a", "not a PNG"),
        (png(filtered(VALUES, 0), 5, 7)[:60], "broken PNG file"),
        (png(filtered(VALUES, 0), 5, 8), "take 88"),
        (png(filtered(VALUES, 0), 5, 7, bits=8), "kind 'L'"),
        (png(filtered(VALUES, 0), 5, 7, colour=2), "kind 'RGB'"),
        (png(filtered(VALUES, 0), 5, 7, interlaced=1), "interlaced"),
        (png(filtered(VALUES, 0), 100_000, 7), "at most 8192"),
        (png(filtered(VALUES, 0) + 9, 5, 7), "unrecognized data"),
        (png(filtered(VALUES, 0), 5, 7).replace(b"IDAT", b"IDAx", 1), "checksum"),
        (png(filtered(VALUES, 0), 5, 7)[:-20], "cannot be read as PNG"),
        (png(filtered(VALUES, 0), 5, 7).replace(b"IDAT", b"IDAT\x99", 1), "cannot be read as PNG"),
    ],
)
def test_what_is_no_depth_map_is_refused_with_the_reason(tmp_path, content, reason):
    path = tmp_path / "depth.png"
    path.write_bytes(content)
    with pytest.raises(DamagedFile, match=reason):
        read_png16(path)


def stored(tmp_path, image, **changes):
    """Write an image as PNG and JSON and change entries of the JSON file; None takes one out."""
    path = tmp_path / "view.png"
    save_depth_image(path, image)
    entries = json.loads(path.with_suffix(".json").read_text())
    for name, value in changes.items():
        *parents, last = name.split("__")
        part = entries
        for parent in parents:
            part = part[parent]
        if value is None:
            del part[last]
        else:
            part[last] = value
    path.with_suffix(".json").write_text(json.dumps(entries))
    return path


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"camera__fx": None}, "camera.fx is None"),
        ({"camera__fx": "wide"}, "camera.fx is 'wide'"),
        ({"camera__fx": 0.6}, "camera.fx is 0.6.*millimetres or a share"),
        ({"camera__fx": float("nan")}, "camera.fx is nan"),
        ({"camera__width": 8.5}, "camera.width is 8.5"),
        ({"camera__width": 9}, "shape of depth"),
        ({"camera": None}, "camera.fx is None"),
        ({"X_WC": None}, "X_WC.quaternion is None"),
        ({"X_WC__quaternion": [1, 0, 0]}, "X_WC.quaternion"),
        ({"X_WC__quaternion": [2.0, 0.0, 0.0, 0.0]}, "X_WC.quaternion"),
        ({"X_WC__translation": ["a", 0, 0]}, "X_WC.translation"),
        ({"X_WC__translation": [1000.0, 200.0, 600.0]}, "X_WC.translation.*in millimetres?"),
        ({"depth_unit": 1.0}, "millimetres.*Then depth_unit is 0.001"),
        ({"depth_unit": 1e-6}, "in metres already"),
        ({"depth_unit": 0.0}, "depth_unit is 0.0"),
        ({"depth_unit": True}, "depth_unit is True"),
        ({"stamp": 10**400}, "stamp is"),
    ],
)
def test_a_wrong_entry_is_named_with_its_value(tmp_path, image, changes, message):
    with pytest.raises(InvalidValue, match=message):
        load_depth_image(stored(tmp_path, image, **changes))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"version": 2}, "newer version"),
        ({"version": "1"}, "version is '1'"),
        ({"format": "ply"}, "format is 'ply'"),
    ],
)
def test_a_file_of_another_format_or_a_newer_version_is_refused(tmp_path, image, changes, reason):
    with pytest.raises(DamagedFile, match=reason):
        load_depth_image(stored(tmp_path, image, **changes))


def test_depths_in_millimetres_given_as_metres_are_suspected_and_named(tmp_path, image):
    far = DepthImage(1e3 * image.depth, image.camera, image.X_WC)
    save_depth_image(tmp_path / "view.npz", far)
    with pytest.raises(InvalidValue, match="are the depths in millimetres"):
        load_depth_image(tmp_path / "view.npz")


def test_an_image_without_a_single_depth_can_be_loaded(tmp_path, image):
    empty = DepthImage(np.full(image.depth.shape, np.nan), image.camera, image.X_WC)
    for name in ("view.npz", "view.png"):
        save_depth_image(tmp_path / name, empty)
        assert not load_depth_image(tmp_path / name).measured.any()


def test_missing_and_damaged_files_say_so(tmp_path, image):
    path = stored(tmp_path, image)
    path.with_suffix(".json").write_text("{")
    with pytest.raises(DamagedFile, match="no JSON"):
        load_depth_image(path)
    path.with_suffix(".json").write_text("[]")
    with pytest.raises(DamagedFile, match="no JSON object"):
        load_depth_image(path)
    path.with_suffix(".json").unlink()
    with pytest.raises(DamagedFile, match="where the camera"):
        load_depth_image(path)
    for name in ("none.npz", "none.png"):
        with pytest.raises(DamagedFile):
            load_depth_image(tmp_path / name)
    (tmp_path / "other.npz").write_bytes(b"PK\x03\x04 nonsense")
    with pytest.raises(DamagedFile, match="npz"):
        load_depth_image(tmp_path / "other.npz")
    np.savez(tmp_path / "lacking.npz", depth=image.depth)
    with pytest.raises(DamagedFile, match="lacks an entry"):
        load_depth_image(tmp_path / "lacking.npz")
    for use in (lambda p: load_depth_image(p), lambda p: save_depth_image(p, image)):
        with pytest.raises(InvalidValue, match="npz"):
            use(tmp_path / "view.tiff")


def test_negative_depths_are_refused(tmp_path, image):
    save_depth_image(tmp_path / "view.npz", image)
    with np.load(tmp_path / "view.npz") as file:
        np.savez(tmp_path / "wrong.npz", depth=-file["depth"], entries=file["entries"])
    with pytest.raises(InvalidValue, match="0 or more"):
        load_depth_image(tmp_path / "wrong.npz")
