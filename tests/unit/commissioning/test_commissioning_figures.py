"""Figures of the link and of stops, from made-up states with known answers."""

import math

import numpy as np
import pytest
from commissioning_states import CHAIN, MACHINE, MS, N, Q, sample

from machine.kinematics import tcp_jacobian, tcp_pose
from server.commissioning.link_dry_run import DRIFT_MAX_PPM, drift_ppm, lost_states, state_figures
from server.commissioning.stop_figures import stop_figures
from server.commissioning.stopping import StopKind, rest_figures


def by_name(figures, part):
    return next(figure for figure in figures if part in figure.name)


def test_states_in_time_are_inside_every_limit():
    figures = state_figures([sample(10.0 * i) for i in range(500)], 0.01)
    assert all(figure.ok for figure in figures)
    assert by_name(figures, "PLC's clock").value == pytest.approx(100.0)
    assert by_name(figures, "lost").value == 0.0
    assert by_name(figures, "largest gap").value == pytest.approx(10.0)


def test_lost_states_and_gaps_are_seen():
    kept = [i for i in range(500) if i % 20 or i == 0]
    figures = state_figures([sample(10.0 * i) for i in kept], 0.01)
    assert lost_states([sample(10.0 * i) for i in kept]) == 500 - len(kept)
    assert not by_name(figures, "states lost").ok
    gap = [sample(10.0 * i) for i in range(500) if not 200 <= i < 226]
    assert not by_name(state_figures(gap, 0.01), "largest gap").ok


@pytest.mark.parametrize(("ppm", "ok"), [(0.0, True), (400.0, True), (-450.0, True), (550.0, False), (-800.0, False)])
def test_drift_is_found_through_jitter(ppm, ok):
    rng = np.random.default_rng(3)
    t_plc = 10.0 * np.arange(1000)
    t_pc = t_plc * (1.0 + 1e-6 * ppm) + rng.exponential(0.5, len(t_plc))
    stamps = [(round(plc * MS), round(pc * MS)) for plc, pc in zip(t_plc, t_pc, strict=True)]
    samples = [sample(0.0, t_plc_ns=plc, t_mono_ns=pc, seq=i) for i, (plc, pc) in enumerate(stamps)]
    figure = by_name(state_figures(samples, 0.01), "drift")
    assert figure.value == pytest.approx(abs(ppm), abs=15.0)
    assert figure.ok is ok
    assert figure.at_most == DRIFT_MAX_PPM


def test_too_few_states_are_no_pass():
    assert not all(figure.ok for figure in state_figures([], 0.01))
    assert not all(figure.ok for figure in state_figures([sample(0.0)], 0.01))
    assert math.isnan(drift_ppm(np.arange(100) * 0.01, np.arange(100) * 0.01))


# --- stops ----------------------------------------------------------------------------------------------------------


def stopped(reaction_ms=240.0, ramp_ms=60.0, void_ms=1000.0, resume_ms=None, speed=0.05, end_ms=2000.0):
    """Slew at a speed; triggered at 500 ms; the ramp is linear, the joint follows its reference exactly."""
    states, q = [], 0.0
    for t in np.arange(0.0, 500.0 + end_ms, 10.0):
        since = t - 500.0 - reaction_ms
        share = 1.0 if since < 0.0 else max(0.0, 1.0 - since / ramp_ms)
        state = "RUN" if since < 0.0 else "STOPPING" if since < ramp_ms else "HOLD"
        state = "DISARMED" if t - 500.0 >= void_ms else state
        state = "RUN" if resume_ms is not None and t - 500.0 >= resume_ms else state
        qd = (speed * share, *(0.0,) * (N - 1))
        joints = (Q[0] + q, *Q[1:])
        states.append(sample(t, plc_state=state, q_rad=joints, q_ref_rad=joints, qd_rad_s=qd, qd_ref_rad_s=qd))
        q += speed * share * 0.01
    return states


def test_a_stop_is_measured_from_its_trigger():
    stop = stop_figures(stopped(), 500 * MS, MACHINE)
    assert stop.reaction_ms == pytest.approx(240.0)
    assert stop.ramp_ms == pytest.approx(60.0)
    assert stop.ramp_bound_ms == pytest.approx(1e3 * 0.05 / MACHINE.joints[0].qdd_max_rad_s2)
    assert stop.void_ms == pytest.approx(1000.0)
    assert stop.machine_still_ms == pytest.approx(300.0, abs=10.0)
    lever = float(np.linalg.norm(tcp_jacobian(CHAIN, Q)[:3, 0]))
    assert stop.tcp_speed_mm_s == pytest.approx(1e3 * 0.05 * lever, rel=0.01)
    assert stop.tcp_travel_mm == pytest.approx(1e3 * lever * 0.05 * (0.25 + 0.035), rel=0.03)
    assert not stop.resumed


def test_a_silent_stop_inside_its_limits_passes_and_a_late_one_does_not():
    def figures(**values):
        return rest_figures("x", StopKind.SILENCE, stop_figures(stopped(**values), 500 * MS, MACHINE))

    assert all(figure.ok for figure in figures())
    assert not by_name(figures(reaction_ms=300.0), "begins").ok
    assert not next(figure for figure in figures(ramp_ms=120.0) if figure.name == "x: ramp").ok
    assert not by_name(figures(void_ms=1200.0), "void").ok
    assert not by_name(figures(void_ms=900.0), "void").ok
    assert not by_name(figures(resume_ms=1500.0), "resumed").ok


def test_a_plc_that_never_stops_is_outside_its_limits():
    stop = stop_figures(stopped(reaction_ms=9000.0, void_ms=9000.0), 500 * MS, MACHINE)
    assert math.isnan(stop.reaction_ms)
    late = [figure for figure in rest_figures("x", StopKind.SILENCE, stop) if figure.unit == "ms"]
    assert len(late) == 3
    assert not any(figure.ok for figure in late)


def test_a_stop_that_ended_in_a_fault_is_no_stop():
    states = [sample(10.0 * i, plc_state="RUN" if i < 20 else "FAULT") for i in range(60)]
    figures = rest_figures("x", StopKind.STOP, stop_figures(states, 150 * MS, MACHINE))
    assert [figure.name for figure in figures if not figure.ok] == ["x: ended by a fault or the lever"]


def test_a_ramp_shorter_than_the_states_period_counts_as_none():
    states = [sample(10.0 * i, plc_state="RUN" if i < 20 else "HOLD") for i in range(60)]
    stop = stop_figures(states, 150 * MS, MACHINE)
    assert stop.ramp_ms == 0.0
    assert stop.reaction_ms == pytest.approx(50.0)


def test_a_stop_without_motion_is_no_measurement():
    with pytest.raises(ValueError, match="no motion"):
        stop_figures([sample(10.0 * i) for i in range(60)], 300 * MS, MACHINE)


def test_the_reaction_to_an_asked_stop_is_held_to_less():
    assert StopKind.STOP.reaction_max_ms < StopKind.SILENCE.reaction_max_ms
    assert tcp_pose(CHAIN, Q)[0, 3] > 0.0  # the posture of these tests reaches out along x
