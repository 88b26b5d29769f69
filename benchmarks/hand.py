"""How well a recorded human hand is followed: lag, error, jerk and limits, over arms and settings.

    python -m benchmarks.hand --robots panda ur5 iiwa --rates 500 1000 --output results
    python -m benchmarks.hand --sweep --output results          # the trade-off of lag, error and jerk, with a picture

The recording is cut into stretches of 4 s. At the start of each the arm stands at home and the clutch engages the hand
in motion, with relative orientation; samples come every 20 ms.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.machine import markdown_table, save
from optsc.control.servo import Command, Servo, ServoSettings, Status
from optsc.geometry import Pose, rotation
from optsc.metrics import limit_violations
from optsc.operators import ClutchSettings, HandRecording, PredictionSettings
from optsc.operators.clutch import Hand, engage, follow
from optsc.robot import RobotModel, load_robot

STRETCH = 200
"""Samples of a stretch: 4 s."""
ENGAGING = 0.2
"""From the engagement of a moving hand on [s]: the arm has to catch up from rest."""
LAGS = np.arange(0.0, 0.1501, 0.001)
"""Lags that are tried [s]."""
FREE, HINDSIGHT = 5.0, 5.0
"""How much wider rate limits are, and the cut-off [Hz], where it is asked what a motion needs."""
BAR = "lag <= 30 ms, error <= 2 mm and 1 deg, jerk <= 5 %, no violation, always following"

MakeServo = Callable[[RobotModel, float], Servo]


class Drive(NamedTuple):
    """What a stretch asked for and what was commanded: target poses (M,), their times, and every tick."""

    targets: Pose
    stamps: np.ndarray
    commands: list[Command]


@dataclass(frozen=True)
class StretchResult:
    """How one stretch was followed.

    Attributes:
        first: index of its first sample in the recording.
        lag: that leaves the least position error [ms].
        error, angle: rms error after the lag [mm, deg].
        jerk_worst, jerk_mean: rms jerk as share of the limit [%]: of the worst joint, and over all joints.
        jerk_later: of the worst joint, without the time of engaging [%].
        following, following_later: share of ticks with that status [%], of all and without the time of engaging.
        violations: of limits, at 1e-9.
        demand: what the motion asks of the joints, see `demand`, as share of their limits.
        reachable: no tick was out of reach or held back by a position limit, and the joints are not asked for more than
            they have.
        statuses: how many ticks of each status and reason.
    """

    first: int
    lag: float
    error: float
    angle: float
    jerk_worst: float
    jerk_mean: float
    jerk_later: float
    following: float
    following_later: float
    violations: int
    demand: float
    reachable: bool
    statuses: dict[str, int]


class Plan(NamedTuple):
    """How the hand is coupled.

    Attributes:
        scale: of position and rotation.
        fade: see `ClutchSettings.fade` [s]; None for its default.
        starts: first sample of each stretch.
        count: samples of a stretch.
    """

    scale: float
    fade: float | None
    starts: Sequence[int]
    count: int

    @property
    def clutch(self) -> ClutchSettings:
        """The clutch's settings; without a fade of its own the clutch's default."""
        fade = {} if self.fade is None else {"fade": self.fade}
        return ClutchSettings(scale=self.scale, rotation_scale=self.scale, orientation="relative", **fade)


def drive(servo: Servo, hand: HandRecording, first: int, plan: Plan) -> Drive:
    """Let the hand's samples from ``first`` on drive the arm from home, through the clutch."""
    servo.reset(servo.robot.home)
    p_SH, q_SH = hand.X_SH.translation.tolist(), hand.X_SH.quaternion.tolist()
    stamps = hand.time[first : first + plan.count] - hand.time[first]
    settings, state, targets, commands = plan.clutch, None, [], []
    for k, stamp in enumerate(stamps):
        sample = Hand(tuple(p_SH[first + k]), tuple(q_SH[first + k]), servo.time)
        state = engage(settings, sample, *servo.reference) if state is None else follow(settings, state, sample)
        servo.observe(state.tool_p, state.tool_q, servo.time)
        targets.append((*state.tool_q, *state.tool_p))
        until = stamp + (stamps[1] - stamps[0]) if k + 1 == len(stamps) else stamps[k + 1]
        while servo.time < until - 1e-9:
            commands.append(servo.step())
    rows = np.array(targets)
    return Drive(Pose(rows[:, :4], rows[:, 4:]), stamps, commands)


def interpolated(path: Drive, t: np.ndarray) -> Pose:
    """Return the target at times ``t`` (N,), on the straight line between its samples."""
    q = path.targets.quaternion.copy()
    flips = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0))
    q[1:] *= flips[:, None]
    q = np.column_stack([np.interp(t, path.stamps, x) for x in q.T])
    p = np.column_stack([np.interp(t, path.stamps, x) for x in path.targets.translation.T])
    return Pose(q / np.linalg.norm(q, axis=1, keepdims=True), p)


def lag_and_error(path: Drive, tool: Pose, t: np.ndarray) -> tuple[float, float, float]:
    """Return the lag [s] of least rms error, and that error of position [m] and angle [rad]."""
    best = (0.0, np.inf, np.inf)
    for lag in LAGS:
        inside = (t - lag >= 0.0) & (t - lag <= path.stamps[-1])
        wanted = interpolated(path, t[inside] - lag)
        error = np.sqrt(np.mean(np.sum((tool.translation[inside] - wanted.translation) ** 2, axis=1)))
        if error < best[1]:
            angle = rotation.angle(wanted.quaternion, tool.quaternion[inside])
            best = (float(lag), float(error), float(np.sqrt(np.mean(angle**2))))
    return best


def demand(servo: Servo, hand: HandRecording, first: int, plan: Plan) -> float:
    """Return the greatest velocity and acceleration that a stretch asks of a joint, as share of its limit.

    Asked by an arm whose rates are limited `FREE` times as widely, and smoothed with hindsight (5 Hz, zero phase): what
    no controller with these limits could do without.
    """
    from scipy.signal import butter, filtfilt

    limits = servo.robot.limits
    rates = {name: FREE * getattr(limits, name) for name in ("velocity", "acceleration", "jerk")}
    servo.set_limits(replace(limits, **rates))
    try:
        v = np.array([command.v for command in drive(servo, hand, first, plan).commands])
    finally:
        servo.set_limits(limits)
    smooth = filtfilt(*butter(2, HINDSIGHT / (0.5 * servo.rate)), v, axis=0)
    asked = np.abs(np.diff(smooth, axis=0)) * servo.rate / limits.acceleration
    return float(max(asked.max(), (np.abs(smooth) / limits.velocity).max()))


def evaluate(servo: Servo, hand: HandRecording, first: int, plan: Plan) -> StretchResult:
    """Drive one stretch and measure it."""
    asked = demand(servo, hand, first, plan)
    path, robot, rate = drive(servo, hand, first, plan), servo.robot, servo.rate
    q, v, a = (np.array([getattr(c, x) for c in path.commands]) for x in "qva")
    stride = max(1, round(rate / 250.0))
    t = (np.arange(len(q)) + 1.0) / rate
    lag, error, angle = lag_and_error(path, robot.forward(q[::stride]), t[::stride])
    limits = asdict(robot.limits)
    violations = limit_violations(rate, q, v, a, **limits).total
    shares = np.diff(a, axis=0, prepend=0.0) * rate / robot.limits.jerk
    later = int(ENGAGING * rate)
    follows = np.array([c.status is Status.FOLLOWING for c in path.commands])
    statuses = Counter(f"{c.status.name} {c.reason}".strip() for c in path.commands)
    reached = not any(s.startswith("UNREACHABLE") or s.endswith("position") for s in statuses)
    return StretchResult(
        first,
        1e3 * lag,
        1e3 * error,
        float(np.degrees(angle)),
        100.0 * float(np.sqrt(np.mean(shares**2, axis=0)).max()),
        100.0 * float(np.sqrt(np.mean(shares**2))),
        100.0 * float(np.sqrt(np.mean(shares[later:] ** 2, axis=0)).max()),
        100.0 * float(np.mean(follows)),
        100.0 * float(np.mean(follows[later:])),
        violations,
        asked,
        reached and asked <= 1.0,
        dict(statuses.most_common()),
    )


def run(make: MakeServo, robot: RobotModel, rate: float, plan: Plan) -> list[StretchResult]:
    """Return how each stretch is followed."""
    hand, servo = HandRecording.example(), make(robot, rate)
    return [evaluate(servo, hand, first, plan) for first in plan.starts]


NUMBERS = ("lag", "error", "angle", "jerk_worst", "jerk_mean", "jerk_later", "following", "following_later")


def summary_of(results: Sequence[StretchResult]) -> dict[str, float]:
    """Return medians over the reachable stretches, and the counts over all."""
    kept = [r for r in results if r.reachable] or list(results)
    found = {name: float(np.median([getattr(r, name) for r in kept])) for name in NUMBERS}
    return {
        **found,
        "reachable": sum(r.reachable for r in results),
        "stretches": len(results),
        "violations": sum(r.violations for r in results),
        "following_least": min(r.following for r in kept),
        "jerk_greatest": max(r.jerk_worst for r in kept),
    }


def row_of(name: str, s: dict[str, float]) -> list[str]:
    """Return a row of the table of medians."""
    return [
        name,
        f"{s['reachable']} of {s['stretches']}",
        f"{s['lag']:.0f}",
        f"{s['error']:.2f}",
        f"{s['angle']:.2f}",
        f"{s['jerk_worst']:.1f}",
        f"{s['jerk_mean']:.1f}",
        f"{s['jerk_later']:.1f}",
        f"{s['following']:.2f}",
        f"{s['following_later']:.2f}",
        f"{s['violations']}",
    ]


HEADER = [
    "medians over reachable stretches",
    "reachable",
    "lag [ms]",
    "error [mm]",
    "angle [deg]",
    "rms jerk, worst joint [%]",
    "all joints [%]",
    "worst joint, after 0.2 s [%]",
    "following [% of ticks]",
    "after 0.2 s [%]",
    "violations (all stretches)",
]


def settings_of(o: argparse.Namespace) -> ServoSettings:
    """Return the servo's settings with what the command line replaces."""
    found = ServoSettings()
    if o.memory is not None:
        found = replace(found, prediction=replace(found.prediction, memory=o.memory))
    for name in ("bandwidth", "lag", "led"):
        if getattr(o, name) is not None:
            found = replace(found, **{name: getattr(o, name)})
    return found


def track(o: argparse.Namespace, plans: Sequence[Plan]) -> tuple[dict[str, Any], str]:
    """Return numbers and text of the runs with one choice of settings."""
    settings, rows, facts = settings_of(o), [], {}
    details = []
    for name in o.robots:
        robot = load_robot(name)
        for rate in o.rates:
            for plan in plans:
                results = run(lambda r, f: Servo(r, f, settings), robot, rate, plan)
                label = f"{name}, {rate:.0f} Hz, scale {plan.scale}"
                rows.append(row_of(label, summary_of(results)))
                facts[label] = {"medians": summary_of(results), "stretches": [asdict(r) for r in results]}
                details.append(detail(label, results))
    text = "\n\n".join([f"Bar: {BAR}.", markdown_table(HEADER, rows), *details])
    return {"settings": asdict(settings), "runs": facts}, text


def detail(label: str, results: Sequence[StretchResult]) -> str:
    """Return one line per stretch."""
    rows = []
    for r in results:
        held = "; ".join(f"{what} {n}" for what, n in list(r.statuses.items())[:4] if what != "FOLLOWING")
        numbers = [f"{getattr(r, n):.2f}" for n in ("error", "angle", "jerk_worst", "following", "demand")]
        rows.append([str(r.first), f"{r.lag:.0f}", *numbers, "yes" if r.reachable else "no", held])
    header = [
        "from sample",
        "lag [ms]",
        "error [mm]",
        "angle [deg]",
        "jerk [%]",
        "following [%]",
        "asked of the limits",
        "reachable",
    ]
    return f"**{label}**\n\n{markdown_table([*header, 'ticks otherwise'], rows)}"


SWEEP = {
    "bandwidth": (35.0, 45.0, 55.0, 70.0, 90.0),
    "lag": (0.0, 0.014, 0.028, 0.042),
    "memory": (0.02, 0.035, 0.05),
}


def sweep(o: argparse.Namespace, plan: Plan) -> tuple[dict[str, Any], str]:
    """Return numbers and text of all combinations of `SWEEP` on the first arm, and draw them."""
    robot, rate, points = load_robot(o.robots[0]), o.rates[0], []
    for bandwidth in SWEEP["bandwidth"]:
        for lag in SWEEP["lag"]:
            for memory in SWEEP["memory"]:
                settings = ServoSettings(bandwidth=bandwidth, lag=lag, prediction=PredictionSettings(memory=memory))
                make = lambda r, f, s=settings: Servo(r, f, s)  # noqa: E731
                found = summary_of(run(make, robot, rate, plan))
                points.append({"bandwidth": bandwidth, "lag set": lag, "memory": memory, **found})
                print(".", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    points.sort(key=lambda p: p["lag"])
    label = f"{robot.name}, {rate:.0f} Hz, scale {plan.scale}"
    rows = [row_of(f"{p['bandwidth']:.0f} rad/s, {p['lag set']} s, memory {p['memory']} s", p) for p in points]
    if o.output is not None:
        picture(points, label, o.output)
    return {"what": label, "points": points}, f"{label}\n\n{markdown_table(HEADER, rows)}"


def picture(points: Sequence[dict[str, float]], label: str, directory: Path) -> None:
    """Draw jerk over lag, coloured by error."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7.0, 4.5), layout="constrained")
    dots = axes.scatter(
        [p["lag"] for p in points],
        [p["jerk_worst"] for p in points],
        c=[min(p["error"], 3.0) for p in points],
        s=[20.0 + 0.8 * p["bandwidth"] for p in points],
        cmap="viridis_r",
    )
    figure.colorbar(dots, label="rms error after the lag [mm], 3 and above alike")
    axes.axvline(30.0, color="0.6", linestyle="--", linewidth=1.0)
    axes.axhline(5.0, color="0.6", linestyle="--", linewidth=1.0)
    axes.set(xlabel="lag [ms]", ylabel="rms jerk, worst joint [% of its limit]", ylim=(0.0, None))
    axes.set_title(f"{label}: larger dots, higher bandwidth; dashed: the bar", fontsize=9)
    directory.mkdir(parents=True, exist_ok=True)
    figure.savefig(directory / "hand_sweep.png", dpi=130)
    pyplot.close(figure)


def main(arguments: list[str] | None = None) -> None:
    """Measure and report."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hand", description=__doc__.split("\n")[0])
    parser.add_argument("--robots", nargs="+", default=["panda", "ur5", "iiwa"])
    parser.add_argument("--rates", nargs="+", type=float, default=[500.0, 1000.0], metavar="HZ")
    parser.add_argument("--scales", nargs="+", type=float, default=[0.3], help="of position and rotation")
    parser.add_argument("--fade", type=float, help="of the motion after engaging [s] (default: the clutch's)")
    parser.add_argument("--every", type=int, default=STRETCH, metavar="SAMPLES", help="from start to start")
    parser.add_argument("--stretches", type=int, help="at most so many (default: all there are)")
    parser.add_argument("--samples", type=int, default=STRETCH, help=f"of a stretch (default {STRETCH})")
    parser.add_argument("--bandwidth", type=float, help="of the reference model [rad/s]")
    parser.add_argument("--lag", type=float, help="behind the stream of samples [s]")
    parser.add_argument("--led", type=float, help="share of the acceleration that is led along")
    parser.add_argument("--memory", type=float, help="of the prediction [s]")
    parser.add_argument("--sweep", action="store_true", help="all of several settings on the first arm")
    parser.add_argument("--output", type=Path, metavar="DIR", help="where numbers, text and picture go")
    o = parser.parse_args(arguments)
    starts = list(range(0, len(HandRecording.example()) - o.samples + 1, o.every))[: o.stretches]
    plans = [Plan(scale, o.fade, starts, o.samples) for scale in o.scales]
    facts, text = sweep(o, plans[0]) if o.sweep else track(o, plans)
    command = "python -m benchmarks.hand " + " ".join(sys.argv[1:] if arguments is None else arguments)
    save(o.output, "hand_sweep" if o.sweep else "hand", facts, text, command.strip())


if __name__ == "__main__":
    main()
