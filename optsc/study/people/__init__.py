"""Studies with people: who does what when, whose hand it is, what they answered, where it is kept, what came out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optsc.study.lazily import lazily
from optsc.study.people.design import Block, StudyDesign, Trial, williams_design
from optsc.study.people.sitting import Sitting, TrialResult, collect
from optsc.study.people.workload import SCALES, Workload, ask_workload

if TYPE_CHECKING:
    from optsc.study.people.analysis import Difference, differences, participant_means, tidy
    from optsc.study.people.hands import Hand, Situation, device, hand_of, simulated
    from optsc.study.people.live import LiveHand, PacedFollower
    from optsc.study.people.plan import StudyPlan
    from optsc.study.people.report import save_report
    from optsc.study.people.trials import trial_runner

# What runs trials or draws pages loads a good deal; it is loaded when it is first used.
_WHERE = {
    "Difference": "analysis",
    "Hand": "hands",
    "LiveHand": "live",
    "PacedFollower": "live",
    "Situation": "hands",
    "StudyPlan": "plan",
    "device": "hands",
    "differences": "analysis",
    "hand_of": "hands",
    "participant_means": "analysis",
    "save_report": "report",
    "simulated": "hands",
    "tidy": "analysis",
    "trial_runner": "trials",
}

__all__ = [
    "SCALES",
    "Block",
    "Difference",
    "Hand",
    "LiveHand",
    "PacedFollower",
    "Sitting",
    "Situation",
    "StudyDesign",
    "StudyPlan",
    "Trial",
    "TrialResult",
    "Workload",
    "ask_workload",
    "collect",
    "device",
    "differences",
    "hand_of",
    "participant_means",
    "save_report",
    "simulated",
    "tidy",
    "trial_runner",
    "williams_design",
]

__getattr__ = lazily(__name__, _WHERE)
