"""JSON that every reader takes: no number is NaN or infinite."""

from __future__ import annotations

import json
from typing import Any

from optsc.study.keys import plain


def strict_json(content: Any) -> str:
    """Return the text of ``content`` as JSON, with null for what is no number: JSON has no other word for it.

    Raises `InvalidValue` for what `optsc.study.keys.plain` has no form for.
    """
    return json.dumps(_finite(plain(content)), indent=2, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not abs(value) < float("inf") else value
