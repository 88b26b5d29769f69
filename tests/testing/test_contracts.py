"""The contracts find what is wrong with a part, by the test whose name says it."""

import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest

from optsc.control.arbitration import Arbitration, Blend
from optsc.followers import IdealFollower
from optsc.geometry import Pose
from optsc.operators import OperatorSample
from optsc.selection import GraspCost, GraspFilter
from optsc.testing import (
    ArbitrationContract,
    FollowerContract,
    GraspCostContract,
    GraspFilterContract,
    OperatorContract,
    policies,
)

IDENTITY = Pose.identity()


def failing(contract):
    """The tests of a contract that fail."""
    found = set()
    for name in dir(contract):
        if name.startswith("test_"):
            try:
                getattr(contract(), name)()
            except Exception:  # noqa: BLE001 what a broken part raises is not the contract's to say
                found.add(name.removeprefix("test_"))
    return found


class Careless(IdealFollower):
    """Hands out its own arrays, takes any opening, and goes on after it was closed."""

    def state(self):
        return self._state

    def apply(self, q, v, opening, period):
        return super().apply(q, v, min(max(opening, 0.0), 0.08), period)


class Late(IdealFollower):
    """Is always one command behind, also after a reset."""

    late = None

    def apply(self, q, v, opening, period):
        late, self.late = self.late, (q, v)
        return super().apply(*(late or (q, v)), opening, period)


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        (
            Careless,
            {
                "what_a_follower_hands_out_is_not_its_memory",
                "a_wrong_command_is_refused_by_name_and_leaves_everything_as_it_was",
                "closing_twice_is_harmless_and_use_after_closing_is_a_clear_error",
                "leaving_the_with_block_closes",
            },
        ),
        (
            Late,
            {
                "apply_follows_a_smooth_motion_at_full_speed",
                "the_same_commands_give_the_same_bytes_after_reset_and_in_another_follower",
                "a_wrong_command_is_refused_by_name_and_leaves_everything_as_it_was",
            },
        ),
    ],
)
def test_a_follower_is_found_out(kind, expected):
    class Contract(FollowerContract):
        def make_follower(self, robot):
            return kind(robot)

    assert failing(Contract) >= expected


def sampled(read):
    class Contract(OperatorContract):
        def make_operator(self):
            class Made:
                pass

            made = Made()
            made.read = lambda view: read(made, view)
            return made

    return failing(Contract)


def test_an_operator_is_found_out():
    assert sampled(lambda _, view: OperatorSample(view.time, IDENTITY)) == set()
    border = "every_sample_passes_the_border_check_at_any_rate"
    hostile = "read_never_raises_whatever_is_shown"
    assert {border, hostile} <= sampled(lambda _, view: None)
    assert {border, hostile} <= sampled(lambda _, view: OperatorSample(view.time + 0.01, IDENTITY))
    assert {border, hostile} <= sampled(lambda _, view: OperatorSample(-view.time, IDENTITY))
    assert border in sampled(lambda _, view: OperatorSample(view.time, Pose(np.full(4, 0.6), np.zeros(3))))
    assert border in sampled(lambda _, view: OperatorSample(view.time, IDENTITY, clutch=1))
    assert hostile in sampled(lambda _, view: OperatorSample(view.time, IDENTITY, bool(view.objects["can"])))
    rng = np.random.default_rng()
    assert sampled(lambda _, view: OperatorSample(view.time, Pose.from_translation(rng.random(3)))) == {
        "operators_that_are_made_alike_read_alike"
    }

    def reused(made, view):
        made.p = getattr(made, "p", np.zeros(3))
        made.p += 1e-3
        X_SH = Pose.identity()
        object.__setattr__(X_SH, "translation", made.p)
        return OperatorSample(view.time, X_SH)

    assert "reading_changes_neither_the_view_nor_earlier_samples" in sampled(reused)


def test_a_policy_is_found_out():
    class Dragging(Arbitration):
        """Pulls always, towards wherever a number of the quaternion points, more with every answer."""

        name = "dragging"
        asked = 0

        def blend(self, moment):
            self.asked += 1
            return Blend(np.eye(6), np.full(6, 0.01 * moment.q[1] * self.asked), 2.0)

    class Contract(ArbitrationContract):
        def make_policy(self):
            return Dragging()

    assert failing(Contract) >= {
        "answers_are_finite_and_follow_from_the_moment_alone",
        "the_sign_of_a_quaternion_does_not_matter",
        "a_hand_at_rest_keeps_still_where_nothing_is_in_reach",
        "without_anything_in_reach_the_tool_goes_where_the_hand_goes",
    }


@dataclass(frozen=True)
class Height(GraspCost):
    """Looks at the world, at a component of a quaternion, at the place in the list, or is no number."""

    what: str = "z"
    name = "height"
    unit = "m"

    def values(self, situation):
        z = situation.grid.positions[2]
        return {
            "z": z,
            "sign": z + situation.quaternion[0],
            "place": np.where(situation.grid.layout.index == 0, 1.0, z),
            "nan": np.where(situation.grid.reachable, z, np.nan),
            "flat": z[0],
        }[self.what]

    def key(self, situation):
        return -self.values(situation) if self.what == "place" else self.values(situation)


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        ("z", {"it_does_not_depend_on_the_world_frame"}),
        ("sign", {"it_does_not_depend_on_the_sign_of_a_quaternion"}),
        ("place", {"it_does_not_depend_on_the_order_of_the_candidates", "the_key_sorts_as_the_cost_does"}),
        ("nan", {"it_is_a_finite_number_for_every_candidate"}),
        ("flat", {"it_is_a_finite_number_for_every_candidate"}),
    ],
)
def test_a_cost_is_found_out(what, expected):
    class Contract(GraspCostContract):
        def make_cost(self):
            return Height(what)

    assert failing(Contract) >= expected
    if what == "z":
        Contract.depends_on_world = True
        assert failing(Contract) == set()


def test_a_filter_is_found_out():
    class High(GraspFilter):
        reason = " "

        def passes(self, situation):
            return 1.0 * (situation.grid.positions[2] > 0.2)

    class Contract(GraspFilterContract):
        def make_filter(self):
            return High()

    assert failing(Contract) == {"it_gives_a_mask_with_a_reason", "it_does_not_depend_on_the_world_frame"}


def test_check_runs_every_test_or_says_which_one_fails():
    class Contract(FollowerContract):
        test_a_new_follower_stands_at_home = None

        def make_follower(self, robot):
            return Late(robot)

    with pytest.raises(AssertionError, match=r"Contract\.test_a_wrong_command"):
        Contract.check()

    class Good(GraspCostContract):
        depends_on_world = True

        def make_cost(self):
            return Height()

    names = Good.check()
    assert len(names) == len([name for name in dir(Good) if name.startswith("test_")]) == 10
    assert names == tuple(sorted(names))


def test_the_contracts_are_there_without_pytest():
    code = "import sys; sys.modules['pytest'] = None\nimport optsc\nprint(optsc.testing.FollowerContract.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "FollowerContract"


def test_a_failed_assert_is_explained():
    assert type(policies.__loader__).__name__ == "AssertionRewritingHook"
