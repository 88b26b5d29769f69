import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruckig import Result

from optsc.errors import InvalidValue, SolverFailure
from optsc.shaping import TimeLaw

positive = st.floats(0.01, 10.0)


@given(st.floats(1e-6, 5.0), positive, positive, positive)
def test_a_time_law_goes_from_rest_to_rest_within_its_limits(length, speed, acceleration, jerk):
    law = TimeLaw(length, speed, acceleration, jerk)
    times = np.linspace(0, law.duration, 200)
    s, rate, a = np.array([law.at(t) for t in times]).T
    assert (s[0], rate[0]) == (0.0, 0.0)
    assert s[-1] == pytest.approx(length)
    assert rate[-1] == pytest.approx(0.0, abs=1e-9)
    assert np.all(np.diff(s) >= -1e-9)
    assert np.all(rate <= speed * (1 + 1e-9))
    assert np.all(np.abs(a) <= acceleration * (1 + 1e-9))
    assert np.all(np.abs(np.diff(a)) <= jerk * np.diff(times) * (1 + 1e-6) + 1e-9)


def test_a_long_path_is_travelled_at_the_speed_that_is_asked_for():
    law = TimeLaw(1.0, 0.1, 0.5, 5.0)
    assert law.at(law.duration / 2).rate == pytest.approx(0.1)
    assert law.duration == pytest.approx(1.0 / 0.1 + 0.1 / 0.5 + 0.5 / 5.0)


def test_the_ends_hold_before_and_after():
    law = TimeLaw(0.2, 0.1, 0.5, 5.0)
    assert law.at(-1.0).s == 0.0
    assert law.at(99.0) == (0.2, 0.0, 0.0)


@pytest.mark.parametrize("wrong", [{"speed": -0.1}, {"speed": 0.0}, {"length": -1.0}, {"jerk": np.inf}])
def test_impossible_laws_are_refused(wrong):
    with pytest.raises(InvalidValue, match="TimeLaw"):
        TimeLaw(**{"length": 1.0, "speed": 0.1, "acceleration": 0.5, "jerk": 5.0, **wrong})


@pytest.mark.parametrize("name", sorted(set(Result.__members__) - {"Working", "Finished"}))
def test_whatever_error_the_planner_answers_is_named(name, monkeypatch):
    class Planner:
        def __init__(self, joints):
            pass

        def calculate(self, plan, trajectory):
            return Result.__members__[name]

    monkeypatch.setattr("ruckig.Ruckig", Planner)
    with pytest.raises(SolverFailure, match=name):
        TimeLaw(1.0, 0.1, 0.5, 5.0)
