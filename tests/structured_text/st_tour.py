"""Every kind of wrong datagram once in every state that matters, and every way of being refused while arming."""

import numpy as np
from st_chapters import Script
from st_harness import MACHINE, STRANGER, Drill, Pair
from st_sessions import Pc
from st_wire import FAULTS, Fault

from protocol.codes import CommandFlag, Mode, PlcState
from protocol.messages import Command

START = CommandFlag.START
_KNOT_TRIES = 4  # which knot and axis is spoilt is drawn


def tour(pc: Pc, pair: Pair, drill: Drill) -> Script:
    """All of it; about 900 datagrams."""
    yield from pc.silent(2)
    yield from while_linked(pc, drill)
    pair.deliver(pair.wrap(pc.encoded(pc.command()), pc.seq), STRANGER)
    yield from pc.beat(1)
    pair.deliver(bytes(30))  # no EAP frame, and as raw datagram too short
    yield from _arming(pc, pair, drill)
    yield from _in_hold(pc, drill)
    yield from _running(pc, drill)
    yield from _chasing(pc, drill)
    yield from _by_hand(pc, pair)
    yield from _edges_of_time(pc, pair)
    yield from _edges_of_the_machine(pc, pair)


def _spoil(drill: Drill, fault: Fault, command: Command) -> Script:
    drill.extra.append((fault, command))
    yield None


def while_linked(pc: Pc, drill: Drill) -> Script:
    """Every kind of wrong datagram before arming."""
    for fault in FAULTS:
        if not pc.is_in(PlcState.LINKED):
            pc.session += 1
            yield from pc.connect()
        yield from _spoil(drill, fault, pc.command())
        yield pc.command()


def _arming(pc: Pc, pair: Pair, drill: Drill) -> Script:
    nonce = next(fault for fault in FAULTS if fault.name == "nonce")
    pc.session += 1
    yield from pc.silent(105)
    yield from pc.connect()
    for _ in range(12):  # a refused ARM is no good command: armed at the 25th and not before
        yield from pc.beat(2)
        yield pc.command(Mode.ARM)
    yield from pc.beat(2, Mode.DISARM)
    pc.session += 1
    yield from pc.connect()
    yield from pc.beat(26)
    yield from _spoil(drill, nonce, pc.command(Mode.ARM))
    pair.panel.release_enable()
    yield from pc.beat(2, Mode.ARM)
    pair.panel.press_enable()
    pair.plant.qd[2] = 0.2
    yield from pc.beat(1)
    yield from pc.beat(2, Mode.ARM)
    pair.plant.qd[2] = 0.0
    kept = pair.plant.q.copy()
    pair.plant.q[1] = np.deg2rad(80.0) + 0.01
    yield from pc.beat(1)
    yield from pc.beat(2, Mode.ARM)
    pair.plant.q = kept
    pair.panel.estop_pressed = True
    yield from pc.beat(2)
    yield from pc.beat(2, Mode.RESET)
    pair.panel.estop_pressed = False
    yield from pc.beat(2, Mode.RESET)


def _armed(pc: Pc, pair: Pair) -> Script:
    if pc.is_in(PlcState.HOLD):
        return
    if not pair.panel.may_arm:
        pair.panel.release_enable()
        yield from pc.beat(1)
        pair.panel.press_enable()
    yield from pc.ready()


def _in_hold(pc: Pc, drill: Drill) -> Script:
    for fault in FAULTS:
        for _ in range(_KNOT_TRIES if "knot" in fault.name else 1):
            yield from _armed(pc, drill.pair)
            pc.plan(0.25, 50, 0.002)
            yield from _spoil(drill, fault, pc.window(START))
    yield from _armed(pc, drill.pair)
    pc.plan(1.9, 25, 0.05)
    yield from pc.prefill(20)


def _running(pc: Pc, drill: Drill) -> Script:
    for fault in FAULTS:
        if not pc.is_in(PlcState.RUN):
            yield from _armed(pc, drill.pair)
            pc.plan(2.5, 50, 0.06)
            yield from pc.play(4)
        yield from _spoil(drill, fault, pc.window(START))
        yield pc.window(START)


def _chasing(pc: Pc, drill: Drill) -> Script:
    n = len(pc.table.axes)
    q, still = np.zeros(n), np.zeros(n)
    for fault in FAULTS:
        if not pc.is_in(PlcState.RUN) and pc.state is not None:
            yield from _armed(pc, drill.pair)
            pc.traj_id += 1
            q = np.array(pc.state.q_ref[:n]) + 0.002
            yield pc.target(q, still)
        yield from _spoil(drill, fault, pc.target(q, still))
        yield pc.target(q, still)


def _by_hand(pc: Pc, pair: Pair) -> Script:
    """The lever is taken while it moves, and let go before the ramp is over."""
    yield from pc.beat(60, Mode.STOP)
    yield from _armed(pc, pair)
    pc.plan(1.0, 50, 0.05)
    yield from pc.play(30)
    pair.panel.lever_taken = True
    yield from pc.beat(3)
    pair.panel.lever_taken = False
    yield from pc.beat(40)


def _edges_of_time(pc: Pc, pair: Pair) -> Script:
    """Time limits shortened and lengthened; knots that were only prefilled when the PC fell silent."""
    yield from _armed(pc, pair)
    for timeout_us, ticks in ((1, 13), (120_000, 14), (2**31, 27), (0, 27)):
        pc.timeout_us = timeout_us
        yield from pc.beat(2)
        yield from pc.silent(ticks)
    yield from _armed(pc, pair)
    pc.plan(1.0, 50, 0.05)
    yield from pc.prefill(3)
    yield from pc.silent(27)
    yield from pc.play(5)


def _edges_of_the_machine(pc: Pc, pair: Pair) -> Script:
    """RESET while a fault's ramp lasts; supply and range just inside and outside, armed and not."""
    plant, kept = pair.plant, pair.plant.q.copy()
    yield from _armed(pc, pair)
    pc.plan(1.0, 50, 0.05)
    yield from pc.play(30)
    pair.panel.release_enable()
    yield from pc.beat(1)
    yield from pc.beat(40, Mode.RESET)
    plant.supply_pa = 1e6
    yield from pc.connect()
    yield from pc.beat(2)
    plant.supply_pa = 19e6
    plant.q[3] = MACHINE.joints[3].q_max_rad - 0.01
    yield from pc.beat(2)
    yield from _armed(pc, pair)
    for beyond in (0.03, 0.06):
        plant.q[3] = MACHINE.joints[3].q_max_rad + beyond
        yield from pc.beat(2)
    plant.q = kept
    yield from pc.beat(3, Mode.RESET)
    yield from _armed(pc, pair)
    plant.supply_pa = 1e6
    yield from pc.beat(2)
    plant.supply_pa = 19e6
    yield from pc.beat(3, Mode.RESET)
    yield from _armed(pc, pair)
    for late_ns in (40_000_000, 40_000_001):  # five cycles, and a nanosecond more
        pair.t_ns += late_ns
        yield from pc.beat(2)
