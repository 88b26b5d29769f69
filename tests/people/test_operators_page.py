"""The page on simulated people tells the numbers that the code has."""

import re
from dataclasses import fields
from math import radians
from pathlib import Path

import pytest

from optsc.people import decision
from optsc.people.parameters import TYPES, AimParameters, HumanParameters

PAGE = (Path(__file__).parents[2] / "docs" / "operators.md").read_text()


def section(title):
    return PAGE.split(f"## {title}\n")[1].split("\n## ")[0]


def values(numbers, units):
    """Numbers as the page has them, in the code's units."""
    found = [float(number) for number in numbers.split(", ")]
    names = units.split(", ") if ", " in units else [units] * len(found)
    return [radians(x) if unit == "deg" else x for x, unit in zip(found, names, strict=True)]


def table(title):
    rows = re.findall(r"^\| `(\w+)` \| ([-\d., ]+) \| ([^|]*?) ?\|", section(title), re.MULTILINE)
    return {name: values(numbers, units.strip()) for name, numbers, units in rows}


@pytest.mark.parametrize(
    ("title", "parameters"), [("Motor habits", HumanParameters()), ("Ready poses", AimParameters())]
)
def test_every_parameter_is_in_the_table_with_its_value(title, parameters):
    listed = table(title)
    assert list(listed) == [field.name for field in fields(parameters)]
    for name, value in listed.items():
        actual = getattr(parameters, name)
        assert value == pytest.approx(list(actual) if isinstance(actual, tuple) else [actual]), name


def test_every_kind_of_person_is_told_by_what_it_differs_in():
    rows = re.findall(r"^\| `([\w-]+)` \| (.*?) \|", section("Kinds of people"), re.MULTILINE)
    assert [name for name, _ in rows] == list(TYPES)
    usual = HumanParameters()
    for name, words in rows:
        kind = TYPES[name]
        listed = {}
        for field, text in re.findall(r"`(\w+)` ([^`]+)", words):
            pairs = re.findall(r"([\d.]+)(?: (deg|[a-z/]+))?", text)
            listed[field] = [radians(float(x)) if unit == "deg" else float(x) for x, unit in pairs]
        actual = {f.name: getattr(kind.human, f.name) for f in fields(usual)}
        actual = {n: x for n, x in actual.items() if x != getattr(usual, n)}
        if kind.changes_mind_after is not None:
            actual["changes_mind_after"] = kind.changes_mind_after
        assert set(listed) == set(actual), name
        for field, value in actual.items():
            assert listed[field] == pytest.approx(list(value) if isinstance(value, tuple) else [value]), field


def test_what_looks_at_rest_and_what_helps_is_as_told():
    rest = re.search(r"slower than ([\d.]+) m/s and ([\d.]+) deg/s over ([\d.]+) s", PAGE).groups()
    speed, turn, window = map(float, rest)
    assert (speed, radians(turn), window) == pytest.approx(
        (decision._REST_SPEED, decision._REST_TURN, decision._REST_WINDOW)
    )
    assert f"leaves more than {decision._HELPS} of the error" in PAGE.replace("\n", " ")


def test_the_tremor_is_as_strong_as_told():
    usual = HumanParameters()
    acceleration = usual.tremor * (2.0 * 3.141592653589793 * usual.tremor_frequency) ** 2 / 9.80665
    assert acceleration == pytest.approx(0.08, abs=0.002)
    assert "0.2 mm at 10 Hz is 0.08 g" in PAGE
