"""What is kept of a template between processes, and what becomes of a damaged file."""

import numpy as np
import pytest

from optsc.perception import template_from_mesh
from optsc.perception import templates as module
from optsc.sim.objects.solids import cuboid

BOX = cuboid([-0.02, -0.03, 0.0], [0.02, 0.03, 0.10])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("OPTSC_CACHE", str(tmp_path))
    return tmp_path / "templates"


@pytest.fixture
def computations(monkeypatch):
    """How often a template was computed."""
    calls, compute = [], module._computed

    def counted(*arguments):
        calls.append(arguments)
        return compute(*arguments)

    monkeypatch.setattr(module, "_computed", counted)
    return calls


def kept(**options):
    return template_from_mesh("box", BOX, count=60, keep=True, **options)


def test_a_template_that_was_kept_is_the_same_and_not_computed_again(folder, computations):
    first, again = kept(), kept()
    assert (len(computations), len(list(folder.iterdir()))) == (1, 1)
    for name in ("points", "normals"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    np.testing.assert_array_equal(first.resting.quaternion, again.resting.quaternion)
    assert (first.symmetry, first.diameter) == (again.symmetry, again.diameter)
    at = np.random.default_rng(0).uniform(-0.1, 0.1, (50, 3))
    for a, b in zip(first.field.lookup(at), again.field.lookup(at), strict=True):
        np.testing.assert_array_equal(a, b)
    assert not again.points.flags.writeable


def test_another_shape_or_setting_is_another_file(folder, computations):
    kept()
    kept(seed=1)
    template_from_mesh("box", cuboid([-0.02, -0.03, 0.0], [0.02, 0.03, 0.11]), count=60, keep=True)
    assert (len(computations), len(list(folder.iterdir()))) == (3, 3)


@pytest.mark.parametrize("damage", [lambda content: content[:-100], lambda content: b"", lambda content: content[::-1]])
def test_a_damaged_file_is_replaced(folder, computations, damage):
    first = kept()
    (path,) = folder.iterdir()
    content = path.read_bytes()
    path.write_bytes(damage(content))
    np.testing.assert_array_equal(kept().points, first.points)
    assert len(computations) == 2
    assert [p.read_bytes() for p in folder.iterdir()] == [content]


def test_where_nothing_can_be_kept_it_is_computed_and_said(folder, monkeypatch):
    def refuse(path, content):
        raise OSError("no space")

    monkeypatch.setattr("optsc.cache.write_atomically", refuse)
    with pytest.warns(UserWarning, match="no space"):
        assert len(kept().points) == 60
