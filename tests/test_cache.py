"""Results that are computed once: when a file of the cache is taken, and what its name depends on."""

import numpy as np

from optsc.cache import computed_once, content_key


def test_a_file_with_other_arrays_is_not_taken(tmp_path, monkeypatch):
    monkeypatch.setenv("OPTSC_CACHE", str(tmp_path))
    key, names = content_key("a"), frozenset(["a"])
    computed_once("things", key, frozenset(["b"]), lambda: {"b": np.zeros(1)})
    found = computed_once("things", key, names, lambda: {"a": np.ones(1)})
    assert set(found) == {"a"}
    assert len(list((tmp_path / "things").iterdir())) == 1


def test_the_key_does_not_depend_on_the_layout_of_an_array():
    a = np.arange(6.0).reshape(2, 3)
    assert content_key(a) == content_key(np.asfortranarray(a)) == content_key(a.astype(">f8"))
    assert len({content_key(a), content_key(a.T), content_key(a.astype(int)), content_key(a, 1), content_key(1)}) == 5
