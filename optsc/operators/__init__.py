"""What the operator brings in: samples of a hand, the clutch, filters, devices and recordings."""

from optsc.operators.clutch import ClutchSettings, Slerp
from optsc.operators.mailbox import Mailbox
from optsc.operators.prediction import PredictionSettings
from optsc.operators.recorded import HandRecording, Recorded
from optsc.operators.sample import Button, Operator, OperatorSample, OperatorView, fault_of

__all__ = [
    "Button",
    "ClutchSettings",
    "HandRecording",
    "Mailbox",
    "Operator",
    "OperatorSample",
    "OperatorView",
    "PredictionSettings",
    "Recorded",
    "Slerp",
    "fault_of",
]
