"""Raw NASA-TLX: six scales of workload from 0 to 100, and their mean."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import MappingProxyType
from typing import NamedTuple

from optsc.checks import Between, require
from optsc.errors import InvalidValue

SCALES = MappingProxyType(
    {
        "mental": ("Mental demand: how much thinking, deciding, looking was needed?", "low", "high"),
        "physical": ("Physical demand: how much bodily effort was needed?", "low", "high"),
        "temporal": ("Temporal demand: how hurried was the pace?", "low", "high"),
        "performance": ("Performance: how well did you do what was asked?", "perfectly", "not at all"),
        "effort": ("Effort: how hard did you have to work for it?", "low", "high"),
        "frustration": ("Frustration: how irritated and discouraged were you?", "low", "high"),
    }
)
"""For each scale a question and both ends; worded here after S. Hart, L. Staveland, "Development of NASA-TLX", 1988."""


class Workload(NamedTuple):
    """Answers on the six scales, each from 0 to 100; of performance 0 is perfect.

    Make them with `of`, which checks them.
    """

    mental: float
    physical: float
    temporal: float
    performance: float
    effort: float
    frustration: float

    @classmethod
    def of(cls, **answers: float) -> Workload:
        """Return checked answers; raise `InvalidValue` where one is missing, unknown or out of range."""
        if set(answers) != set(SCALES):
            raise InvalidValue("scales", sorted(answers), ", ".join(SCALES))
        for name, value in answers.items():
            require(f"answer on {name}", value, Between(0.0, 100.0))
        return cls(**answers)

    @classmethod
    def parse(cls, texts: Sequence[str]) -> Workload:
        """Return the answers in six words, in the order of `SCALES`; raise `InvalidValue`."""
        if len(texts) != len(SCALES):
            raise InvalidValue("answers", " ".join(texts), f"six numbers: {', '.join(SCALES)}")
        return cls.of(**{name: _number(name, text) for name, text in zip(SCALES, texts, strict=True)})

    @property
    def raw(self) -> float:
        """The raw score: the mean of the six scales, in [0, 100]."""
        return sum(self) / len(self)


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InvalidValue(f"answer on {name}", text, "0 to 100") from None


def ask_workload(ask: Callable[[str], str] = input, say: Callable[[str], None] = print) -> Workload:
    """Ask a person the six questions, each again until the answer is a number from 0 to 100."""
    answers = {}
    for name, (question, low, high) in SCALES.items():
        while name not in answers:
            text = ask(f"{question} 0 ({low}) to 100 ({high}): ")
            try:
                value = float(text)
            except ValueError:
                value = -1.0
            if 0.0 <= value <= 100.0:
                answers[name] = value
            else:
                say("Please answer with a number from 0 to 100.")
    return Workload.of(**answers)
