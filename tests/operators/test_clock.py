"""Clock mapping: nothing is newer than its arrival, offset and drift are learnt, a wrong stamp poisons nothing."""

import math

import numpy as np
import pytest

from optsc.operators.clock import OLDEST, ClockMapping, Refusal

TRUE = np.arange(0.0, 20.0, 0.01)
SETTLED = TRUE > 3.0


def mapped(stamps, arrivals, steady=False):
    """Return the mapping, the mapped stamps (NaN where refused) and the refusals."""
    clock, times, refusals = ClockMapping(), [], []
    for stamp, arrival in zip(stamps, arrivals, strict=True):
        clock, time, refusal = clock.read(stamp, arrival, 1e5 if steady else None)
        times.append(math.nan if time is None else time)
        refusals.append(refusal)
    return clock, np.array(times), refusals


def network(seed, jitter, latency=0.002):
    """Return arrivals of samples, in order."""
    way = np.random.default_rng(seed).exponential(jitter, len(TRUE)) if jitter else 0.0
    return np.maximum.accumulate(TRUE + latency + way) + 1e-9 * np.arange(len(TRUE))


@pytest.mark.parametrize("latency", [0.0, 0.004, 0.05, 0.099])
@pytest.mark.parametrize("steady", [True, False])
def test_stamps_of_the_loops_own_clock_stay_as_they_are_to_the_last_bit(latency, steady):
    arrivals = np.ceil((TRUE + latency) / 0.002) * 0.002  # at ticks
    clock, times, refusals = mapped(TRUE, arrivals, steady)
    assert not clock.foreign
    assert times.tolist() == TRUE.tolist()
    assert set(refusals) == {None}


def test_stamps_on_the_clock_that_the_loop_tells_keep_their_latencies():
    clock, times = ClockMapping(), []
    for stamp, arrival in zip((TRUE + 1.7e9).tolist(), (TRUE + 0.045).tolist(), strict=True):
        clock, time, _ = clock.read(stamp, arrival, 1.7e9)
        times.append(time)
    assert not clock.foreign
    np.testing.assert_allclose(times, TRUE, atol=1e-6)


@pytest.mark.parametrize("steady", [True, False])
@pytest.mark.parametrize("jitter", [0.0, 0.003, 0.01])
@pytest.mark.parametrize("drift", [0.0, 1e-4, -1e-4, 5e-3, -5e-3])
@pytest.mark.parametrize("offset", [1.0, -10.0, 1.7e9])
def test_offset_and_drift_of_a_foreign_clock_are_learnt(offset, drift, jitter, steady):
    clock, times, refusals = mapped(TRUE * (1.0 + drift) + offset, network(1, jitter), steady)
    assert clock.foreign
    assert set(refusals) == {None}
    # What every sample takes at least cannot be told from an offset: 2 ms.
    error = times - TRUE - 0.002
    assert np.abs(error[SETTLED]).max() < 1e-4 + 0.5 * jitter + 1e-6 * (abs(offset) > 1e6)
    assert clock.line.drift == pytest.approx(-drift, abs=1e-4 + 0.15 * jitter)


@pytest.mark.parametrize("drift", [0.3, 0.1, 0.02, -0.02, -0.1, -0.3])
def test_a_loop_that_counts_ticks_may_be_far_from_the_clock_of_the_device(drift):
    clock, times, _ = mapped(TRUE * (1.0 + drift), network(1, 0.003))
    assert np.nanmax(np.abs(times - TRUE)[SETTLED]) < 0.02
    assert np.isfinite(times[SETTLED]).all()
    assert clock.line.drift == pytest.approx(-drift, abs=0.01)


def test_own_clocks_that_turn_out_to_drift_are_mapped_from_then_on():
    clock, times, refusals = mapped(TRUE * (1.0 - 1e-2), network(2, 0.003), True)
    assert clock.foreign
    assert set(refusals) == {None}
    assert np.abs(times - TRUE)[TRUE > 6.0].max() < 0.006


@pytest.mark.parametrize("seed", range(20))
def test_whatever_the_stamps_are_none_counts_as_newer_than_its_arrival_and_times_never_go_back(seed):
    rng = np.random.default_rng(seed)
    arrivals = np.cumsum(rng.exponential(0.01, 3000))
    scale = 10.0 ** rng.uniform(-4.0, 9.0, 3000)
    liar = rng.random(3000) < rng.choice([0.01, 0.5, 1.0])
    stamps = np.where(liar, arrivals + scale * rng.normal(size=3000), arrivals - 0.01)
    stamps[rng.random(3000) < 0.01] = rng.choice([np.nan, np.inf, -np.inf, 1e300])
    _, times, _ = mapped(stamps.tolist(), arrivals.tolist(), bool(seed % 2))
    used = np.isfinite(times)
    assert used.any()
    assert (times[used] <= arrivals[used]).all()
    assert (np.diff(times[used]) >= 0.0).all()
    assert (arrivals[used] - times[used] <= OLDEST + 1e-9).all()


@pytest.mark.parametrize("offset", [0.0, 5.0])
@pytest.mark.parametrize("wrong", [60.0, 1.0, 0.3, 0.15, 0.08, 0.02, -0.5, -30.0, 1e300, math.nan, math.inf])
def test_one_wrong_stamp_does_not_poison_the_ones_behind_it(wrong, offset):
    stamps, arrivals = TRUE + offset, TRUE + 0.004
    good = mapped(stamps, arrivals)[1]
    stamps[500] += wrong
    _, times, refusals = mapped(stamps, arrivals)
    np.testing.assert_allclose(times[501:], good[501:], atol=1e-9)
    assert set(refusals[:500] + refusals[501:]) == {None}
    assert not times[500] > arrivals[500]


@pytest.mark.parametrize("first", [60.0, -60.0, 1e11])
def test_a_first_stamp_that_is_wrong_costs_a_few_samples(first):
    stamps = TRUE.copy()
    stamps[0] += first
    _, times, refusals = mapped(stamps, TRUE + 0.004)
    assert refusals[4:] == [None] * (len(TRUE) - 4)
    assert np.abs(times - TRUE)[4:].max() < 0.005


@pytest.mark.parametrize("jump", [100.0, 5.0, 0.3, -0.5, -1.5, -100.0])
@pytest.mark.parametrize("offset", [0.0, 3.0])
def test_a_clock_that_restarts_is_followed_within_a_few_samples(jump, offset):
    stamps = np.where(TRUE < 10.0, TRUE, TRUE + jump) + offset
    clock, times, refusals = mapped(stamps, network(3, 0.002), True)
    assert clock.restarts == 1
    lost = sum(refusal is not None for refusal in refusals)
    assert lost <= (1 if jump > 0.0 else 3 if jump < -1.0 else 13)
    assert np.nanmax(np.abs(times - TRUE)[TRUE > 11.0]) < 0.01


@pytest.mark.parametrize("ahead", [1.0, 0.4, 30.0])
@pytest.mark.parametrize("gap", [0.0, 3.0])
def test_a_clock_that_was_set_and_is_right_again_is_the_loops_own_at_once(ahead, gap):
    wrong = (TRUE > 5.0) & (TRUE < 6.0)
    kept = ~((TRUE > 6.0) & (6.0 + gap > TRUE))
    stamps = np.where(wrong, TRUE + ahead, TRUE)
    clock, times, refusals = mapped(stamps[kept], TRUE[kept] + 0.03)
    assert not clock.foreign
    assert sum(refusal is not None for refusal in refusals) <= 2
    again = TRUE[kept] > 6.02 + gap
    assert times[again].tolist() == TRUE[kept][again].tolist()


def test_late_and_duplicate_packets_are_told_apart_and_change_nothing():
    clock, times, refusals = mapped([1.0, 1.01, 1.02, 1.01, 1.02, 1.02 - 1e-9, 1.03], np.arange(7) * 0.01 + 5.0)
    assert refusals == [None, None, None, Refusal.LATE, Refusal.DUPLICATE, Refusal.LATE, None]
    assert clock.stamp == 1.03
    assert np.isfinite(times[-1])


def test_packets_that_come_a_second_time_on_a_slower_way_are_late():
    both = np.concatenate([TRUE, TRUE])
    arrivals = np.concatenate([TRUE + 0.003, TRUE + 0.0835])
    order = np.argsort(arrivals)
    clock, _, refusals = mapped(both[order] + 7.0, arrivals[order], True)
    refused = np.array([refusal is not None for refusal in refusals])
    assert (refused == (order >= len(TRUE))).all()
    assert clock.restarts == 0


@pytest.mark.parametrize("overtaken", [False, True])
def test_a_backlog_that_is_handed_in_after_a_pause_is_late_and_what_is_fresh_again_is_not(overtaken):
    waiting = (TRUE > 5.0) & (TRUE < 8.0)
    arrivals = np.where(waiting, 8.0 + (TRUE - 5.0) / 10.0, TRUE + 0.003)
    if not overtaken:
        arrivals = np.maximum.accumulate(arrivals) + 1e-9 * np.arange(len(TRUE))
    order = np.argsort(arrivals, kind="stable")
    clock, times, refusals = mapped(TRUE[order] + 7.0, arrivals[order], True)
    old = arrivals[order] - TRUE[order] > OLDEST + 0.05
    assert {refusals[k] for k in np.flatnonzero(old)} == {Refusal.LATE}
    assert np.isfinite(times[TRUE[order] > 8.5]).all()
    assert clock.restarts == 0


def test_delays_that_keep_growing_are_no_drift_where_the_loop_has_a_clock():
    arrivals = TRUE + 0.003 + 0.2 * np.maximum(TRUE - 5.0, 0.0)
    _, times, _ = mapped(TRUE + 7.0, arrivals, True)
    assert np.isfinite(times[TRUE < 6.0]).all()
    assert np.isnan(times[TRUE > 7.0]).all()


def test_samples_that_keep_waiting_in_a_queue_are_taken_for_those_of_a_clock_that_stood_still():
    arrivals = np.where(TRUE < 5.0, TRUE, TRUE + 3.0) + 0.003
    clock, times, _ = mapped(TRUE + 7.0, arrivals, True)
    assert np.isnan(times[(TRUE > 5.0) & (TRUE < 5.9)]).all()
    assert np.isfinite(times[TRUE > 6.1]).all()
    assert clock.restarts == 1


@pytest.mark.parametrize("stamp", ["soon", "1.0", None, [1.0], np.array([1.0]), 10**400, 1.7e18, object()])
def test_what_is_no_time_in_seconds_is_refused(stamp):
    for clock in (ClockMapping(), ClockMapping().read(1.0, 1.0).clock):
        after, time, refusal = clock.read(stamp, 1.1)
        assert (after, time, refusal) == (clock, None, Refusal.NOT_A_TIME)


def test_the_mapping_is_a_value_and_the_same_samples_give_the_same_mapping():
    stamps, arrivals = TRUE[:700] + 3.0, network(5, 0.004)[:700]
    half = mapped(stamps[:300], arrivals[:300])[0]
    once, again = half, half
    for stamp, arrival in zip(stamps[300:].tolist(), arrivals[300:].tolist(), strict=True):
        once = once.read(stamp, arrival).clock
    for stamp, arrival in zip(stamps[300:].tolist(), arrivals[300:].tolist(), strict=True):
        again = again.read(stamp, arrival).clock
    assert once == again == mapped(stamps, arrivals)[0]
