"""What is shown while grasps are made and tried."""

import io

import pytest

from optsc.cli import progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def seconds(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_the_time_that_is_left_follows_from_the_pace_of_the_object(seconds, monkeypatch):
    out = Terminal()
    monkeypatch.setattr("sys.stderr", out)
    show = progress.counted_progress()
    seconds[0] += 30.0
    show("mug", 10, 40)
    seconds[0] += 90.0
    show("mug", 40, 40)
    seconds[0] += 5.0
    show("can", 1, 2)
    assert "mug: 10 of 40, 0:30 gone, 1:30 left" in out.getvalue()
    assert "mug: 40 of 40, 2:00 gone" in out.getvalue()
    assert "can: 1 of 2, 0:05 gone, 0:05 left" in out.getvalue()


def test_elsewhere_there_is_a_line_now_and_then_and_none_for_what_was_there(seconds, capsys):
    show = progress.counted_progress()
    show("box", 1, 1)
    for done in range(1, 31):
        seconds[0] += 1.0
        show("mug", done, 30)
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(",")[0] for line in lines] == [f"mug: {done} of 30" for done in (1, 11, 21, 30)]
