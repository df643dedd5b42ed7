"""The small parts of the server's link: figures, sample ring, conversion, queue to the server."""

import multiprocessing
import time
from dataclasses import replace

import numpy as np
import pytest

from protocol.codes import HeaderFlag, PlcState
from protocol.errors import LocalProtocolError
from protocol.framing import EapFraming, RawFraming
from protocol.messages import State
from recording.clock import mono_ns
from server.api.panel_view import link_figures
from server.link import udp_end
from server.link.client import LinkClient
from server.link.contracts import (
    HealthReport,
    LinkHealth,
    LinkPhase,
    MotionEnded,
    PlcSample,
    SamplesReport,
    measured_oil_c,
)
from server.link.errors import LinkRefusedError
from server.link.lateness import Lateness, Outbox
from server.link.samples import SampleRing, knots_of, sample_of, stood_still
from server.link.settings import LinkSettings, framing_of
from server.link.udp_end import StampClock, UdpEnd
from server.motion.contracts import JointTrajectory
from server.settings import read_machine


def sample(t_mono_ns: int) -> PlcSample:
    return sample_of(State(1, t_mono_ns, 5, PlcState.HOLD), t_mono_ns, 6)


def test_a_sample_carries_the_joints_in_use() -> None:
    array = tuple(float(i) for i in range(8))
    state = State(
        1, 2, 3, PlcState.RUN, HeaderFlag.SIMULATION, q=array, q_ref=array, p_a=array, t_oil=45.0, buffer_us=9
    )
    got = sample_of(state, 77, 6)
    assert got.q_rad == got.q_ref_rad == got.pressure_a_pa == array[:6]
    assert (got.t_mono_ns, got.t_plc_ns, got.seq, got.plc_state) == (77, 3, 2, "RUN")
    assert (got.simulation, got.oil_temperature_c) == (True, 45.0)


def test_ring_keeps_three_minutes_and_answers_since() -> None:
    ring = SampleRing()
    assert ring.latest is None
    assert ring.samples_since(0) == []
    heard: list[int] = []
    unsubscribe = ring.subscribe(lambda s: heard.append(s.t_mono_ns))
    ring.add_samples(sample(t) for t in range(1, 18_101))
    assert ring.latest is not None
    assert ring.latest.t_mono_ns == 18_100
    assert [s.t_mono_ns for s in ring.samples_since(18_097)] == [18_098, 18_099, 18_100]
    assert len(ring.samples_since(0)) == 18_000
    unsubscribe()
    ring.add_samples([sample(20_000)])
    assert len(heard) == 18_100


def test_a_listener_that_raises_keeps_no_sample_from_the_others_and_is_a_fault() -> None:
    def broken(_sample: object) -> None:
        raise ValueError("a defect")

    ring, heard = SampleRing(), []
    ring.subscribe(broken)
    ring.subscribe(lambda s: heard.append(s.t_mono_ns))
    ring.add_samples(sample(t) for t in range(5))
    assert heard == [0, 1, 2, 3, 4]
    assert "broken failed to handle a PLC sample: ValueError('a defect')" in ring.listeners.recent_failure


def test_lateness_percentiles() -> None:
    lateness = Lateness()
    assert lateness.figures().max_us == 0.0
    lateness.add(9_000_000)
    for late_us in range(1, 1001):
        lateness.add(late_us * 1000)
    figures = lateness.figures()
    assert (figures.p50_us, figures.p99_us, figures.max_us) == (501.0, 991.0, 9000.0)  # us; the window has moved on


def test_knots_are_the_trajectorys_own() -> None:
    t_s = np.array([0.0, 0.05, 0.1])
    q = np.arange(18, dtype=float).reshape(3, 6)
    knots = knots_of(JointTrajectory(t_s, q, q * 2, q * 3), 6)
    assert [k[0] for k in knots] == [0, 50_000_000, 100_000_000]
    assert knots[1][1:] == (tuple(q[1]), tuple(q[1] * 2), tuple(q[1] * 3))
    with pytest.raises(LinkRefusedError, match=r"trajectory\.qd: shape \(2, 6\)"):
        knots_of(JointTrajectory(t_s, q, q[:2], q), 6)
    with pytest.raises(LinkRefusedError, match="knots, joints"):
        knots_of(JointTrajectory(t_s, q[:, :5], q, q), 6)


def test_settings_choose_the_framing() -> None:
    assert isinstance(framing_of(LinkSettings()), RawFraming)
    assert isinstance(framing_of(LinkSettings(framing="eap")), EapFraming)
    with pytest.raises(LocalProtocolError, match="AMS NetId"):
        framing_of(LinkSettings(framing="eap", pc_net_id="1.2.3"))


def test_a_server_that_does_not_read_costs_samples_not_reports() -> None:
    reader, writer = multiprocessing.Pipe()
    outbox = Outbox(writer)
    try:
        for t in range(1, 8001):
            outbox.add_sample(sample(t))
        ended = MotionEnded(1, True, "reached", 5)
        outbox.report(ended)
        got: list[object] = []
        while not got or got[-1] != ended:
            assert reader.poll(5.0)
            got.append(reader.recv())
        samples = [report for report in got if isinstance(report, SamplesReport)]
        assert samples[-1].samples[-1].t_mono_ns == 8000  # the newest survive
        assert samples[-1].dropped + sum(len(report.samples) for report in samples) == 8000
    finally:
        reader.close()
        outbox.report(ended)  # wakes the thread, which sees the broken pipe and ends
        outbox.report(ended)


def test_a_long_stall_loses_no_answer_and_leaves_one_health_in_a_row() -> None:
    """The pipe is full and nobody reads: health comes ten times a second, the motion's end once."""
    reader, writer = multiprocessing.Pipe()
    outbox = Outbox(writer)
    base = LinkHealth(LinkPhase.RUNNING, 1.0, 0, 0, 0, 0, 0.0, 0.0, 0.0, 0.0, "", 1, last_words := "x" * 4_000_000)
    ended = MotionEnded(1, False, "lag", 5)
    try:
        outbox.report(HealthReport(base, None))  # fills the pipe
        time.sleep(0.2)
        outbox.report(ended)
        for number in range(5000):
            outbox.report(HealthReport(replace(base, sent=number, warning=""), None))
        got = []
        for _ in range(3):
            assert reader.poll(5.0)
            got.append(reader.recv())
        assert got[0].health.warning == last_words
        assert got[1] == ended
        assert got[2].health.sent == 4999
        assert not reader.poll(0.2)
    finally:
        reader.close()
        outbox.report(ended)
        outbox.report(ended)


def test_what_the_server_did_not_fetch_is_counted_in_the_health_figures() -> None:
    client = LinkClient(LinkSettings(), read_machine("hiab033"))
    client._on_report(SamplesReport((sample(1),), 7))
    client._on_report(HealthReport(LinkHealth(LinkPhase.LINKED, 1.0, 0, 0, 0, 0, 0.0, 0.0, 0.0, 0.0, "", 0), None))
    assert client.health.samples_dropped == 7
    assert link_figures([], client.health, 0.0).samples_dropped == 7


def test_an_oil_temperature_is_told_only_where_it_is_measured() -> None:
    told = [measured_oil_c(replace(sample(1), oil_temperature_c=value)) for value in (45.0, 0.0, float("nan"))]
    assert told == [45.0, None, None]


@pytest.mark.parametrize(
    ("span_s", "moved_rad", "referenced", "still"),
    [(0.4, 0.0, 0.0, True), (0.3, 0.0, 0.0, False), (0.4, 1e-3, 0.0, False), (0.4, 0.0, 1e-3, False)],
)
def test_standing_still_is_encoders_and_reference_for_most_of_the_window(span_s, moved_rad, referenced, still) -> None:
    first = sample(0)
    last = replace(
        sample(round(span_s * 1e9)),
        q_rad=tuple(value + moved_rad for value in first.q_rad),
        qd_ref_rad_s=(referenced,) * 6,
        t_plc_ns=first.t_plc_ns + round(span_s * 1e9),
    )
    assert stood_still([first, last], 0.4, 2e-4, 1e-4) == still
    assert not stood_still([last], 0.4, 2e-4, 1e-4)


def test_a_process_held_up_between_two_clocks_stamps_nothing_late(monkeypatch: pytest.MonkeyPatch) -> None:
    a, b = UdpEnd(("127.0.0.1", 0)), UdpEnd(("127.0.0.1", 0))
    real_ns, calls = mono_ns, iter(range(10_000))  # seven a turn: at its begin, then three pairs
    monkeypatch.setattr(udp_end, "mono_ns", lambda: real_ns() + (10_000_000 if next(calls) % 7 == 2 else 0))
    try:
        for i in range(6):
            before_ns = real_ns()
            assert a.send(bytes([i]), b.local_address)
            time.sleep(0.002)
            ((_, received_ns, _),) = b.drain()
            assert before_ns - 1_000_000 < received_ns < real_ns()
    finally:
        a.close()
        b.close()


S = 1_000_000_000
WALL = 1_800_000_000 * S


def test_datagrams_that_waited_for_a_frozen_process_keep_their_age() -> None:
    clock = StampClock(WALL, 100 * S)
    waited = [WALL + S // 10, WALL + S, WALL + 19 * S]
    assert clock.received_ns(waited, WALL + 20 * S, 120 * S) == [100 * S + S // 10, 101 * S, 119 * S]


@pytest.mark.parametrize("set_by_s", [-1.8e9, -3600.0, -20.0, 20.0, 86_400.0 * 400])
def test_a_wall_clock_that_was_set_ages_no_datagram_and_makes_none_fresh(set_by_s: float) -> None:
    set_ns = round(set_by_s * S)
    clock = StampClock(WALL - S, 99 * S)
    clock.empty_ns = 100 * S - S // 50
    stamps = [WALL - S // 100, WALL - S // 200 + set_ns]  # before and after it was set
    assert clock.received_ns(stamps, WALL + set_ns, 100 * S) == [100 * S - S // 100, 100 * S - S // 200]
    assert clock.received_ns([WALL + set_ns + S], WALL + set_ns + 2 * S, 102 * S) == [101 * S]


def test_a_clock_that_was_set_while_the_process_was_frozen_makes_nothing_fresher_than_it_is() -> None:
    """Which of both differences holds cannot be known: 18 s ago by the one, 8 s by the other."""
    clock = StampClock(WALL, 100 * S)
    assert clock.received_ns([WALL + 2 * S], WALL + 10 * S, 120 * S) == [102 * S]


def test_a_stamp_that_fits_nowhere_is_now_and_times_only_rise() -> None:
    clock = StampClock(WALL, 100 * S)
    stamps = [None, WALL - 86_400 * S, WALL + S // 2]
    assert clock.received_ns(stamps, WALL + S, 101 * S) == [101 * S, 101 * S, 101 * S]


def test_a_socket_knows_since_when_its_queue_holds_what_is_in_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frozen for 20 s, played by clocks that both go on by 20 s beyond what the kernel stamps."""
    ahead_ns, mono, wall = [0], time.monotonic_ns, time.time_ns
    monkeypatch.setattr(udp_end.time, "monotonic_ns", lambda: mono() + ahead_ns[0])
    monkeypatch.setattr(udp_end.time, "time_ns", lambda: wall() + ahead_ns[0])
    a, b = UdpEnd(("127.0.0.1", 0)), UdpEnd(("127.0.0.1", 0))
    try:
        assert b.drain() == []
        for i in range(40):
            assert a.send(bytes([i]), b.local_address)
        sent_ns = mono()
        ahead_ns[0] = 20 * S
        for drained in (b.drain(), b.drain()):
            assert all(t_ns <= sent_ns + S // 100 for _, t_ns, _ in drained)
        assert b.drain() == []
    finally:
        a.close()
        b.close()


def test_udp_end_stamps_and_drains() -> None:
    a, b = UdpEnd(("127.0.0.1", 0)), UdpEnd(("127.0.0.1", 0))
    try:
        assert b.drain() == []
        for i in range(40):
            assert a.send(bytes([i]), b.local_address)
        first, second = b.drain(), b.drain()
        assert (len(first), len(second)) == (32, 8)  # bounded
        times = [t for _, t, _ in first + second]
        assert times == sorted(times)
        assert first[0][2] == a.local_address
        assert not a.send(b"x", ("255.255.255.255", 1))  # not permitted: loss, not an exception
    finally:
        a.close()
        b.close()
