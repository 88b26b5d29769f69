"""A mailbox hands in the newest sample once, whoever posts and however quickly."""

from threading import Thread

from optsc.geometry import Pose
from optsc.operators import Mailbox, OperatorSample


def sample(stamp):
    return OperatorSample(stamp, Pose.identity())


def test_only_the_newest_sample_is_handed_in_and_only_once():
    box = Mailbox()
    assert box.read() is None
    for stamp in (0.0, 0.1, 0.2):
        box.post(sample(stamp))
    assert box.read().stamp == 0.2
    assert box.read() is None
    assert box.overtaken == 2


def test_a_reader_never_sees_time_go_back_while_another_thread_posts():
    box, count, seen = Mailbox(), 20_000, []

    def device():
        for k in range(count):
            box.post(sample(k / 1000))

    thread = Thread(target=device)
    thread.start()
    while thread.is_alive():
        got = box.read()
        if got is not None:
            seen.append(got.stamp)
    last = box.read()
    seen += [] if last is None else [last.stamp]
    assert seen == sorted(seen)
    assert seen[-1] == (count - 1) / 1000
    assert len(seen) + box.overtaken == count
