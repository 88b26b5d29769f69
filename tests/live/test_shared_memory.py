"""Blocks, rings and mailboxes that processes share."""

import multiprocessing
from dataclasses import replace

import numpy as np
import pytest

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose
from optsc.live.columns import Columns
from optsc.live.hand_mailbox import COLUMNS, MOST_PENDING, PRESSABLE, TRIGGER, HandReader, HandReading, HandWriter
from optsc.live.ring import RowRing
from optsc.live.settings_block import COLUMNS as SETTINGS
from optsc.live.settings_block import LiveSettings
from optsc.live.shared_block import SharedBlock, SharedSegment
from optsc.operators import OperatorView
from optsc.operators.sample import Button
from optsc.selection import Cascade, WeightedSum

SIZE = 700
CONTEXT = multiprocessing.get_context("spawn")


def write_rows(name, count):
    with SharedSegment(name=name) as segment:
        block = SharedBlock(segment, SIZE)
        for value in range(1, count + 1):
            block.write(np.full(SIZE, float(value)))


def push_rows(name, count, capacity):
    with SharedSegment(name=name) as segment:
        ring = RowRing(segment, 20, capacity)
        for value in range(count):
            ring.push(np.full(20, float(value)))


def write_half_a_row(name):
    with SharedSegment(name=name) as segment:
        block = SharedBlock(segment, SIZE)
        block._front[0] += 1.0
        block._row[: SIZE // 2] = -1.0


def in_a_process(function, *arguments):
    process = CONTEXT.Process(target=function, args=arguments)
    process.start()
    return process


def test_a_row_read_while_another_process_writes_is_never_of_two_writings():
    with SharedSegment(SharedBlock.doubles(SIZE)) as segment:
        block, row, last = SharedBlock(segment, SIZE), np.zeros(SIZE), 0.0
        writer = in_a_process(write_rows, segment.name, 60_000)
        reads = 0
        while writer.is_alive():
            if block.read(row):
                assert row.min() == row.max() >= last
                last, reads = row[0], reads + 1
        writer.join()
        assert block.read(row)
        assert row[0] == 60_000.0
        assert block.count == 60_000
        assert reads > 100


def test_a_writer_that_died_in_the_middle_is_noticed_and_the_next_one_goes_on():
    with SharedSegment(SharedBlock.doubles(SIZE)) as segment:
        block, row = SharedBlock(segment, SIZE), np.zeros(SIZE)
        block.write(np.ones(SIZE))
        in_a_process(write_half_a_row, segment.name).join()
        assert not block.read(row)
        block.write(np.full(SIZE, 3.0))
        assert block.read(row)
        assert np.all(row == 3.0)


def test_a_block_that_was_never_written_has_nothing_to_read():
    with SharedSegment(SharedBlock.doubles(3)) as segment:
        assert not SharedBlock(segment, 3).read(np.zeros(3))


def test_a_ring_gives_every_row_of_another_process_in_order_or_says_how_many_it_lost():
    with SharedSegment(RowRing.doubles(20, 64)) as segment:
        ring = RowRing(segment, 20, 64)
        writer = in_a_process(push_rows, segment.name, 20_000, 64)
        rows, lost = [], 0
        while writer.is_alive() or ring.written < 20_000:
            drained = ring.drain()
            expected = len(rows) + lost + drained.lost
            values = drained.rows[:, 0].tolist()
            assert values == list(range(expected, expected + len(values)))
            assert np.all(drained.rows == drained.rows[:, :1])
            rows, lost = rows + values, lost + drained.lost
        drained = ring.drain()
        writer.join()
        assert len(rows) + lost + len(drained.rows) + drained.lost == 20_000


def test_the_rows_of_a_process_that_ended_can_still_be_read():
    with SharedSegment(RowRing.doubles(20, 64)) as segment:
        ring = RowRing(segment, 20, 64)
        in_a_process(push_rows, segment.name, 100, 64).join()
        rows, lost = ring.drain()
        # The place that may be written next is not trusted.
        assert rows[:, 0].tolist() == list(range(37, 100))
        assert lost == 37
        assert len(ring.drain().rows) == 0


def test_a_segment_is_gone_when_its_owner_closed_it():
    with SharedSegment(4) as segment:
        name = segment.name
        SharedSegment(name=name).close()
    with pytest.raises(InvalidValue, match="whose owner is running"):
        SharedSegment(name=name)


def test_a_segment_gives_no_more_than_it_has():
    with SharedSegment(4) as segment, pytest.raises(InvalidValue, match="doubles"):
        segment.take(10_000)


VIEW = OperatorView(0.0, Pose.from_translation([0.0, 0.0, 0.0]), False, False, {})


@pytest.fixture
def mailbox():
    with SharedSegment(SharedBlock.doubles(COLUMNS.size)) as segment:
        block = HandWriter.block(segment)
        yield HandWriter(block), HandReader(block)


def reading(x=0.0, engaged=True, pressed=()):
    return HandReading(1.0, (x, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), engaged, pressed)


def all_samples(reader, view=VIEW):
    return list(iter(lambda: reader.read(view), None))


@pytest.mark.parametrize("name", PRESSABLE)
@pytest.mark.parametrize("count", [1, 2, 5])
def test_presses_that_were_overtaken_are_handed_in_one_after_the_other(mailbox, name, count):
    writer, reader = mailbox
    for index in range(count):
        writer.post(reading(x=0.001 * index, pressed=[name]))
    writer.post(reading(x=0.2))
    samples = all_samples(reader)
    assert {sample.X_SH.translation[0] for sample in samples} == {0.2}
    down = [sample.trigger if name == TRIGGER else Button[name] in sample.buttons for sample in samples]
    rising = sum(now and not before for before, now in zip([False, *down], down, strict=False))
    assert rising == count
    assert not down[-1]


def test_the_newest_pose_is_read_once(mailbox):
    writer, reader = mailbox
    for x in (0.1, 0.2, 0.3):
        writer.post(reading(x))
    assert [sample.X_SH.translation[0] for sample in all_samples(reader)] == [0.3]
    assert reader.read(VIEW) is None


def test_a_stuck_button_does_not_press_for_ever(mailbox):
    writer, reader = mailbox
    for _ in range(500):
        writer.post(reading(pressed=[TRIGGER]))
    assert sum(sample.trigger for sample in all_samples(reader)) == MOST_PENDING


def test_what_was_pressed_before_the_run_is_not_for_it():
    with SharedSegment(SharedBlock.doubles(COLUMNS.size)) as segment:
        block = HandWriter.block(segment)
        HandWriter(block).post(reading(pressed=[TRIGGER] * 3))
        reader = HandReader(block)
        assert not any(sample.trigger for sample in all_samples(reader))


def test_a_writer_that_takes_the_place_of_one_that_died_loses_and_adds_no_press(mailbox):
    writer, reader = mailbox
    writer.post(reading(pressed=[TRIGGER]))
    HandWriter(writer._block).post(reading(pressed=[TRIGGER]))
    assert sum(sample.trigger for sample in all_samples(reader)) == 2


def test_letting_go_opens_the_clutch_and_is_no_new_sample_of_the_hand(mailbox):
    writer, reader = mailbox
    writer.post(reading(x=0.3))
    all_samples(reader)
    writer.let_go()
    (sample,) = all_samples(reader)
    assert not sample.clutch
    assert sample.stamp == 1.0
    assert sample.X_SH.translation[0] == 0.3


def test_taking_hold_while_the_robot_moves_by_itself_cancels_once(mailbox):
    writer, reader = mailbox
    automatic = VIEW._replace(automatic=True)
    writer.post(reading(engaged=False))
    assert Button.CANCEL not in reader.read(automatic).buttons
    writer.post(reading(engaged=True))
    assert Button.CANCEL in reader.read(automatic).buttons
    writer.post(reading(x=0.01, engaged=True))
    assert Button.CANCEL not in reader.read(VIEW).buttons


def test_holding_on_while_the_robot_takes_over_does_not_cancel(mailbox):
    writer, reader = mailbox
    writer.post(reading())
    reader.read(VIEW)
    writer.post(reading(x=0.01))
    assert Button.CANCEL not in reader.read(VIEW._replace(automatic=True)).buttons


def test_columns_name_every_number_of_a_row_once():
    columns = Columns({"time": 1, "q": 3, "none": 0, "error": 2})
    assert columns.size == 6
    assert columns["q"] == slice(1, 4)
    assert columns.at("time") == 0
    assert columns.labels == ("time", "q_0", "q_1", "q_2", "error_0", "error_1")
    with pytest.raises(UnknownName, match="error"):
        columns["eror"]
    with pytest.raises(InvalidValue, match="width"):
        columns.at("q")


@pytest.mark.parametrize(
    "settings",
    [LiveSettings(), LiveSettings(rule="weighted sum", travel=0.0), LiveSettings(scale=0.3, cutoff=5.0)],
)
def test_settings_come_back_from_their_row(settings):
    assert LiveSettings.of_row(settings.row()) == settings
    assert len(settings.row()) == SETTINGS.size


def test_settings_of_the_page_are_what_the_selector_ranks_by():
    cascade = LiveSettings(keep_orientation=12, keep_position=3).ranking_rule
    assert cascade == Cascade.paper(12, 3)
    weighted = LiveSettings(rule="weighted sum", position=0.0).ranking_rule
    assert isinstance(weighted, WeightedSum)
    assert [cost.name for cost in weighted.costs] == ["orientation", "manipulability", "joint travel"]


@pytest.mark.parametrize(
    "values",
    [{"scale": 0.0}, {"scale": float("nan")}, {"keep_position": 2.5}, {"rule": "magic"}, {"position": -1.0}, {"x": 1}],
)
def test_settings_out_of_their_range_are_refused(values):
    with pytest.raises((InvalidValue, UnknownName)):
        LiveSettings().changed(values)


def test_a_sum_of_nothing_is_refused():
    nothing = dict.fromkeys(("orientation", "position", "manipulability", "travel"), 0.0)
    with pytest.raises(InvalidValue, match="weights"):
        replace(LiveSettings(), rule="weighted sum", **nothing)
