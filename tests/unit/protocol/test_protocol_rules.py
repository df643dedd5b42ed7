"""State table, sequence rule, limits, codes, playback window and clock offset."""

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.client_state import ClockOffset
from protocol.codes import CommandFlag, PlcState, RejectCode, reject_text
from protocol.errors import IllegalTransitionError, LocalProtocolError
from protocol.limits import AxisLimits, LimitTable, axis_mask, cfg_id, limits_of
from protocol.messages import Knot, State
from protocol.playback import Playback
from protocol.plc_states import ARMED_STATES, TRANSITIONS, PlcEvent, mermaid_diagram, next_state
from protocol.sequence import SequenceKind, classify_sequence, next_sequence

# written out by hand, apart from the table: state -> {event: state}; everything else is illegal
S, E = PlcState, PlcEvent
EXPECTED: dict[PlcState, dict[PlcEvent, PlcState]] = {
    S.BOOT: {E.BOOTED: S.DISARMED, E.FAULT: S.FAULT},
    S.DISARMED: {E.HELLO: S.LINKED, E.FAULT: S.FAULT, E.LOCAL_ON: S.LOCAL},
    S.LINKED: {
        E.HELLO: S.LINKED,
        E.ARM: S.HOLD,
        E.SOFT_STOP: S.LINKED,
        E.QUICK_STOP: S.LINKED,
        E.DISARM: S.DISARMED,
        E.VOID: S.DISARMED,
        E.FAULT: S.FAULT,
        E.LOCAL_ON: S.LOCAL,
    },
    S.HOLD: {
        E.ARM: S.HOLD,
        E.START: S.RUN,
        E.SOFT_STOP: S.HOLD,
        E.QUICK_STOP: S.HOLD,
        E.AT_REST: S.HOLD,
        E.DISARM: S.DISARMED,
        E.VOID: S.DISARMED,
        E.FAULT: S.FAULT,
        E.LOCAL_ON: S.LOCAL,
    },
    S.RUN: {
        E.END: S.HOLD,
        E.SOFT_STOP: S.STOPPING,
        E.QUICK_STOP: S.STOPPING,
        E.DISARM: S.STOPPING,
        E.VOID: S.STOPPING,
        E.FAULT: S.FAULT,
        E.LOCAL_ON: S.LOCAL,
    },
    S.STOPPING: {
        E.AT_REST: S.HOLD,
        E.SOFT_STOP: S.STOPPING,
        E.QUICK_STOP: S.STOPPING,
        E.DISARM: S.STOPPING,
        E.VOID: S.STOPPING,
        E.FAULT: S.FAULT,
        E.LOCAL_ON: S.LOCAL,
    },
    S.FAULT: {
        E.HELLO: S.FAULT,
        E.SOFT_STOP: S.FAULT,
        E.QUICK_STOP: S.FAULT,
        E.DISARM: S.FAULT,
        E.AT_REST: S.FAULT,
        E.VOID: S.FAULT,
        E.FAULT: S.FAULT,
        E.RESET: S.DISARMED,
    },
    S.LOCAL: {
        E.HELLO: S.LOCAL,
        E.SOFT_STOP: S.LOCAL,
        E.QUICK_STOP: S.LOCAL,
        E.DISARM: S.LOCAL,
        E.AT_REST: S.LOCAL,
        E.VOID: S.LOCAL,
        E.FAULT: S.FAULT,
        E.LOCAL_OFF: S.DISARMED,
    },
}


@pytest.mark.parametrize(("state", "event"), list(product(PlcState, PlcEvent)))
def test_every_state_with_every_event(state: PlcState, event: PlcEvent) -> None:
    after = EXPECTED[state].get(event)
    if after is None:
        with pytest.raises(IllegalTransitionError, match=rf"{state.name}.*{event.name}"):
            next_state(state, event)
    else:
        assert next_state(state, event) is after


def test_motion_begins_only_by_start_and_arming_only_by_arm() -> None:
    into_run = {(a, e) for (a, e), b in TRANSITIONS.items() if b is S.RUN and a is not S.RUN}
    assert into_run == {(S.HOLD, E.START)}
    into_armed = {(a, e) for (a, e), b in TRANSITIONS.items() if b in ARMED_STATES and a not in ARMED_STATES}
    assert into_armed == {(S.LINKED, E.ARM)}


def test_diagram_has_every_state() -> None:
    text = mermaid_diagram()
    assert all(state.name in text for state in PlcState)
    assert "HOLD --> RUN: START" in text


@given(st.integers(0, 2**32 - 1), st.integers(-2000, 2000))
def test_sequence_rule(last: int, step: int) -> None:
    verdict = classify_sequence(last, (last + step) % 2**32)
    if step == 1:
        assert (verdict.kind, verdict.n_lost, verdict.is_usable) == (SequenceKind.NEXT, 0, True)
    elif 2 <= step <= 1000:
        assert (verdict.kind, verdict.n_lost, verdict.is_usable) == (SequenceKind.GAP, step - 1, True)
    elif step == 0:
        assert verdict.kind is SequenceKind.DUPLICATE
    elif -1000 <= step < 0:
        assert verdict.kind is SequenceKind.LATE
    else:
        assert verdict.kind is SequenceKind.JUMP
    assert verdict.is_usable == (1 <= step <= 1000)


def test_sequence_wraps() -> None:
    assert next_sequence(0xFFFF_FFFF) == 0
    assert classify_sequence(0xFFFF_FFFF, 0).kind is SequenceKind.NEXT


def test_cfg_id_sees_every_number() -> None:
    axis = AxisLimits("a", -1.0, 1.0, 0.5, 2.0)
    base = LimitTable((axis,))
    variants = [
        LimitTable((AxisLimits("a", -1.0000000000000002, 1.0, 0.5, 2.0),)),
        LimitTable((AxisLimits("a", -1.0, 1.1, 0.5, 2.0),)),
        LimitTable((AxisLimits("a", -1.0, 1.0, 0.6, 2.0),)),
        LimitTable((AxisLimits("a", -1.0, 1.0, 0.5, 2.1),)),
        LimitTable((axis, axis)),
        LimitTable((axis,), spacing_min_ns=1),
        LimitTable((axis,), spacing_max_ns=1),
        LimitTable((axis,), start_tolerance_rad=1.0),
    ]
    ids = {cfg_id(table) for table in (base, *variants)}
    assert len(ids) == len(variants) + 1
    assert cfg_id(LimitTable((AxisLimits("another name", -1.0, 1.0, 0.5, 2.0),))) == cfg_id(base)
    assert axis_mask(LimitTable((axis,) * 3)) == 0b111


def test_too_many_joints_are_refused() -> None:
    with pytest.raises(LocalProtocolError, match="9 joints"):
        limits_of(_joints(9))
    with pytest.raises(LocalProtocolError, match="0 joints"):
        limits_of([])


class _Joint:
    name = "j"
    q_min_rad = -1.0
    q_max_rad = 1.0
    qd_max_rad_s = 1.0
    qdd_max_rad_s2 = 1.0


def _joints(n: int) -> list[_Joint]:
    return [_Joint() for _ in range(n)]


def test_every_reject_code_has_words() -> None:
    for code in RejectCode:
        assert reject_text(code).startswith(f"{code.name}: ")
    assert "not known" in reject_text(999)


def _plc(traj_id: int, playing: int, last: int) -> State:
    return State(1, 1, 1, PlcState.RUN, traj_id=traj_id, knot_playing=playing, knot_last=last)


def _playback(n: int) -> Playback:
    return Playback(7, tuple(Knot(i * 50_000_000) for i in range(n)))


def test_window_begins_at_the_start_until_the_plc_has_the_trajectory() -> None:
    window = _playback(100).window(_plc(traj_id=3, playing=50, last=60))
    assert (window.knot_first, len(window.knots), window.knot_before) == (0, 6, None)
    assert window.command_flags == CommandFlag(0)


@pytest.mark.parametrize(("last", "starts"), [(5, False), (15, False), (16, True), (60, True)])
def test_a_motion_starts_with_800_ms_of_it_in_the_plc(last: int, starts: bool) -> None:
    window = _playback(100).window(_plc(7, 0, last))
    assert (CommandFlag.START in window.command_flags) is starts
    whole = _playback(10).window(_plc(7, 0, 9))
    assert CommandFlag.START in whole.command_flags


def test_window_prefills_what_the_plc_lacks_while_the_ring_has_room() -> None:
    playback = _playback(100)
    assert playback.window(_plc(7, 0, 5)).knot_first == 6
    assert playback.window(_plc(7, 0, 57)).knot_first == 58  # 58..63: the ring of 64 is full then
    assert playback.window(_plc(7, 0, 58)).knot_first == 0  # no room: the next unplayed ones again
    assert playback.window(_plc(7, 20, 70)).knot_first == 71
    assert playback.window(_plc(7, 20, 70)).knot_before == playback.knots[70]


def test_window_at_the_end_carries_the_end_flag() -> None:
    playback = _playback(100)
    assert playback.window(_plc(7, 90, 99)).knot_first == 90  # all there: the next unplayed ones again
    for last in (94, 96, 98):
        window = playback.window(_plc(7, 90, last))
        assert window.knot_first + len(window.knots) == 100
        assert len(window.knots) == 6
        assert CommandFlag.LAST_IS_END in window.command_flags
    short = _playback(3).window(_plc(7, 0, 2))
    assert (short.knot_first, len(short.knots)) == (0, 3)
    assert CommandFlag.LAST_IS_END in short.command_flags


def test_offset_follows_the_fastest_exchange() -> None:
    clock = ClockOffset()
    assert clock.offset_ns is None
    assert clock.delay_min_ns == 0
    offset_ns = -5_000_000_000
    for i, (out_ns, back_ns) in enumerate([(9_000_000, 1_000_000), (100_000, 120_000), (2_000_000, 30_000_000)]):
        t1 = i * 20_000_000
        t2 = t1 + out_ns - offset_ns
        t3 = t2 + 3_000_000
        clock.add(t1, t2, t3, t3 + offset_ns + back_ns)
        assert clock.delay_ns == out_ns + back_ns
    assert clock.delay_min_ns == 220_000  # of all of them, not the newest
    assert clock.offset_ns is not None
    assert abs(clock.offset_ns - offset_ns) <= 10_000  # ns: half the asymmetry of the fastest one


def test_offset_forgets_after_half_a_minute() -> None:
    clock = ClockOffset()
    second = 1_000_000_000
    clock.add(0, 0, 0, 0)
    for i in range(1, 40):
        clock.add(i * second, i * second - 500, i * second - 500, i * second + 1000)
    assert clock.offset_ns == 1000
