"""When datagrams took effect, by the rows that show them: neither jitter nor a drift is a fault, a loss is one."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_cases import confirmed

from benchmarks.diagnosis.links.recorded import Link, arrived, over
from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.datagrams.arrivals import Arrivals, arrival_times
from diagnosis.datagrams.lost import never_received
from diagnosis.datagrams.sent import by_value
from diagnosis.reading.read import examine_recording

CYCLE_S = 1e-3
NUMBER = np.arange(15000)
ROWS_S = 0.01 * np.arange(1, 5990)


def logged(link: Link, seed: int = 1) -> tuple[np.ndarray, Arrivals, np.ndarray]:
    """When each was sent by the PLC's clock, what the rows say of it, and when it came (NaN: never)."""
    rng = np.random.default_rng(seed)
    t_s = 1e-3 * link.sent_ms * NUMBER
    which, when = arrived(link, t_s, rng)
    when = CYCLE_S * np.ceil(when / CYCLE_S - 1e-6)
    seen = which[np.searchsorted(when, ROWS_S + 1e-9, side="right") - 1]
    stamps = t_s * (1.0 + link.drift)
    came = np.full(len(t_s), np.nan)
    came[which] = when
    return stamps, arrival_times((stamps, NUMBER), (ROWS_S, seen), CYCLE_S, 0.0), came


def diagnosed(link: Link) -> dict[str, Any]:
    return answer_json(budget_of(examine_recording(over(link), Path("link"))))


def test_what_comes_on_the_dot_is_left_as_it_was_sent() -> None:
    stamps, found, _ = logged(Link())
    np.testing.assert_array_equal(found.t_s, stamps)
    assert (found.jitter_s, found.clock_drift_rate, found.unsure_s) == (
        0.0,
        0.0,
        CYCLE_S,
    )  # of a wait that no row shows
    assert found.datagram_lost is not None
    assert not found.datagram_lost.any()


@pytest.mark.parametrize("delay_s", [0.003, 0.0234, 0.06])
def test_a_steady_delay_stays_in_the_data(delay_s: float) -> None:
    """It is the link's fault: the diagnosis names it."""
    stamps, found, _ = logged(Link(delay_s=delay_s))
    np.testing.assert_allclose(found.t_s, stamps, atol=1e-6)


@pytest.mark.parametrize("jitter_s", [3e-4, 1e-3])
def test_jitter_is_replayed_as_the_rows_show_it(jitter_s: float) -> None:
    stamps, found, came = logged(Link(jitter_s=jitter_s))
    bounded = (came < ROWS_S[-1]) & (came - stamps < 0.003)
    as_shown = CYCLE_S * np.ceil(found.t_s / CYCLE_S - 1e-6)
    rows = np.searchsorted(ROWS_S, np.stack([as_shown, came])[:, bounded] - 1e-9)
    assert np.mean(rows[0] == rows[1]) > 0.995
    assert found.datagram_lost is None or not found.datagram_lost.any()
    assert found.unsure_s > 0.0


@pytest.mark.parametrize("ppm", [-100, -20, 20, 100])
def test_clocks_that_drift_are_brought_together(ppm: int) -> None:
    stamps, found, came = logged(Link(drift=1e-6 * ppm))
    off = found.t_s - came
    assert np.ptp(off[:-20]) < 0.0035
    assert abs(stamps[-1] - came[-1]) == pytest.approx(6e-5 * abs(ppm), rel=0.01)
    assert (found.clock_drift_rate == 0.0 and abs(ppm) < 50) or found.clock_drift_rate == pytest.approx(
        -1e-6 * ppm, abs=1e-5
    )


@pytest.mark.parametrize("ppm", [-60, -100])
def test_clocks_are_brought_together_beside_losses(ppm: int) -> None:
    """Rows contradict a datagram that never came, whatever the clocks do; a delay had been seen in it."""
    _, found, _ = logged(Link(drift=1e-6 * ppm, jitter_s=3e-4, loss_frac=0.07, sent_ms=10))
    assert found.clock_drift_rate == pytest.approx(-1e-6 * ppm, abs=1.5e-5)


@pytest.mark.parametrize("link", [Link(loss_frac=0.02), Link(loss_frac=0.02, jitter_s=3e-4), Link(loss_frac=0.2)])
def test_losses_are_told_where_a_row_waited_for_one(link: Link) -> None:
    _, found, came = logged(link)
    assert found.datagram_lost is not None
    assert found.loss_observable is not None
    assert found.datagram_lost[found.loss_observable].mean() == pytest.approx(link.loss_frac, rel=0.25)
    assert np.isnan(came[found.datagram_lost]).mean() > 0.95
    assert found.loss_observable.sum() > 5000


@pytest.mark.parametrize("loss_frac", [0.0, 0.05])
def test_one_that_came_with_the_next_was_late(loss_frac: float) -> None:
    """Rows twice as often as datagrams: of 3000 that wait 3 ms and rarely twenty, five are in no row."""
    _, found, _ = logged(Link(jitter_s=3e-3, loss_frac=loss_frac, sent_ms=20))
    assert found.datagram_lost is not None
    assert found.loss_observable is not None
    assert found.loss_observable.any()
    assert found.datagram_lost.any() is np.bool_(loss_frac > 0.0)


def test_what_may_be_late_is_not_called_lost() -> None:
    _, found, _ = logged(Link(jitter_s=1.5e-3))
    assert found.loss_observable is not None
    assert not found.loss_observable.any()


@pytest.mark.parametrize("seq", [np.full(5989, -1), np.zeros(5989, dtype=int) + 10**9, np.arange(5989)[::-1]])
def test_numbers_that_tell_nothing_change_nothing(seq: np.ndarray) -> None:
    stamps = 0.004 * NUMBER
    found = arrival_times((stamps, NUMBER), (ROWS_S, seq), CYCLE_S, 0.0)
    np.testing.assert_array_equal(found.t_s, stamps)
    assert found.datagram_lost is None


def test_without_numbers_a_row_is_known_by_its_values() -> None:
    rng = np.random.default_rng(4)
    t_s, q = 0.004 * NUMBER, np.cumsum(rng.normal(0.0, 1e-4, (len(NUMBER), 3)), axis=0)
    q[2000:2100] = q[2000]
    which, when = arrived(Link(jitter_s=1e-3, delay_s=0.03), t_s, rng)
    seen = which[np.maximum(np.searchsorted(when, ROWS_S, side="right") - 1, 0)]
    ref = q[seen].copy()
    ref[:, 1] = np.nan
    ref[4000] += 1e-6
    found = by_value((ROWS_S, ref), (t_s, q))
    known = found >= 0
    np.testing.assert_array_equal(found[known], seen[known])
    assert known.mean() > 0.98
    assert not known[4000]
    assert not known[(seen >= 2000) & (seen < 2099)].any()


def every_cycle(
    late: list[int], delay_s: float = 0.0, lost: tuple[int, ...] = (), sent_s: float = 0.01, stamps_s: float = 0.0
) -> tuple[np.ndarray, Arrivals]:
    """The PLC's cycle of 5 ms in every row; some datagrams came a cycle late, some never. `stamps_s`: noise of rows."""
    t_s, rows_s = sent_s * NUMBER[:3000], 0.005 * np.arange(1, 5990)
    came = t_s + 0.002 + delay_s
    came[late] += 0.005
    there = np.isin(NUMBER[:3000], lost, invert=True)
    last = np.searchsorted(came[there], rows_s, side="right") - 1
    seen = np.where(last >= 0, NUMBER[:3000][there][last], -1)
    stamps = rows_s + stamps_s * np.random.default_rng(3).normal(size=len(rows_s))
    return t_s, arrival_times((t_s, NUMBER[:3000]), (stamps, seen), 0.005, 0.002)


@pytest.mark.parametrize("delay_s", [0.0, 0.03])
@pytest.mark.parametrize("stamps_s", [0.0, 3e-6])
def test_where_every_cycle_has_a_row_a_few_late_ones_are_replayed_late(delay_s: float, stamps_s: float) -> None:
    late = [400, 1200, 2400]
    t_s, found = every_cycle(late, delay_s, stamps_s=stamps_s)
    expected = t_s.copy()
    expected[late] += 0.005
    np.testing.assert_allclose(found.t_s, expected, atol=1e-9)


@pytest.mark.parametrize("sent_s", [0.01, 0.005])
def test_where_every_cycle_has_a_row_what_never_came_is_not_late(sent_s: float) -> None:
    t_s, found = every_cycle([], lost=(300, 900, 901, 2000), sent_s=sent_s)
    np.testing.assert_array_equal(found.t_s, t_s)


def test_where_every_cycle_has_a_row_what_is_late_now_and_again_is_a_delay() -> None:
    t_s, found = every_cycle(list(range(0, 3000, 2)))
    np.testing.assert_array_equal(found.t_s, t_s)


@pytest.mark.parametrize("ppm", [10, 30, 60])
def test_where_every_cycle_has_a_row_a_pc_that_runs_fast_is_no_link_that_does(ppm: int) -> None:
    """Sent every cycle of 20 ms and 20 ms on the way: after three minutes each comes 5 ms too early by its stamp."""
    t_s, rows_s = 0.02 * NUMBER[:9000], 0.02 * np.arange(1, 9150)
    seen = np.searchsorted(t_s + 0.02, rows_s + 1e-9, side="right") - 1
    stamps = np.round(t_s * (1.0 + 1e-6 * ppm), 7)
    found = arrival_times((stamps, NUMBER[:9000]), (rows_s, NUMBER[seen]), 0.02, 0.02)
    assert found.clock_drift_rate == pytest.approx(-1e-6 * ppm, abs=1e-5)
    np.testing.assert_allclose(found.t_s, t_s, atol=1e-9)


@pytest.mark.parametrize("share", [0.02, 0.15])
def test_as_many_rows_as_datagrams_show_which_never_came(share: float) -> None:
    lost = np.flatnonzero(np.random.default_rng(4).random(2900) < share)
    _, found = every_cycle([], lost=tuple(lost), sent_s=0.005)
    assert found.datagram_lost is not None
    assert np.flatnonzero(found.datagram_lost).tolist() == [k for k in lost if k > 0]


def test_as_many_rows_as_datagrams_do_not_call_late_ones_lost() -> None:
    """One that is late comes with the next, and no row shows it; but some of the next are late, too."""
    late = np.flatnonzero(np.random.default_rng(4).random(2900) < 0.15)
    _, found = every_cycle(late.tolist(), sent_s=0.005)
    assert found.datagram_lost is None


@pytest.mark.filterwarnings("ignore:All-NaN")
def test_stamps_that_make_no_sense_make_no_trouble() -> None:
    stamps, number = 0.004 * NUMBER, NUMBER.copy()
    seen = np.clip(np.floor(ROWS_S / 0.004).astype(np.int64), 0, NUMBER[-1])
    jitter = np.random.default_rng(5).integers(0, 2, len(seen))
    for t_sent, t_row in [
        (stamps, np.append(ROWS_S[:-1], 3e7)),
        (np.append(stamps[:-1], np.inf), ROWS_S),
        (np.full(len(stamps), np.nan), ROWS_S),
        (stamps[::-1], ROWS_S),
        (np.zeros(len(stamps)), ROWS_S),
        (stamps, ROWS_S[::-1]),
        (stamps, np.full(len(ROWS_S), np.nan)),
    ]:
        found = arrival_times((t_sent, number), (t_row, np.maximum(seen - jitter, 0)), CYCLE_S, 0.0)
        assert found.t_s.shape == t_sent.shape
        q = np.stack([stamps, np.full(len(stamps), np.nan)], axis=1)
        assert by_value((t_row, q[seen]), (t_sent, q)).shape == t_row.shape


def test_a_pause_of_the_log_is_no_loss() -> None:
    rows = np.concatenate([ROWS_S[:500], ROWS_S[600:]])
    lost, judged = never_received((0.02 * NUMBER, NUMBER), (rows, np.floor(rows / 0.02 + 1e-9).astype(np.int64)))
    assert lost is not None
    assert judged is not None
    assert not lost.any()
    assert 40 < (~judged[:2990]).sum() < 60


@pytest.mark.parametrize(
    "link",
    [
        Link(jitter_s=3e-4),
        pytest.param(Link(drift=-1e-4), marks=pytest.mark.slow),
        pytest.param(Link(jitter_s=3e-4, log_cycles=1), marks=pytest.mark.slow),
    ],
)
def test_a_healthy_machine_behind_such_a_link_has_no_fault(link: Link) -> None:
    """All three were `outside`, or a delay of a millisecond."""
    found = diagnosed(link)
    assert found["verdict"] == "none", found["why"]
    told = "uneven_arrivals" in {one["code"] for one in found["findings"]}
    assert told == (link.drift != 0.0 or link.log_cycles == 1)  # 0.3 ms is in hardly any row of every tenth cycle


def test_lost_datagrams_are_named_where_rows_are_rarer_than_they() -> None:
    found = diagnosed(Link(loss_frac=0.03, jitter_s=2e-4))
    (effect,) = (one for one in found["budget"]["effects"] if one["name"] == "packet_loss")
    assert effect["status"] == "confirmed"
    share = effect["parameters"]["loss_frac"]
    assert share["value"] == pytest.approx(0.03, rel=0.2)
    assert share["low"] < share["value"] < share["high"]


def test_a_short_delay_is_found_between_rare_rows() -> None:
    """The cost has terraces there: the end of one, 0.8 ms, was taken for the best."""
    found = diagnosed(Link(delay_s=0.003))
    assert found["verdict"] == "effects", found["why"]
    ((effect, numbers),) = confirmed(found).items()
    assert effect == ("transport_delay", None)
    delay = numbers["delay_s"]
    assert delay["low"] <= 0.003 <= delay["high"]
