"""Plain words: what a robotics student would have to decode is not in code, pages or messages."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
BANNED = {
    r"mementos?": "snapshot",
    r"outlooks?": "path feasibility",
    r"brisk(?:ly)?": "speed-limited, quick",
    r"anew": "again",
    r"of one'?s own": "user-defined",
    r"flesh and blood": "human participants",
    r"(?:listener|heard|news)s?": "input monitor, operator input, event",
    r"carr(?:y|ies|ied) out": "execute",
    r"postures?": "configuration",
    r"likeness": "angle tolerance",
    r"(?:straight|whole|free|best) ways?": "path",
    r"\w+_way|way_\w+|ways_\w+|\w+_ways": "path",
    r"staging": "episode setup",
    r"walk_\w+|walks": "straight-line rollout",
}
"""What is not said, and what is said instead."""
POSTURE_TASK = r"posture task|posture_(?:weight|gain|cost)|\bposture\b"
EXCEPTIONS = {
    "optsc/ik/differential.py": POSTURE_TASK,  # the literature's name of that task
    "optsc/kernels/pose_task.py": POSTURE_TASK,
    "benchmarks/peers.py": POSTURE_TASK,
    "benchmarks/placo_worker.py": POSTURE_TASK,
    "optsc/cli/grasp_build.py": r"\bposture\b",  # the option --posture
    "optsc/cli/grasp_views.py": r"--posture",
    "docs/grasps.md": r"--posture",
    "optsc/demo/observation.py": r'"news"',  # a key of summary.json
    "benchmarks/scenes.py": r'"news"',
    "docs/operators.md": r"control of posture",  # a title
}
"""Terms of the literature, options and titles, by file."""


def texts():
    paths = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    for folder in ("optsc", "examples", "benchmarks"):
        paths += sorted((ROOT / folder).rglob("*.py"))
    return paths


@pytest.mark.parametrize("pattern", BANNED)
def test_a_word_that_has_to_be_decoded_is_not_used(pattern):
    found = []
    for path in texts():
        name = str(path.relative_to(ROOT))
        for number, line in enumerate(path.read_text().splitlines(), 1):
            kept = re.sub(EXCEPTIONS[name], "", line) if name in EXCEPTIONS else line
            if re.search(rf"\b(?:{pattern})\b", kept, re.IGNORECASE):
                found.append(f"{name}:{number}: {line.strip()}")
    assert not found, f"say {BANNED[pattern]!r}:\n" + "\n".join(found)
