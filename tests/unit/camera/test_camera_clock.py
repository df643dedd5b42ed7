"""The camera's clock against the PC's: drift, latency jitter, steps, stamps out of order, a line that gets slow."""

import numpy as np
import pytest

from server.camera.contracts import StereoFrame
from server.camera.health.findings import FaultCode, Pair
from server.camera.health.stamps import StampMonitor
from server.camera.pipeline import CLOCK_STEP_PAIRS, CameraClock
from server.camera.smallest_offset import DRIFT_MAX_PPM

MS = 1_000_000
EPOCH_NS = 5_000_000_000_000
SMALLEST_MS = 30.0


class Stream:
    """A camera with a drifting clock behind a line of uneven speed; the errors of its mapped exposures."""

    eye = np.zeros((2, 2), np.uint8)

    def __init__(self, drift_ppm: float = 0.0, jitter_ms: float = 4.0, rate_hz: float = 30.0, seed: int = 1) -> None:
        self.clock, self.stamps, self.number = CameraClock(), StampMonitor(), 0
        self.found: list[tuple[FaultCode, ...]] = []
        self.rng = np.random.default_rng(seed)
        self.drift, self.jitter_ms, self.period_ns = drift_ppm * 1e-6, jitter_ms, round(1e9 / rate_hz)
        self.t_true_ns = 0
        self.set_ns = 0  # by how much the camera's clock was set
        self.slow_ns = 0  # what the line takes more
        self.slower_ns = 0  # and more with every pair

    def late_ms(self, count: int) -> np.ndarray:
        """Mapped minus (true exposure + smallest latency) of the next pairs [ms]."""
        late = []
        for _ in range(count):
            self.t_true_ns += self.period_ns
            self.slow_ns += self.slower_ns
            stamp_ns = round(self.t_true_ns * (1.0 + self.drift)) + self.set_ns
            latency_ns = round((SMALLEST_MS + self.rng.exponential(self.jitter_ms)) * MS) + self.slow_ns
            mapped_ns = self.mapped_ns(stamp_ns, EPOCH_NS + self.t_true_ns + latency_ns)
            late.append((mapped_ns - EPOCH_NS - self.t_true_ns) / MS - SMALLEST_MS)
        return np.array(late)

    def mapped_ns(self, stamp_ns: int, receive_ns: int) -> int:
        """As in the pipeline: stamps are looked at first."""
        self.number += 1
        frame = StereoFrame(self.eye, self.eye, stamp_ns, receive_ns, self.number)
        found = self.stamps.check(Pair(frame, None, None, 1, False))  # pyright: ignore[reportArgumentType]
        self.found.append(tuple(one.code for one in found))
        return self.clock.to_pc_clock(stamp_ns, receive_ns, 0, self.stamps.short_ns)


@pytest.mark.parametrize("drift_ppm", [0.0, 100.0, -100.0, 50.0, -50.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_drifting_clock_is_mapped_within_the_bound_for_ten_minutes(drift_ppm: float, seed: int) -> None:
    late = Stream(drift_ppm, seed=seed).late_ms(30 * 600)
    rounding_ms = 1e-4  # the smallest latency itself grows by drift times latency: 30 ms * 100 ppm = 3 us
    assert late.min() > -3e-3 - rounding_ms
    assert np.median(late[300:]) < 0.6
    assert late[300:].max() < 2.5


def test_the_plain_minimum_of_the_window_would_be_early() -> None:
    """What the ageing is for: a camera that loses 100 ppm leaves a minimum of 20 s ago 2 ms early."""
    rng = np.random.default_rng(3)
    t_ns = np.arange(30 * 60) * 33_333_333
    offsets_ns = t_ns * 100e-6 + (SMALLEST_MS + rng.exponential(10.0, len(t_ns))) * MS
    plain_ms = [
        (offsets_ns[max(0, n - 600) : n + 1].min() - t_ns[n] * 100e-6) / MS - SMALLEST_MS for n in range(len(t_ns))
    ]
    assert min(plain_ms) < -1.0
    assert DRIFT_MAX_PPM == 100.0
    clock = CameraClock()
    ours_ms = [
        (clock.to_pc_clock(round(t * (1.0 - 100e-6)), round(t * (1.0 - 100e-6)) + round(offset)) - t) / MS - SMALLEST_MS
        for t, offset in zip(t_ns, offsets_ns, strict=True)
    ]
    assert min(ours_ms) > -0.01


@pytest.mark.parametrize("step_ms", [-900.0, -300.0, -60.0, -40.0, 30.0, 300.0, 900.0, 5000.0, -5000.0])
def test_a_clock_that_is_set_is_found_again(step_ms: float) -> None:
    stream = Stream()
    assert stream.late_ms(300)[60:].max() < 3.0
    stream.set_ns = round(step_ms * MS)
    after = stream.late_ms(400)
    settled = after[CLOCK_STEP_PAIRS:]
    assert settled.min() > -0.01
    assert settled[30:].max() < 3.0
    if step_ms > 0.0:  # the new offset is smaller: at once
        assert after.min() > -0.01


def test_a_step_back_of_less_than_half_a_period_is_early_until_ageing_has_made_it_good() -> None:
    stream = Stream()
    stream.late_ms(300)
    stream.set_ns = round(-10.0 * MS)
    after = stream.late_ms(30 * 130)
    assert after.min() < -8.0  # the stated limit of the method: what no stamp shows may be latency as well
    assert after[30 * 120 :].min() > -0.01


@pytest.mark.parametrize("slow_ms", [60.0, 300.0, 450.0, 900.0, 3000.0])
def test_a_line_that_gets_slow_never_makes_old_pictures_fresh(slow_ms: float) -> None:
    stream = Stream()
    stream.late_ms(300)
    stream.slow_ns = round(slow_ms * MS)
    after = stream.late_ms(30 * 60)
    assert after.min() > -0.01
    assert after.max() < 7.0  # 0.1 ms a second: a clock that drifts would look so, too
    refused = [FaultCode.LATE in codes for codes in stream.found[300:]]
    assert all(refused) if slow_ms > 600.0 else not any(refused)


def test_a_line_that_gets_slower_and_slower_is_found_out() -> None:
    stream = Stream(jitter_ms=1.0)
    stream.late_ms(300)
    stream.slower_ns = 5 * MS
    after = stream.late_ms(300)
    assert after.max() < 3.0
    late = [FaultCode.LATE in codes for codes in stream.found[300:]]
    assert late.index(True) == pytest.approx(100, abs=5)  # 0.5 s after the fastest
    assert all(late[105:])
    stream.slow_ns = stream.slower_ns = 0  # its buffer is empty again
    stream.late_ms(60)
    assert not any(stream.found[-60:])


def test_a_clock_that_is_set_back_while_the_line_is_slow_is_followed_by_its_own_step_only() -> None:
    stream = Stream(jitter_ms=1.0)
    stream.late_ms(300)
    stream.slow_ns, stream.set_ns = 300 * MS, -200 * MS
    after = stream.late_ms(60)[CLOCK_STEP_PAIRS:]
    assert after.min() > -5.0
    assert after.max() < 5.0


def test_a_burst_of_late_pairs_leaves_the_map_where_it_was() -> None:
    stream = Stream(jitter_ms=2.0)
    stream.late_ms(300)
    receive_ns = EPOCH_NS + stream.t_true_ns
    for number in range(1, 20):
        stamp_ns = stream.t_true_ns + number * stream.period_ns
        mapped_ns = stream.mapped_ns(stamp_ns, receive_ns + number * stream.period_ns + 200 * MS)
        assert mapped_ns >= EPOCH_NS + stamp_ns + SMALLEST_MS * MS
    stream.t_true_ns += 19 * stream.period_ns
    assert -0.01 < stream.late_ms(60)[30:].max() < 3.0


def test_a_picture_out_of_order_and_stamps_that_stand_still_do_no_harm() -> None:
    stream = Stream(jitter_ms=1.0)
    stream.late_ms(200)
    late_stamp_ns = stream.t_true_ns - 2 * stream.period_ns
    mapped_ns = stream.mapped_ns(late_stamp_ns, EPOCH_NS + stream.t_true_ns + 90 * MS)
    assert abs(mapped_ns - EPOCH_NS - late_stamp_ns - SMALLEST_MS * MS) < 1.0 * MS
    for number in range(1, 6):  # stands still for 5 pairs
        stream.mapped_ns(stream.t_true_ns, EPOCH_NS + stream.t_true_ns + number * stream.period_ns + 35 * MS)
    stream.t_true_ns += 5 * stream.period_ns
    late = stream.late_ms(60)
    assert late.min() > -0.01
    assert late.max() < 2.0


def test_a_new_connection_has_a_clock_of_its_own() -> None:
    clock = CameraClock()
    clock.to_pc_clock(0, 100 * MS)
    assert clock.to_pc_clock(10_001 * MS, 900 * MS, connection=2) == 900 * MS
    assert clock.offset_ns == 900 * MS - 10_001 * MS
