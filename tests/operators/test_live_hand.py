"""Samples of a device on the clock of the run."""

import numpy as np
import pytest

from optsc.geometry import Pose
from optsc.operators import LiveHand, Mailbox, OperatorSample, OperatorView


def view(time):
    return OperatorView(time, Pose.identity(), False, False, {})


def test_live_samples_get_the_run_s_time_and_never_go_back():
    box = Mailbox()
    hand = LiveHand(box, lambda: 5.0)
    assert hand.read(view(0.0)) is None

    def read(stamp, time):
        box.post(OperatorSample(stamp, Pose.identity()))
        return hand.read(view(time)).stamp

    assert read(4.98, 0.5) == pytest.approx(0.48)
    assert read(4.99, 0.49) == pytest.approx(0.48)  # the run stood still
    assert read(6.0, 0.6) == pytest.approx(0.6)  # stamped in the future
    assert np.isnan(read(float("nan"), 0.7))  # to be refused by the controller
    assert read(6.1, 0.8) == pytest.approx(0.8)
