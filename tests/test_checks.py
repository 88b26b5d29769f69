"""Laws of declared checks: whatever the range and the bad value, the error names class, field and value."""

from __future__ import annotations

import importlib
import math
import pickle
import pkgutil
from dataclasses import MISSING, dataclass, field, fields, replace
from fractions import Fraction
from typing import Annotated, Any, ClassVar, Literal, Protocol

import numpy as np
import pytest

import optsc
from optsc.checks import (
    Above,
    ArrayOf,
    AtLeast,
    AtMost,
    Below,
    Between,
    Checked,
    Each,
    Finite,
    NonNegative,
    OneOf,
    Ordered,
    Pair,
    Positive,
    Share,
    Where,
    from_mapping,
    require,
)
from optsc.errors import InvalidValue, UnknownName

NAN, INF = math.nan, math.inf
SOLVERS = {"daqp": 1, "proxqp": 2}
Weights = tuple[float, float, float]


@dataclass(frozen=True)
class Every(Checked):
    positive: Annotated[float, Positive] = 1.0
    non_negative: Annotated[float, NonNegative] = 0.0
    finite: Annotated[float, Finite] = -5.0
    share: Annotated[float, Share] = 0.5
    between: Annotated[float, Between(-1.0, 2.0)] = 2.0
    above: Annotated[float, Above(0.0), AtMost(0.2)] = 0.2
    leak: Annotated[float, AtLeast(0.0), Below(1.0)] = 0.0
    rate: Annotated[float, Above(0.0)] = INF
    count: Annotated[int, AtLeast(1)] = 3
    odd: Annotated[int, AtLeast(3), Where("odd", lambda n: n % 2 == 1)] = 5
    pair: Annotated[tuple[float, float], Pair] = (0.5, 1.5)
    weights: Annotated[Weights, Each(NonNegative)] = (1.0, 0.0, 2.0)
    counts: Annotated[tuple[int, ...], Each(AtLeast(1))] = (1, 2)
    band: Annotated[tuple[float, float], Each(Share), Ordered] = (0.2, 0.8)
    ends: Annotated[tuple[float, float], Ordered] = (-1.0, -1.0)
    timeout: Annotated[float | None, Positive] = None
    braking: Annotated[tuple[float, float], Each(NonNegative)] | None = None
    number: Annotated[float, Where("not 7", lambda x: x != 7)] = 1.0
    side: Literal["left", "right"] = "left"
    solver: Annotated[str, OneOf(SOLVERS, "solver")] = "daqp"
    method: Annotated[str, OneOf(("hough", "grid"))] = "grid"
    lagging: bool = False


NO_NUMBERS: tuple[Any, ...] = (NAN, "1.0", True, 1j, [1.0], np.array([1.0]), {}, object(), np.bool_(True))
NO_SEQUENCES: tuple[Any, ...] = (1.0, "ab", (), (1.0,), (1.0,) * 5, {0.1: 1, 0.2: 1}, np.ones((2, 2)))
NO_PAIRS = (*NO_SEQUENCES, (NAN, 1.0), ("a", "b"), (0.5, None), (True, True))
BAD: dict[str, tuple[Any, ...]] = {
    "positive": (*NO_NUMBERS, None, 0.0, -1, INF, np.float32(0.0)),
    "non_negative": (*NO_NUMBERS, None, -1e-300, INF),
    "finite": (*NO_NUMBERS, None, INF, -INF),
    "share": (*NO_NUMBERS, None, -0.01, 1.01, INF),
    "between": (*NO_NUMBERS, None, -1.1, 2.1),
    "above": (*NO_NUMBERS, None, 0.0, 0.21),
    "leak": (*NO_NUMBERS, None, -0.1, 1.0),
    "rate": (*NO_NUMBERS, None, 0.0),
    "count": (*NO_NUMBERS, None, 0, 2.0, 1.5, INF),
    "odd": (*NO_NUMBERS, None, 1, 4, 5.0),
    "pair": (*NO_PAIRS, None, (0.0, 1.0), (1.0, INF), (1.0, 1.0, 1.0)),
    "weights": (*NO_PAIRS, None, (1.0, 1.0), (1.0, -1.0, 1.0)),
    "counts": (1, "ab", None, (0,), (1.5,), (True,)),
    "band": (*NO_PAIRS, None, (0.8, 0.2), (-0.1, 0.5)),
    "ends": (*NO_PAIRS, None, (1.0, 0.0)),
    "timeout": (*NO_NUMBERS, 0.0),
    "braking": (*NO_PAIRS, (1.0, -1.0)),
    "number": (*NO_NUMBERS, None, 7.0),
    "side": (None, "up", 1, [], {}, np.array(["left", "right"])),
    "solver": (None, 1, [], {}),
    "method": (None, "bogus", 1, [], {}),
    "lagging": (None, "no", 0, 1.0, []),
}
GOOD: dict[str, tuple[Any, ...]] = {
    "positive": (1, 1e-300, np.float32(2.0), np.int64(3), Fraction(1, 3)),
    "non_negative": (0, 0.0, np.float64(1.0)),
    "share": (0, 1, 0.3),
    "count": (1, np.int32(7)),
    "rate": (1e-9, INF),
    "pair": ((1, 2), (np.float64(1.0), 2.0)),
    "counts": ((), (1,), (1, 2, 3)),
    "band": ((0.0, 0.0), (0.0, 1.0)),
    "timeout": (None, 1.0),
    "braking": (None, (0.0, 1.0)),
    "side": ("left", "right"),
    "solver": tuple(SOLVERS),
    "lagging": (True, np.bool_(False)),
}


def cases(table):
    return [pytest.param(n, value, id=f"{n}-{i}") for n in table for i, value in enumerate(table[n])]


def test_there_is_a_bad_value_for_every_field():
    assert set(BAD) == {f.name for f in fields(Every)}


@pytest.mark.parametrize(("name", "value"), cases(BAD))
def test_a_bad_value_is_refused_with_class_field_and_value(name, value):
    with pytest.raises(InvalidValue) as caught:
        Every(**{name: value})
    assert caught.value.field == f"Every.{name}"
    assert caught.value.value is value
    assert str(caught.value).startswith(f"Every.{name} is ")
    assert caught.value.valid


@pytest.mark.parametrize(("name", "value"), cases(GOOD))
def test_a_good_value_is_kept_as_it_is(name, value):
    assert getattr(Every(**{name: value}), name) is value


@pytest.mark.parametrize(("name", "value"), cases({n: BAD[n][-2:] for n in BAD}))
def test_a_replaced_value_is_checked_as_well(name, value):
    with pytest.raises(InvalidValue, match=rf"Every\.{name}"):
        replace(Every(), **{name: value})


@pytest.mark.parametrize("value", [[0.5, 1.0], np.array([0.5, 1.0])])
def test_other_sequences_become_tuples_so_that_settings_have_a_hash(value):
    settings = Every(pair=value)
    assert settings.pair == (0.5, 1.0)
    assert type(settings.pair) is tuple
    assert hash(settings) == hash(Every(pair=(0.5, 1.0)))


@pytest.mark.parametrize(
    ("name", "value", "valid"),
    [
        ("positive", 0.0, "finite, above 0"),
        ("non_negative", -1.0, "finite, 0 or more"),
        ("share", 2.0, "0 to 1"),
        ("above", 0.0, "above 0, at most 0.2"),
        ("count", 0, "a whole number, at least 1"),
        ("odd", 4, "a whole number, at least 3, odd"),
        ("pair", (0.0, 1.0), "two finite numbers above 0"),
        ("weights", (), "three values, each finite, 0 or more"),
        ("counts", (0,), "values, each a whole number, at least 1"),
        ("band", (0.8, 0.2), "two values, each 0 to 1, in ascending order"),
        ("side", "up", "one of left, right"),
        ("lagging", "no", "True or False"),
    ],
)
def test_the_range_is_said_in_words(name, value, valid):
    with pytest.raises(InvalidValue) as caught:
        Every(**{name: value})
    assert caught.value.valid == valid


def test_an_unknown_name_of_a_kind_says_which_there_are_and_which_was_meant():
    with pytest.raises(UnknownName, match=r"no solver named 'dapq'; there are: daqp, proxqp \(did you mean 'daqp'\?\)"):
        Every(solver="dapq")
    with pytest.raises(UnknownName) as caught:
        Every(solver="zzz")
    assert str(caught.value) == "no solver named 'zzz'; there are: daqp, proxqp"
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


class Follower(Protocol):
    name: ClassVar[str]

    def rate_of(self) -> float: ...


@dataclass(frozen=True)
class Base(Checked, Follower):
    name: ClassVar[str] = "base"
    limit: ClassVar[Annotated[float, Positive]] = -1.0
    low: Annotated[float, Share] = 0.2
    high: Annotated[float, Share] = 0.8
    free: float = NAN

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.low > self.high:
            raise InvalidValue("Base.low", self.low, f"at most high, {self.high}")

    def rate_of(self) -> float:
        return self.low


@dataclass(frozen=True)
class Derived(Base):
    count: Annotated[int, AtLeast(1)] = 1
    high: Annotated[float, Between(0.5, 2.0)] = 1.5
    inner: Every = field(default_factory=Every)


def test_subclasses_check_what_they_inherit_and_what_they_change():
    assert Derived(high=1.9).high == 1.9
    for wrong in ({"low": -1.0}, {"count": 0}, {"high": 0.4}):
        with pytest.raises(InvalidValue, match=rf"Derived\.{next(iter(wrong))}"):
            Derived(**wrong)
    with pytest.raises(InvalidValue, match=r"Base\.high"):
        Base(high=1.5)
    with pytest.raises(InvalidValue, match="at most high"):
        Derived(low=0.9, high=0.6)


def test_fields_without_a_rule_are_left_alone():
    assert math.isnan(Base().free)
    assert Base(free="anything").free == "anything"


def test_a_field_that_is_worked_out_is_not_checked():
    @dataclass
    class Derived(Checked):
        rate: Annotated[float, Positive] = 1.0
        period: Annotated[float, Positive] = field(init=False)

        def __post_init__(self) -> None:
            super().__post_init__()
            self.period = 1.0 / self.rate

    assert Derived(2.0).period == 0.5


def test_a_dataclass_that_may_change_is_checked_when_it_is_made():
    @dataclass
    class Loose(Checked):
        rate: Annotated[float, Positive]

    assert Loose(1.0).rate == 1.0
    with pytest.raises(InvalidValue, match=r"Loose\.rate"):
        Loose(-1.0)


@dataclass(frozen=True, eq=False)
class Cloud(Checked):
    points: Annotated[np.ndarray, ArrayOf("N", 3, least=1), Finite]
    normals: Annotated[np.ndarray | None, ArrayOf("N", 3)] = None
    seen: Annotated[np.ndarray, ArrayOf("N", dtype=bool)] | None = None
    label: Annotated[np.ndarray, ArrayOf(None, dtype=np.int64), AtLeast(0)] = ()


def test_arrays_are_copied_converted_and_made_read_only():
    points = np.ones((2, 3))
    cloud = Cloud(points, seen=[True, False], label=[1, 2, 3])
    points[:] = 5.0
    assert cloud.points.max() == 1.0
    assert not cloud.points.flags.writeable
    assert cloud.seen.dtype == bool
    assert cloud.label.dtype == np.int64
    assert Cloud([[1, 2, 3]]).points.dtype == float
    assert Cloud(points).normals is None
    assert Cloud(points).label.shape == (0,)


@pytest.mark.parametrize(
    ("wrong", "answer"),
    [
        ({"points": np.ones((2, 2))}, r"Cloud\.points is \(2, 2\); valid: shape \(N, 3\), at least 1 rows"),
        ({"points": np.ones((0, 3))}, r"Cloud\.points"),
        ({"points": np.ones(3)}, r"Cloud\.points"),
        ({"points": 1.0}, r"Cloud\.points"),
        ({"points": None}, r"Cloud\.points"),
        ({"points": [[1.0, NAN, 0.0]]}, r"Cloud\.points is nan; valid: each finite"),
        ({"points": [[1.0], [1.0, 2.0]]}, r"Cloud\.points"),
        ({"points": [["a", "b", "c"]]}, r"Cloud\.points"),
        ({"normals": np.ones((3, 3))}, r"Cloud\.normals is \(3, 3\); valid: shape \(2, 3\)"),
        ({"seen": np.ones(3, dtype=bool)}, r"Cloud\.seen is \(3,\); valid: shape \(2,\)"),
        ({"seen": [0.5, 1.0]}, r"Cloud\.seen is .*; valid: bool"),
        ({"label": [0.5]}, r"Cloud\.label is .*; valid: int64"),
        ({"label": [3, -2]}, r"Cloud\.label is -2; valid: each at least 0"),
    ],
)
def test_arrays_of_another_shape_kind_or_range_are_refused(wrong, answer):
    with pytest.raises(InvalidValue, match=answer):
        Cloud(**({"points": np.ones((2, 3))} | wrong))


@pytest.mark.parametrize("value", [*NO_NUMBERS, None, 0.0], ids=range(len(NO_NUMBERS) + 2))
def test_arguments_are_checked_by_the_same_rules(value):
    require("rate", 1.0, Positive)
    with pytest.raises(InvalidValue) as caught:
        require("rate", value, Positive, AtMost(5.0))
    assert (caught.value.field, caught.value.valid) == ("rate", "finite, above 0, at most 5")
    with pytest.raises(UnknownName, match="no solver named"):
        require("solver", "none", OneOf(SOLVERS, "solver"))


@dataclass(frozen=True)
class Outer(Checked):
    rate: Annotated[float, Positive]
    base: Base = field(default_factory=Base)
    extra: Every | None = None
    parts: tuple[Base, ...] = ()
    place: tuple[float, Base] = (0.0, Base())
    note: dict[str, float] = field(default_factory=dict)


def test_settings_are_built_from_nested_mappings():
    built = from_mapping(
        Outer,
        {
            "rate": 5,
            "base": {"low": 0.1},
            "extra": {"pair": [1.0, 2.0]},
            "parts": [{"high": 0.9}, {}],
            "place": [1.0, {"low": 0.3}],
            "note": {"a": 1.0},
        },
    )
    assert built.base.low == 0.1
    assert built.extra == Every(pair=(1.0, 2.0))
    assert [part.high for part in built.parts] == [0.9, 0.8]
    assert built.place[1].low == 0.3
    assert built.note == {"a": 1.0}
    assert from_mapping(Outer, {"rate": 1.0, "extra": None}).extra is None
    inner = Base(low=0.4)
    assert from_mapping(Outer, {"rate": 1.0, "base": inner}).base is inner


@pytest.mark.parametrize(
    ("mapping", "error", "answer"),
    [
        ({"rate": 1.0, "bsae": {}}, UnknownName, r"no setting of Outer named 'bsae'.*did you mean 'base'"),
        ({"rate": 1.0, 5: {}}, UnknownName, r"no setting of Outer named '5'"),
        ({"rate": 1.0, "base": {"hihg": 1.0}}, UnknownName, r"setting of Base.*did you mean 'high'"),
        ({"rate": 1.0, "base": {"name": "x"}}, UnknownName, "setting of Base"),
        ({"rate": 1.0, "base": {"low": "0.1"}}, InvalidValue, r"Base\.low"),
        ({"rate": 1.0, "base": 5}, InvalidValue, "Base is 5"),
        ({"rate": 1.0, "base": None}, InvalidValue, "Base is None"),
        ({"rate": -1.0}, InvalidValue, r"Outer\.rate"),
        ({}, InvalidValue, r"Outer\.rate"),
        (None, InvalidValue, "Outer is None"),
        ([("rate", 1.0)], InvalidValue, "Outer"),
    ],
)
def test_wrong_mappings_are_refused_by_name(mapping, error, answer):
    with pytest.raises(error, match=answer):
        from_mapping(Outer, mapping)


def checked_classes() -> list[type[Checked]]:
    for module in pkgutil.walk_packages(optsc.__path__, "optsc."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    found, waiting = set(), [Checked]
    while waiting:
        for kind in waiting.pop().__subclasses__():
            waiting.append(kind)
            if kind.__module__.startswith("optsc."):
                found.add(kind)
    return sorted(found, key=lambda kind: kind.__qualname__)


def test_the_defaults_of_every_class_are_valid_and_every_number_knows_its_range():
    for kind in checked_classes():
        required = [f for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING]
        if required:
            continue
        settings = kind()
        assert from_mapping(kind, {f.name: getattr(settings, f.name) for f in fields(kind) if f.init}) == settings
        for one in fields(kind):
            if one.init and isinstance(one.default, float):
                with pytest.raises(InvalidValue):
                    replace(settings, **{one.name: "a text"})
