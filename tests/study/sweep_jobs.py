"""Jobs that cost nothing, and a store that counts, for the tests of sweeps."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from optsc.study.sweep.store import RowStore


@dataclass(frozen=True)
class FakeScene:
    hash: str
    robot: str = "none"
    seed: int = 0


@dataclass(frozen=True)
class FakeJob:
    """A job without an arm: numbers from its name."""

    scene: FakeScene
    conditions: tuple

    def keys(self):
        return [f"{self.scene.hash}-{c}" for c in self.conditions]

    def labels(self, condition):
        return {"scene": self.scene.hash, "condition": condition}


class Counting(RowStore):
    """A store that remembers every key that it was given, also those that it had."""

    def __init__(self, directory):
        super().__init__(directory)
        self.given = []

    def add(self, rows):
        self.given += [row["key"] for row in rows]
        return super().add(rows)


def fake_jobs(scenes=6, settings=5):
    return [FakeJob(FakeScene(f"s{k}"), tuple(range(settings))) for k in range(scenes)]


def fake_work(job):
    return [{"key": k, "value": float(len(k)), "word": job.scene.hash} for k in job.keys()]  # noqa: SIM118


def failing_work(job):
    if job.scene.hash == "s3":
        raise ValueError("this one never works")
    return fake_work(job)


def endless_work(job):
    """Work that no one waits for, but for that of the first job."""
    if job.scene.hash != "s0":
        time.sleep(600.0)
    return fake_work(job)


def mortal_work(job):
    """Die once, in the middle of the sweep, together with the process that this runs in."""
    mark = Path(os.environ["OPTSC_TEST_MARK"])
    if job.scene.hash == "s4" and not mark.exists():
        mark.write_text("dead")
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.02)
    return fake_work(job)
