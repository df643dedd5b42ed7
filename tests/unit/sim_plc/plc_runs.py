"""Runs of the PLC program in virtual time, and what is asked of every one: no step of the reference."""

from itertools import pairwise

import numpy as np
from virtual_plc import MACHINE, MS, Q_START, VirtualPlc, quintic_knots

from protocol.codes import PlcState
from protocol.messages import Command

STEP = np.deg2rad([6.0, -4.0, 5.0, 8.0, -6.0, 9.0])
Q_END = tuple((np.array(Q_START) + STEP).tolist())
QD_MAX = np.array([joint.qd_max_rad_s for joint in MACHINE.joints])
QDD_MAX = np.array([joint.qdd_max_rad_s2 for joint in MACHINE.joints])
CYCLE_S = 1e-3
BENDING = 1.002  # of the limit: where the path bends, the guess of where a cycle ends is a little off


def armed(**kwargs):
    virtual = VirtualPlc(**kwargs)
    virtual.arm()
    return virtual


def started(q_end=Q_END, duration_s=2.0, **kwargs):
    virtual = armed(**kwargs)
    assert virtual.run(quintic_knots(virtual.plc.q_ref, q_end, duration_s)) == ()
    return virtual


def assert_no_step(virtual):
    q, qd = (np.array([row[k] for row in virtual.trace]) for k in (2, 3))
    first = next(i for i, row in enumerate(virtual.trace) if row[1] is PlcState.HOLD)
    q, qd = q[first:], qd[first:]
    assert (np.abs(qd) <= QD_MAX).all()
    assert (np.abs(np.diff(qd, axis=0)) <= BENDING * QDD_MAX * CYCLE_S).all()
    # q_ref is the integral of qd_ref: trapezoid, to third order in the cycle; but for the end of a ramp, where it is
    # set to where the joints have come to rest
    states = [row[1] for row in virtual.trace[first:]]
    ramp_ends = [a is not PlcState.HOLD and b is PlcState.HOLD for a, b in pairwise(states)]
    off = np.abs(np.diff(q, axis=0) - 0.5 * (qd[1:] + qd[:-1]) * CYCLE_S)
    assert off[~np.array(ramp_ends)].max() < 1e-7


def end_of_ramp(virtual):
    """q_ref of the last cycle of the newest ramp."""
    return np.array([row for row in virtual.trace if row[1] is PlcState.STOPPING][-1][2])


def stopping_s(virtual, since_ns):
    """Delay from `since_ns` to the ramp's first cycle, and its length [s]."""
    rows = [row for row in virtual.trace if row[0] > since_ns and row[1] is PlcState.STOPPING]
    return (rows[0][0] - since_ns) * 1e-9, (rows[-1][0] - rows[0][0] + MS) * 1e-9, np.abs(rows[0][3])


def assert_no_step_until_fault(virtual):
    rows = [row for row in virtual.trace if row[1] in (PlcState.RUN, PlcState.FAULT)]
    qd = np.array([row[3] for row in rows])
    assert (np.abs(np.diff(qd, axis=0)) <= BENDING * QDD_MAX * CYCLE_S).all()


def last_command(virtual):
    """A heartbeat that the PLC would accept next."""
    client = virtual.client
    return Command(
        session=7,
        seq=client._seq + 1,
        t_send_ns=virtual.t_ns,
        ack_plc_seq=client.state.seq,
        t_plc_echo_ns=client.state.t_send_ns,
        axis_mask=63,
        cfg_id=client.state.cfg_id,
        arm_nonce=client.state.nonce,
    )
