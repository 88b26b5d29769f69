"""Validation of settings: each field of a dataclass declares its valid range once, in its type.

    @dataclass(frozen=True)
    class GripperSettings(Checked):
        force: Annotated[float, Positive] = 40.0                            # finite, above 0
        overlap: Annotated[float, Share] = 0.5                              # 0 to 1
        opening: Annotated[float, Above(0.0), AtMost(0.2)] = 0.08           # rules add up
        tries: Annotated[int, AtLeast(1)] = 3                               # a whole number
        tolerance: Annotated[tuple[float, float], Pair] = (1e-3, 1e-2)      # two finite numbers above 0
        weights: Annotated[tuple[float, float, float], Each(NonNegative)] = (1.0, 1.0, 0.5)
        band: Annotated[tuple[float, float], Each(Share), Ordered] = (0.2, 0.8)
        timeout: Annotated[float | None, Positive] = None                   # None only where the type has it
        side: Literal["left", "right"] = "left"                             # needs no rule
        solver: Annotated[str, OneOf(SOLVERS, "solver")] = "daqp"           # UnknownName with "did you mean"
        points: Annotated[Array, ArrayOf("N", 3), Finite] = ...             # a read-only copy
        normals: Annotated[Array | None, ArrayOf("N", 3)] = None            # N as in `points`

Checked are the fields with rules, of type `Literal`, and of type `bool`. A field without a rule, such as nested
settings that have checked themselves, is left alone. What relates several fields goes into the class:

        def __post_init__(self) -> None:
            super().__post_init__()
            if self.overlap > self.opening: raise InvalidValue("GripperSettings.overlap", ...)

`require` checks an argument of a function by the same rules; `from_mapping` builds settings from a file's keys.
"""

from optsc.checks.declared import Checked, from_mapping
from optsc.checks.rules import (
    Above,
    ArrayOf,
    AtLeast,
    AtMost,
    Below,
    Between,
    Each,
    Finite,
    Flag,
    NonNegative,
    Number,
    OneOf,
    Ordered,
    Pair,
    Positive,
    Range,
    Rule,
    Share,
    Where,
    Whole,
    require,
)

__all__ = [
    "Above",
    "ArrayOf",
    "AtLeast",
    "AtMost",
    "Below",
    "Between",
    "Checked",
    "Each",
    "Finite",
    "Flag",
    "NonNegative",
    "Number",
    "OneOf",
    "Ordered",
    "Pair",
    "Positive",
    "Range",
    "Rule",
    "Share",
    "Where",
    "Whole",
    "from_mapping",
    "require",
]
