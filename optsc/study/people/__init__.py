"""Studies with people: who does what when, what they answered, and where it is kept."""

from optsc.study.people.design import Block, StudyDesign, Trial, williams_design
from optsc.study.people.sitting import Sitting, TrialResult, collect
from optsc.study.people.workload import SCALES, Workload, ask_workload

__all__ = [
    "SCALES",
    "Block",
    "Sitting",
    "StudyDesign",
    "Trial",
    "TrialResult",
    "Workload",
    "ask_workload",
    "collect",
    "williams_design",
]
