"""The PLC program in virtual time: faults, arming, the local panel."""

import numpy as np
import pytest
from plc_runs import Q_END, QD_MAX, QDD_MAX, assert_no_step_until_fault, started
from virtual_plc import Q_START, VirtualPlc, quintic_knots

from protocol.codes import AxisBit, FaultBit, PlcState, RejectCode
from sim_plc.plc.local_panel import LocalPanel


def test_a_joint_that_does_not_follow_latches_a_fault():
    virtual = started(q_end=tuple(np.array(Q_START) + np.deg2rad([55.0, 0, 0, 0, 0, 0])), duration_s=8.0)
    frozen = virtual.q.copy()
    for _ in range(9000):
        virtual.q = frozen.copy()
        virtual.step()
    assert virtual.plc.state is PlcState.FAULT
    assert max(map(abs, virtual.trace[-1][4])) == 0.0
    assert FaultBit(virtual.client.state.fault_bits) == FaultBit.LAG
    assert_no_step_until_fault(virtual)
    virtual.client.request_reset()
    virtual.step(200)
    assert virtual.plc.state is PlcState.DISARMED
    assert virtual.plc.monitor.latched == FaultBit(0)


def test_hot_oil_ramps_down_and_cannot_be_reset_while_it_is_hot():
    virtual = started()
    virtual.step(900)
    virtual.t_oil_c = 90.0
    virtual.step(700)
    assert virtual.plc.state is PlcState.FAULT
    assert_no_step_until_fault(virtual)
    assert FaultBit(virtual.client.state.fault_bits) == FaultBit.OIL_TEMPERATURE
    virtual.client.request_reset()
    virtual.step(200)
    assert virtual.plc.state is PlcState.FAULT
    assert virtual.client.state.reject_code == RejectCode.FAULT_PRESENT
    virtual.t_oil_c = 60.0
    virtual.step(400)
    assert virtual.plc.state is PlcState.DISARMED


def test_a_reset_that_is_refused_for_long_keeps_its_session_and_comes_through_in_the_end():
    virtual = started()
    virtual.step(900)
    virtual.t_oil_c = 90.0
    virtual.step(700)
    virtual.client.request_reset()
    virtual.step(2000)
    assert virtual.client.state.reject_code == RejectCode.FAULT_PRESENT
    assert virtual.plc.link.session == 7
    virtual.t_oil_c = 60.0
    virtual.step(200)
    assert virtual.plc.state is PlcState.DISARMED


@pytest.mark.parametrize("glitch_rad_s", [-300.0, 600.0])
def test_an_encoder_that_jumps_as_the_fault_comes_does_not_keep_the_valves_open(glitch_rad_s):
    virtual = started()
    virtual.step(900)
    assert max(map(abs, virtual.trace[-1][4])) > 0.0
    virtual.t_oil_c = 90.0
    virtual.qd = np.array([0.0, 0.0, glitch_rad_s, 0.0, 0.0, 0.0])
    virtual.step(1)
    assert virtual.plc.state is PlcState.FAULT
    virtual.qd = np.zeros(6)
    virtual.step(round(1500 * float((QD_MAX / QDD_MAX).max())) + 2)  # docs/plc-link.md: 1.5 qd_max / qdd_max
    assert max(map(abs, virtual.trace[-1][4])) == 0.0
    virtual.t_oil_c = 40.0
    virtual.client.request_reset()
    virtual.step(400)
    assert virtual.plc.state is PlcState.DISARMED


def test_an_encoder_that_reads_nan_closes_the_valves_at_once_and_still_tells():
    virtual = started()
    virtual.step(900)
    virtual.q[2] = np.nan
    virtual.step(1)
    assert virtual.plc.state is PlcState.FAULT
    assert max(map(abs, virtual.trace[-1][4])) == 0.0
    virtual.step(50)
    state = virtual.client.state
    assert FaultBit.SENSOR in FaultBit(state.fault_bits)
    assert AxisBit.ENCODER_FAULT in AxisBit(state.axis_status[2])
    assert np.isfinite(state.q).all()


@pytest.mark.parametrize("moving", [False, True])
def test_an_encoder_that_jumps_closes_the_valves_at_once_and_is_named_until_reset(moving):
    virtual = started() if moving else VirtualPlc()
    if not moving:
        virtual.arm()
        virtual.step(100)
    virtual.step(900)
    assert virtual.plc.state is (PlcState.RUN if moving else PlcState.HOLD)
    virtual.q[2] += 0.02  # far below the lag that is a fault
    virtual.step(1)
    assert virtual.plc.state is PlcState.FAULT
    assert max(map(abs, virtual.trace[-1][4])) == 0.0
    virtual.step(200)
    state = virtual.client.state
    assert FaultBit(state.fault_bits) == FaultBit.SENSOR
    assert [AxisBit.ENCODER_FAULT in AxisBit(word) for word in state.axis_status[:6]] == [j == 2 for j in range(6)]
    virtual.client.request_reset()
    virtual.step(400)
    assert virtual.plc.state is PlcState.DISARMED
    assert AxisBit.ENCODER_FAULT not in AxisBit(virtual.client.state.axis_status[2])
    virtual.q[2] += 0.5  # disarmed: somebody sets the encoder's zero
    virtual.step(100)
    assert virtual.plc.state is PlcState.DISARMED


def test_panel_enable_must_be_pressed_after_each_disarming():
    panel = LocalPanel("panel")
    virtual = VirtualPlc(panel=panel)
    panel.press_enable()  # before the PLC is up: an enable left on
    virtual.step(200)
    virtual.client.request_arm()
    virtual.step(900)
    assert virtual.plc.state in (PlcState.LINKED, PlcState.DISARMED)
    assert virtual.client.last_reject.startswith("ENABLE")
    virtual.silent = True
    virtual.step(1100)  # the session is void
    panel.press_enable()
    virtual.reconnect(9)
    virtual.arm()
    assert virtual.run(quintic_knots(virtual.plc.q_ref, Q_END, 2.0)) == ()
    virtual.step(900)
    panel.release_enable()
    virtual.step(500)
    assert virtual.plc.state is PlcState.FAULT
    assert FaultBit(virtual.client.state.fault_bits) == FaultBit.LOCAL_ENABLE_LOST
    assert_no_step_until_fault(virtual)


def test_local_lever_ramps_down_and_ignores_the_network():
    virtual = started()
    virtual.step(900)
    virtual.panel.lever_taken = True
    virtual.step(1)
    assert virtual.plc.state is PlcState.LOCAL
    assert max(map(abs, virtual.plc.qd_ref)) > 0.0  # not snapped shut
    virtual.step(600)
    assert max(map(abs, virtual.trace[-1][4])) == 0.0
    virtual.panel.lever_taken = False
    virtual.step(10)
    assert virtual.plc.state is PlcState.DISARMED


def test_arming_beyond_the_joint_range_or_while_moving_is_refused():
    for change, code in ((np.deg2rad([0, 45, 0, 0, 0, 0]), "LIMIT_Q"), (None, "LAG")):
        virtual = VirtualPlc()
        if change is not None:
            virtual.q = virtual.q + change
        virtual.qd = np.full(6, 0.1) if change is None else np.zeros(6)
        virtual.step(200)
        virtual.client.request_arm()
        virtual.step(700)
        assert virtual.plc.state is PlcState.LINKED
        assert virtual.client.last_reject.startswith(code)
