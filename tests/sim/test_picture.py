import struct
import zlib

import numpy as np
import pytest

from optsc.errors import Closed, InvalidValue, UnknownName
from optsc.geometry import Pose
from optsc.robot import load_robot
from optsc.sim import Tabletop, object_model
from optsc.sim.picture import Renderer, Viewpoint, save_png

SMALL = {"width": 160, "height": 120, "samples": 1}


@pytest.fixture(scope="module")
def world():
    return Tabletop(
        load_robot("iiwa"), {"can": object_model("can")}, {"can": Pose.from_translation([0.6, 0.1, 0.0])}
    )


@pytest.fixture(scope="module")
def renderer(world):
    with Renderer(world) as renderer:
        yield renderer


def red(picture):
    """Return the pixels of the can: rows and columns."""
    values = picture.astype(int)
    return np.argwhere((values[..., 0] > 100) & (values[..., 1] < 90) & (values[..., 2] < 90))


def test_the_same_world_gives_the_same_picture(renderer, world):
    first = renderer.picture(world.robot.home, **SMALL)
    assert first.shape == (120, 160, 3)
    assert first.dtype == np.uint8
    assert first.tobytes() == renderer.picture(world.robot.home, **SMALL).tobytes()


def test_an_object_is_seen_where_it_is(renderer, world):
    above = Viewpoint(eye=(0.6, -0.001, 1.5), target=(0.6, 0.0, 0.0), field_of_view=0.5)
    seen = {}
    for y in (-0.1, 0.1):
        X_WO = {"can": Pose.from_translation([0.6, y, 0.0])}
        folded = world.robot.home * [0, -1, 0, 1, 0, 1, 0]
        seen[y] = red(renderer.picture(folded, X_WO=X_WO, viewpoint=above, **SMALL))
        assert len(seen[y]) > 20
    # Seen from above with +y upwards: the can further along y is higher in the picture, in the same column.
    assert seen[0.1][:, 0].mean() < seen[-0.1][:, 0].mean() - 20
    assert seen[0.1][:, 1].mean() == pytest.approx(seen[-0.1][:, 1].mean(), abs=3)


def test_the_arm_is_seen_where_it_is(renderer, world):
    home = renderer.picture(world.robot.home, **SMALL)
    assert np.mean(home != renderer.picture(world.robot.home + 0.3, **SMALL)) > 0.02


def test_what_cannot_be_drawn_is_refused(renderer, world):
    with pytest.raises(InvalidValue, match="width"):
        renderer.picture(world.robot.home, width=0)
    with pytest.raises(InvalidValue, match="q"):
        renderer.picture(world.robot.home[:-1])
    with pytest.raises(UnknownName, match="teapot"):
        renderer.picture(world.robot.home, X_WO={"teapot": Pose.identity()})


def test_a_closed_renderer_says_so(world):
    renderer = Renderer(world)
    renderer.close()
    renderer.close()
    with pytest.raises(Closed):
        renderer.picture(world.robot.home)


def test_a_saved_picture_holds_its_pixels(tmp_path):
    image = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    save_png(tmp_path / "picture.png", image)
    content = (tmp_path / "picture.png").read_bytes()
    assert struct.unpack(">II", content[16:24]) == (7, 5)
    start = content.index(b"IDAT")
    (length,) = struct.unpack(">I", content[start - 4 : start])
    rows = np.frombuffer(zlib.decompress(content[start + 4 : start + 4 + length]), np.uint8).reshape(5, -1)
    np.testing.assert_array_equal(rows[:, 1:].reshape(image.shape), image)
    with pytest.raises(InvalidValue):
        save_png(tmp_path / "wrong.png", image[..., :2])
