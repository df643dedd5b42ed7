"""The fault channel: every class does what it says, is counted, and depends on the seed alone."""

import random
from dataclasses import replace
from itertools import pairwise

import pytest

from sim_plc.relay.faults import FaultChannel, FaultCounts, Faults, FaultSettingsError

MS = 1_000_000
N = 2000


def datagrams(n=N):
    return [i.to_bytes(4, "little") * 16 for i in range(n)]


def number(datagram):
    return int.from_bytes(datagram[:4], "little")


def run(faults, seed=1, n=N, period_ms=10):
    """What comes out of n datagrams 10 ms apart: (time in ms, datagram), and the channel."""
    channel = FaultChannel(faults, random.Random(seed))
    out = []
    sent = datagrams(n)
    for t_ms in range(n * period_ms + 1000):
        if t_ms % period_ms == 0 and t_ms < n * period_ms:
            channel.push(sent[t_ms // period_ms], t_ms * MS)
        out += [(t_ms, datagram) for datagram in channel.pop(t_ms * MS)]
    assert channel.next_due_ns is None
    return out, channel


def passed(out):
    return [number(datagram) for _, datagram in out]


def test_the_neutral_channel_passes_everything_at_once_and_in_order():
    out, channel = run(Faults())
    assert out == [(10 * i, datagram) for i, datagram in enumerate(datagrams())]
    assert channel.counts == FaultCounts(taken=N, delivered=N)


def test_loss_takes_its_share():
    out, channel = run(Faults(loss_frac=0.3))
    assert channel.counts.lost + len(out) == N
    assert channel.counts.lost / N == pytest.approx(0.3, abs=0.04)  # four standard deviations


def test_everything_and_nothing_are_lost_exactly():
    assert run(Faults(loss_frac=1.0))[0] == []
    assert len(run(Faults(loss_frac=0.0))[0]) == N


def test_bursts_are_runs_of_their_length_with_something_between():
    out, channel = run(Faults(burst_frac=0.05, burst_length=10))
    kept = passed(out)
    gaps = {b - a - 1 for a, b in pairwise(kept)}
    assert gaps == {0, 10}
    assert channel.counts.burst == N - len(kept)
    always = passed(run(Faults(burst_frac=1.0, burst_length=10))[0])
    assert always == list(range(10, N, 11))


def test_duplicates_are_equal_and_counted():
    out, channel = run(Faults(duplicate_frac=0.2))
    assert len(out) == N + channel.counts.duplicated == channel.counts.delivered
    assert channel.counts.duplicated / N == pytest.approx(0.2, abs=0.036)
    assert sorted(set(passed(out))) == list(range(N))


def test_reordered_ones_are_overtaken_but_not_lost():
    out, channel = run(Faults(reorder_frac=0.1, reorder_ms=25.0))
    assert sorted(passed(out)) == list(range(N))
    assert passed(out) != list(range(N))
    late = [(t_ms, number(datagram)) for t_ms, datagram in out if t_ms != 10 * number(datagram)]
    assert len(late) == channel.counts.reordered > N * 0.07
    assert all(t_ms - 10 * i == 25 for t_ms, i in late)
    assert 0 < channel.counts.overtaken <= channel.counts.reordered


def test_delay_and_jitter_stay_in_their_range():
    out, channel = run(Faults(delay_ms=20.0, jitter_ms=40.0))
    delays = [t_ms - 10 * number(datagram) for t_ms, datagram in out]
    assert len(out) == N
    assert min(delays) in (20, 21)
    assert max(delays) in (59, 60)
    assert channel.counts.overtaken > N * 0.3


def test_corruption_flips_one_to_eight_bits():
    out, channel = run(Faults(corrupt_frac=0.25))
    flips = [(int.from_bytes(a, "little") ^ int.from_bytes(b, "little")).bit_count()
             for (_, a), b in zip(out, datagrams(), strict=True)]  # fmt: skip
    assert set(flips) == set(range(9))
    assert sum(flip > 0 for flip in flips) == channel.counts.corrupted


def test_truncation_shortens_down_to_nothing():
    out, channel = run(Faults(truncate_frac=0.5))
    lengths = [len(datagram) for _, datagram in out]
    assert channel.counts.truncated == sum(length < 64 for length in lengths)
    assert set(lengths) == set(range(65))
    assert all(whole.startswith(cut) for (_, cut), whole in zip(out, datagrams(), strict=True))


def test_an_empty_datagram_passes_through_every_class():
    faults = Faults(corrupt_frac=1.0, truncate_frac=1.0, duplicate_frac=1.0, replay_frac=1.0)
    channel = FaultChannel(faults, random.Random(1))
    channel.push(b"", 0)
    assert channel.pop(0) == [b"", b""]


def test_a_cut_ends_exactly():
    out, channel = run(Faults(cut_windows_s=((1.0, 2.0), (5.0, 5.05))), n=1000)
    assert passed(out) == [i for i in range(1000) if not 100 <= i < 200 and not 500 <= i < 505]
    assert channel.counts.cut == 105


def test_a_frozen_channel_repeats_the_last_datagram_from_before():
    out, channel = run(Faults(freeze_windows_s=((1.0, 1.5),)), n=300)
    assert passed(out) == [99 if 100 <= i < 150 else i for i in range(300)]
    assert channel.counts.frozen == 50
    assert passed(run(Faults(freeze_windows_s=((0.0, 0.05),)), n=10)[0]) == [0, 0, 0, 0, 0, 5, 6, 7, 8, 9]


def test_replays_bring_old_ones_again_behind_the_new():
    out, channel = run(Faults(replay_frac=0.2))
    seen, extra = set(), 0
    for i in passed(out):
        extra += i in seen
        seen.add(i)
    assert extra == channel.counts.replayed > N * 0.15
    assert seen == set(range(N))


def test_the_same_seed_gives_the_same_and_another_seed_another():
    faults = Faults(0.1, 0.02, 5, 0.1, 0.1, 30.0, 5.0, 20.0, 0.1, 0.1, 0.1, ((1, 2),), ((3, 4),))
    first, one = run(faults, seed=7)
    again, two = run(faults, seed=7)
    other, _ = run(faults, seed=8)
    assert first == again
    assert one.counts == two.counts
    assert first != other


def test_one_class_leaves_the_pattern_of_another_alone():
    plain = run(Faults(loss_frac=0.3))[1].counts.lost
    faults = Faults(loss_frac=0.3, duplicate_frac=0.5, corrupt_frac=0.5, jitter_ms=9.0, reorder_frac=0.2)
    out, channel = run(faults)
    assert channel.counts.lost == plain
    assert len(out) == N - plain + channel.counts.duplicated


def test_faults_may_change_on_the_way():
    channel = FaultChannel(Faults(delay_ms=100.0), random.Random(1))
    channel.push(b"slow", 0)
    channel.faults = replace(channel.faults, delay_ms=0.0)
    channel.push(b"fast", 10 * MS)
    assert channel.pop(50 * MS) == [b"fast"]
    assert channel.next_due_ns == 100 * MS
    assert channel.pop(100 * MS) == [b"slow"]
    assert channel.counts.overtaken == 1


def test_what_is_on_its_way_can_be_forgotten():
    channel = FaultChannel(Faults(delay_ms=5.0), random.Random(1))
    channel.push(b"one", 0)
    channel.push(b"two", MS)
    assert channel.pop(5 * MS) == [b"one"]
    channel.lose_pending()
    assert channel.next_due_ns is None
    assert channel.counts == FaultCounts(taken=2, delivered=1, cut=1)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("loss_frac", -0.01), ("loss_frac", 1.01), ("burst_frac", 2.0), ("duplicate_frac", float("nan")),
        ("delay_ms", -1.0), ("jitter_ms", 60_001.0), ("burst_length", 0), ("cut_windows_s", ((2.0, 1.0),)),
        ("freeze_windows_s", ((0.0, 1.0), (5.0, 4.0))),
    ],
)  # fmt: skip
def test_a_bad_setting_is_named(name, value):
    with pytest.raises(FaultSettingsError, match=name):
        Faults(**{name: value})


def test_counts_add_up():
    total = FaultCounts()
    total.add(FaultCounts(taken=3, lost=1))
    total.add(FaultCounts(taken=2, cut=2))
    assert total == FaultCounts(taken=5, lost=1, cut=2)
