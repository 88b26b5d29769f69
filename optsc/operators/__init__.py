"""What the person brings in: samples of a hand, the clutch, prediction, devices, simulated and recorded operators."""

from optsc.operators.clutch import ClutchSettings, Slerp
from optsc.operators.mailbox import Mailbox
from optsc.operators.people import TYPES, OperatorType, operator_type
from optsc.operators.prediction import PredictionSettings
from optsc.operators.recorded import HandRecording, Recorded
from optsc.operators.sample import Button, Operator, OperatorSample, OperatorView, fault_of
from optsc.operators.simulated import R_WS_DEFAULT, Reach, Simulated

__all__ = [
    "R_WS_DEFAULT",
    "TYPES",
    "Button",
    "ClutchSettings",
    "HandRecording",
    "Mailbox",
    "Operator",
    "OperatorSample",
    "OperatorType",
    "OperatorView",
    "PredictionSettings",
    "Reach",
    "Recorded",
    "Simulated",
    "Slerp",
    "fault_of",
    "operator_type",
]
