"""What the person brings in: samples of a hand, the clutch, prediction, devices, simulated and recorded operators."""

from optsc.operators.clutch import ClutchSettings, Slerp
from optsc.operators.prediction import PredictionSettings
from optsc.operators.recorded import HandRecording, Recorded
from optsc.operators.sample import Operator, OperatorSample, OperatorView, fault_of
from optsc.operators.simulated import Reach, Simulated

__all__ = [
    "ClutchSettings",
    "HandRecording",
    "Operator",
    "OperatorSample",
    "OperatorView",
    "PredictionSettings",
    "Reach",
    "Recorded",
    "Simulated",
    "Slerp",
    "fault_of",
]
