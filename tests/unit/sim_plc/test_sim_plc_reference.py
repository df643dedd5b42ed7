"""Stops on curved paths: the bound on time and every limit hold, whichever way is taken down to rest."""

import numpy as np
import pytest
from virtual_plc import MACHINE, MS, Q_START, TABLE

from protocol.messages import Command, Knot, pad_to_eight_axes
from sim_plc.plc.knot_ring import KnotRing, PlaybackView
from sim_plc.plc.reference import Motion, Reference
from sim_plc.plc.settings import plc_settings

SETTINGS = plc_settings(MACHINE)
LIMITS = SETTINGS.qdd_stop
CYCLE_S = 1e-3


def curved_knots(seed, count=60):
    """From rest into joint sines of different frequencies: no two joints brake alike."""
    rng = np.random.default_rng(seed)
    omega = rng.uniform(1.0, 3.0, 6)
    amplitude = 0.75 * np.minimum(SETTINGS.qdd_stop / omega**2, 0.7 * np.array([a.qd_max for a in TABLE.axes]) / omega)
    knots = []
    for i in range(count):
        t = i * 0.05
        fade = min(t / 1.0, 1.0)  # 10 u^3 - 15 u^4 + 6 u^5: in one second to full amplitude
        f = 10 * fade**3 - 15 * fade**4 + 6 * fade**5
        fd = (30 * fade**2 - 60 * fade**3 + 30 * fade**4) if t < 1.0 else 0.0
        fdd = (60 * fade - 180 * fade**2 + 120 * fade**3) if t < 1.0 else 0.0
        s, c = np.sin(omega * t), np.cos(omega * t)
        q = np.array(Q_START) + amplitude * f * s
        qd = amplitude * (fd * s + f * omega * c)
        qdd = amplitude * (fdd * s + 2 * fd * omega * c - f * omega**2 * s)
        knots.append(
            Knot(i * 50 * MS, pad_to_eight_axes(tuple(q)), pad_to_eight_axes(tuple(qd)), pad_to_eight_axes(tuple(qdd)))
        )
    return knots


def playing(seed):
    ring = KnotRing(TABLE)
    knots = curved_knots(seed)
    view = PlaybackView(pad_to_eight_axes(Q_START))
    for first in range(0, len(knots), 6):
        part = tuple(knots[first : first + 6])
        ring.load_knots(Command(1, 1, 0, traj_id=1, knot_first=first, knots=part), view)
    reference = Reference(SETTINGS, ring)
    reference.hold_at(np.array(Q_START))
    reference.play_from_start()
    return reference


def run_down(reference):
    """Cycles to rest, every one held against the limits."""
    before, cycles = reference.qd.copy(), 0
    while True:
        over = reference.step(0)
        assert (np.abs(reference.qd - before) <= 1.002 * LIMITS * CYCLE_S).all()
        before, cycles = reference.qd.copy(), cycles + 1
        if over:
            return cycles


@pytest.mark.parametrize("seed", range(8))
def test_a_stop_takes_no_longer_than_speed_over_deceleration_wherever_it_begins(seed):
    ways = set()
    for after in range(150, 2400, 90):
        reference = playing(seed)
        for _ in range(after):
            assert not reference.step(0)
        bound_s = float((np.abs(reference.qd) / LIMITS).max())
        reference.stop()
        ways.add(reference.motion)
        assert run_down(reference) * CYCLE_S <= bound_s + 2.1 * CYCLE_S
        reference.settle()
        assert (reference.qd == 0.0).all()
    assert ways <= {Motion.PATH_STOP, Motion.JOINT_STOP}


def test_both_ways_down_are_used_on_curved_paths():
    ways = []
    for seed in range(4):
        for after in range(150, 2400, 90):
            reference = playing(seed)
            for _ in range(after):
                reference.step(0)
            reference.stop()
            ways.append(reference.motion)
    assert ways.count(Motion.PATH_STOP) > len(ways) / 4
    assert ways.count(Motion.JOINT_STOP) > 0


def test_a_straight_stop_stays_inside_the_joint_range():
    ring = KnotRing(TABLE)
    reference = Reference(SETTINGS, ring)
    limits = TABLE.axes
    qd = np.array([0.0, 0.5 * limits[1].qd_max, 0.0, limits[3].qd_max, 0.0, 0.0])
    room = qd**2 / (2 * LIMITS)
    q = np.array(Q_START)
    q[1] = limits[1].q_max - 1.05 * room[1]  # braking together with the slower wrist would carry it out
    reference.hold_at(q)
    reference._out[1] = qd
    reference._stop_straight()
    run_down(reference)
    assert reference.q[1] <= limits[1].q_max
    assert np.abs(reference.qd).max() == 0.0


def test_quick_stop_out_of_a_path_stop():
    reference = playing(1)
    for _ in range(800):
        reference.step(0)
    reference.stop()
    for _ in range(20):
        reference.step(0)
    reference.quick_stop()
    assert reference.motion is Motion.JOINT_STOP
    run_down(reference)


def test_stop_while_holding_changes_nothing():
    reference = Reference(SETTINGS, KnotRing(TABLE))
    reference.hold_at(np.array(Q_START))
    reference.stop()
    reference.quick_stop()
    assert reference.motion is Motion.HOLD
    assert not reference.step(0)
    assert tuple(reference.q) == Q_START
