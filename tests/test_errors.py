"""Checks that settings share, and what they say."""

import pytest

from optsc.errors import InvalidValue, require_pair, require_positive, require_within


@pytest.mark.parametrize("value", [0.0, -1.0, float("inf"), float("nan")])
def test_what_is_not_finite_and_above_zero_is_named_with_its_owner(value):
    require_positive("Settings", {"speed": 1e-9, "force": 1e9})
    with pytest.raises(InvalidValue, match=r"Settings\.force"):
        require_positive("Settings", {"speed": 1.0, "force": value})


@pytest.mark.parametrize(
    "value", [(1.0,), (1.0, 0.0), (float("nan"), 1.0), (1.0, float("inf")), (1.0, 1.0, 1.0)]
)
def test_what_is_not_a_pair_above_zero_is_named_with_its_owner(value):
    require_pair("Settings", {"near": (0.01, 0.2)})
    with pytest.raises(InvalidValue, match=r"Settings\.near"):
        require_pair("Settings", {"near": value})


@pytest.mark.parametrize("value", [-0.1, 1.1, float("nan")])
def test_what_is_out_of_its_range_is_named_with_the_range(value):
    ranges = {"share": (0.0, 1.0)}
    require_within("Settings", {"share": 0.0}, ranges)
    require_within("Settings", {"share": 1.0}, ranges)
    with pytest.raises(InvalidValue, match=r"Settings\.share.*valid: 0 to 1"):
        require_within("Settings", {"share": value}, ranges)
