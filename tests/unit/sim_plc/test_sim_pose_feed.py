"""The pose feed: interpolation, bounds, torn entries, and a reader in another process."""

import multiprocessing
import struct

import numpy as np
import pytest

from machine.poses import pose
from machine.rotations import geodesic_angle, rotation_from_rotvec
from sim_plc.pose_feed import N_RING_SLOTS, PoseFeed, PoseFeedError

MS = 1_000_000


def pose_of(t_ns):
    """A tool that turns and travels steadily: 0.3 rad/s about a skew axis, 0.15 m/s."""
    t = t_ns * 1e-9
    return pose(rotation_from_rotvec(np.array([0.1, 0.2, -0.2]) * t), np.array([0.1, 0.1, 0.05]) * t)


@pytest.fixture
def feed():
    made = PoseFeed.create(epoch_offset_ns=123)
    yield made
    made.close()


def test_poses_are_interpolated_between_entries(feed):
    for i in range(100):
        feed.publish(i * 10 * MS, pose_of(i * 10 * MS))
    assert feed.latest_t_ns() == 990 * MS
    assert feed.epoch_offset_ns == 123
    for t_ns in (0, 5 * MS, 333_333_333, 990 * MS):
        got, wanted = feed.pose_at(t_ns), pose_of(t_ns)
        assert np.abs(got[:3, 3] - wanted[:3, 3]).max() < 1e-12  # m
        assert geodesic_angle(got[:3, :3], wanted[:3, :3]) < 1e-9  # rad


def test_times_that_are_not_held_are_refused(feed):
    with pytest.raises(PoseFeedError, match="empty"):
        feed.latest_t_ns()
    with pytest.raises(PoseFeedError, match="empty"):
        feed.pose_at(0)
    for i in range(N_RING_SLOTS + 500):
        feed.publish(i * MS, pose_of(0))
    newest = (N_RING_SLOTS + 499) * MS
    for t_ns in (newest + 1, 400 * MS):
        with pytest.raises(PoseFeedError, match="outside"):
            feed.pose_at(t_ns)
    assert feed.pose_at(newest).shape == (4, 4)
    assert feed.pose_at(newest - (N_RING_SLOTS - 100) * MS).shape == (4, 4)


def test_a_torn_entry_is_not_taken(feed):
    for i in range(10):
        feed.publish(i * MS, pose_of(i * MS))
    struct.Struct("<Q").pack_into(feed._buffer, 64 + 9 * 128, 2 * 9 + 1)  # the writer stands in the middle of entry 9
    with pytest.raises(PoseFeedError, match="torn"):
        feed.latest_t_ns()
    with pytest.raises(PoseFeedError, match="torn"):
        feed.pose_at(5 * MS)


def _read_all(name, seconds, result):
    reader = PoseFeed.attach(name)
    checked, worst = 0, 0.0
    stop_ns = round(seconds * 1e9)
    while True:
        try:
            latest = reader.latest_t_ns()
            T = reader.pose_at(latest - 300_000)
        except PoseFeedError:
            continue
        worst = max(worst, float(np.abs(T[:3, 3] - pose_of(latest - 300_000)[:3, 3]).max()))
        checked += 1
        if latest >= stop_ns:
            break
    reader.close()
    result.put((checked, worst))


def test_another_process_never_reads_a_mixture_while_the_writer_writes(feed):
    context = multiprocessing.get_context("spawn")
    result = context.Queue()
    reader = context.Process(target=_read_all, args=(feed.feed_name, 30.0, result))
    reader.start()
    for i in range(30_001):  # as fast as it can: several times round the ring
        feed.publish(i * MS, pose_of(i * MS))
    checked, worst = result.get(timeout=30.0)
    reader.join(10.0)
    assert checked > 0
    assert worst < 1e-9  # m
