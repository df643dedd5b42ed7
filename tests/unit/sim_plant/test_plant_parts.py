"""Play, friction, valve, orifice and lever geometry, one at a time."""

import numpy as np
import pytest

from sim_plc.plant.cylinder import LIFT_GEOMETRY, TILT_GEOMETRY, FourBarCylinder, interpolate_table, lever_table
from sim_plc.plant.hydraulics import (
    orifice_pressure_root,
    play_operator,
    pump_flow,
    spool_opening,
    spool_step,
    valve_flows,
)
from sim_plc.plant.kernel import lugre_step


def test_play_without_width_is_the_identity():
    assert play_operator(0.7, 0.3, 0.0) == 0.3


def test_play_follows_only_at_its_edges():
    width, output, seen = 0.2, 0.0, []
    inputs = np.concatenate([np.linspace(0.0, 1.0, 101), np.linspace(1.0, 0.0, 101)])
    for value in inputs:
        output = play_operator(output, value, width / 2.0)
        seen.append(output)
    seen = np.array(seen)
    assert np.abs(seen - inputs).max() <= width / 2.0 + 1e-15
    assert seen[100] == pytest.approx(0.9)  # trails going up
    assert seen[-1] == pytest.approx(0.1)  # and going down: the loop is as wide as the play
    assert seen[110] == seen[100]  # the gap is crossed without moving the output


def test_friction_holds_below_breakaway_and_slips_above():
    coulomb, static, viscous, stribeck, stiffness, damping, dt = 200.0, 300.0, 300.0, 5e-3, 6e6, 2e4, 2.5e-4

    def pushed(force, seconds=2.0, mass=500.0):
        x = v = z = friction = 0.0
        for step in range(round(seconds / dt)):
            applied = force * min(1.0, step * dt)  # slowly, or the bristles' bounce breaks them loose
            z, friction = lugre_step(z, v, coulomb, static, viscous, stribeck, stiffness, damping, dt)
            v += dt * (applied - friction) / mass
            x += dt * v
        return x, v

    x, v = pushed(250.0)
    assert abs(x) < 1e-4  # m, presliding only
    assert abs(v) < 1e-6  # m/s
    _, v = pushed(350.0, seconds=20.0)
    assert v == pytest.approx((350.0 - coulomb) / viscous, rel=0.02)  # m/s, Coulomb and viscous at speed


def test_friction_without_bristles_is_viscous_only():
    assert lugre_step(0.0, 0.1, 0.0, 0.0, 330.0, 5e-3, 0.0, 0.0, 2.5e-4) == (0.0, pytest.approx(33.0))


def test_dead_band_swallows_small_openings_and_keeps_full_stroke():
    assert spool_opening(0.02, 0.03) == 0.0
    assert spool_opening(-0.03, 0.03) == 0.0
    assert spool_opening(1.0, 0.03) == pytest.approx(1.0)
    assert spool_opening(-0.5, 0.0) == -0.5


def test_spool_follows_a_step_like_its_second_order_model():
    x = xd = 0.0
    omega, dt, peak = 2.0 * np.pi * 40.0, 2.5e-4, 0.0
    for _ in range(400):
        x, xd = spool_step(x, xd, 0.5, omega, 0.7, 1e9, dt)
        peak = max(peak, x)
    assert x == pytest.approx(0.5, abs=1e-6)
    assert peak == pytest.approx(0.5 * 1.046, abs=0.006)  # overshoot of damping ratio 0.7


def test_orifice_is_a_signed_root_with_a_finite_slope_at_zero():
    assert orifice_pressure_root(9e6, 2e5) == pytest.approx(9e6 / np.sqrt(9.2e6))
    assert orifice_pressure_root(-9e6, 2e5) == -orifice_pressure_root(9e6, 2e5)
    assert orifice_pressure_root(1.0, 2e5) == pytest.approx(1.0 / np.sqrt(2e5), rel=1e-4)


def test_closed_valve_passes_nothing_and_no_oil_flows_back_to_the_supply():
    assert valve_flows(0.0, 1e-7, 5e6, 8e6, 19e6, 1e5, 2e5) == (0.0, 0.0, 0.0)
    into_a, into_b, drawn = valve_flows(1.0, 1e-7, 20e6, 8e6, 19e6, 1e5, 2e5)
    assert into_a == 0.0
    assert drawn == 0.0
    assert into_b < 0.0


def test_pump_gives_its_full_flow_and_not_more():
    assert pump_flow(19e6, 19e6, 5e5, 1e-3) == 0.0
    assert pump_flow(18.75e6, 19e6, 5e5, 1e-3) == pytest.approx(5e-4)
    assert pump_flow(5e6, 19e6, 5e5, 1e-3) == 1e-3


@pytest.mark.parametrize(("geometry", "low_deg", "high_deg"), [(LIFT_GEOMETRY, -28, 83), (TILT_GEOMETRY, -148, -2)])
def test_cylinders_fit_their_stroke_and_levers_are_the_slope(geometry, low_deg, high_deg):
    low, high = np.deg2rad([low_deg, high_deg])
    y, lever = lever_table(geometry, low, high)
    assert y.max() < 0.545  # m
    assert lever.min() > 0.12  # m/rad: no dead point inside the range
    assert np.trapezoid(lever, np.linspace(low, high, len(y))) == pytest.approx(y[-1] - y[0], abs=1e-5)
    assert interpolate_table(y, low, (high - low) / (len(y) - 1), high + 1.0) == y[-1]


def test_a_linkage_that_cannot_close_says_so():
    short = FourBarCylinder((-0.1, 0.1), 0.1, 0.1, 0.5, 0.0, (-1.4, 0.0))
    with pytest.raises(ValueError, match="cannot close"):
        lever_table(short, -2.0, -0.1)
