"""What every operator has to do, tried on each of them."""

import pytest

from optsc.geometry import Pose
from optsc.operators import HandRecording, Mailbox, OperatorSample, Recorded
from optsc.people import TYPES, Simulated
from optsc.testing import OperatorContract
from optsc.testing.loop import StraightOperator


class TestSimulated(OperatorContract):
    @pytest.fixture(autouse=True, params=TYPES)
    def _each(self, request):
        self.kind = TYPES[request.param]

    @pytest.fixture(autouse=True, params=[False, True], ids=["hands over", "by hand"])
    def _trigger(self, request):
        self.by_hand = request.param

    def make_operator(self):
        return Simulated.of_type(self.kind, "can", self.objects, seed=3, by_hand=self.by_hand)


class TestRecorded(OperatorContract):
    def make_operator(self):
        return Recorded(HandRecording.example(), reengage_every=2.0)


class TestMailbox(OperatorContract):
    def make_operator(self):
        return Posted()


class Posted(Mailbox):
    """A mailbox into which a device posts at every third view."""

    views = 0

    def read(self, view):
        if self.views % 3 == 0:
            self.post(OperatorSample(view.time, Pose.from_translation([0.001 * self.views, 0.0, 0.0])))
        self.views += 1
        return super().read(view)


class TestStraightOperator(OperatorContract):
    def make_operator(self):
        return StraightOperator([0.5, 0.25, 0.1])
