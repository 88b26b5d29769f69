"""A user-defined policy beside the paper's alternating control: the same person in the same two scenes."""

from dataclasses import dataclass

import numpy as np

from optsc.control.arbitration import HAND_ALONE, Arbitration, Blend, Moment, towards
from optsc.control.policies import Alternating
from optsc.study import Cases, PolicyCondition, do_policies


@dataclass(frozen=True)
class Agreement(Arbitration):
    """Helps only where the hand already goes: by the cosine between the two wishes."""

    most: float = 0.6

    name = "agreement"

    def blend(self, moment: Moment) -> Blend:
        """Return how much of the hand's motion is executed, and what the robot adds."""
        goal = moment.goal
        if goal is None:
            return HAND_ALONE
        u_h, u_r = moment.hand, towards(moment, self.aim(goal))
        sizes = np.linalg.norm(u_h[:3]) * np.linalg.norm(u_r[:3])
        alpha = self.most * max(0.0, float(u_h[:3] @ u_r[:3]) / sizes) if sizes > 1e-4 else 0.0
        return Blend((1.0 - alpha) * np.eye(6), alpha * u_r, alpha)


conditions = [PolicyCondition("alternating", Alternating()), PolicyCondition("agreement", Agreement())]
jobs = Cases(scenes=2, seed=1, people=("patient",)).policy_jobs(conditions)
# Processes of `run_jobs` import what they run: there a policy has to live in a module, not in the script.
for job in jobs:
    for condition, row in zip(job.conditions, do_policies(job), strict=True):
        print(
            f"{job.scene.goal:>7}, {condition.name:<12} success {row['success']!s:<5}  "
            f"grasped after {row['grasp_s']:4.1f} s  path of the hand {row['effort_m']:.2f} m"
        )
