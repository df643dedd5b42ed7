"""Jog on the real PC end, the real PLC program and the fine plant in virtual time: let go or gone silent, it rests."""

import numpy as np
import pytest

from benchmarks.simulator.virtual import VirtualMachine
from machine.chain import chain_of
from machine.kinematics import tcp_poses
from machine.poses import pose
from protocol.codes import PlcState
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import Knowledge
from server.jobs.plans.jogging import jog
from server.jobs.requests import MachineReading, Move, Settle
from server.link.samples import knots_from, knots_of
from server.motion.jog import jog_axes
from server.motion.wall_clearance import clearances
from server.settings import ServerSettings, read_machine
from sim_plc.draw_world import draw_world

MACHINE = read_machine("hiab033")
CHAIN = chain_of(MACHINE)
AXES = jog_axes(CHAIN.n)
SETTINGS = ServerSettings()
SPEED_M_S = 0.030
PRESSES_MAX = 6
REST_MS = 1500
RAMP_S = 0.5 + 0.025  # longest ramp of the PLC, and one command of the link before it
WATCHDOG_S = 0.25
STILL_M = 1e-3  # in a period of the boom, which goes on swinging by millimetres; at the jog's speed it were 12 mm
SWING_ROWS = 40  # rows of 10 ms: a period of the 2.5 Hz boom mode


def knots_of_jog(virtual, ctx, axis, direction):
    """What the plan sends to the link from where the machine stands; None where it refuses."""
    plan = jog(ctx, axis, direction)
    plant = virtual.machine.plant
    reading = MachineReading(plant.q_encoder_rad.copy(), virtual.q_ref, 0, 0)
    reply = None
    for _ in range(10):
        request = plan.send(reply)
        if isinstance(request, Settle):
            reply = reading
            continue
        if isinstance(request, Move):
            plan.close()
            return knots_from(knots_of(request.trajectory, CHAIN.n))
        reply = None
    raise AssertionError("no motion within ten requests")


def pc_is_gone(virtual, n_ms):
    """The PLC alone: nothing comes from the PC any more."""
    for _ in range(n_ms):
        virtual.machine.run_cycle()
        if virtual.machine.t_plc_ns % 10_000_000 == 0:
            virtual._note(virtual.machine.t_plc_ns)


def moved_m(trace, t_s):
    """How far the true tool gets from where it was at a moment [m]."""
    points = trace.Ts_base_tcp[trace.t_s >= t_s][:, :3, 3]
    return float(np.linalg.norm(points - points[0], axis=1).max())


def drift_m(trace):
    """How far the tool goes from one period of the boom's swinging to the next, at the end of a trace [m]."""
    points = trace.Ts_base_tcp[-2 * SWING_ROWS :, :3, 3]
    return float(np.linalg.norm(points[SWING_ROWS:].mean(axis=0) - points[:SWING_ROWS].mean(axis=0)))


def armed_before_a_wall(seed):
    """A world with its PLC armed, and what the plan knows: a wall half a metre ahead of the tool."""
    virtual, ctx = (
        VirtualMachine(draw_world(MACHINE, "realistic", seed)),
        PlanContext(MACHINE, CHAIN, SETTINGS, Knowledge()),
    )
    virtual.arm()
    virtual.step(500)
    T = virtual.machine.plant.T_base_tcp()
    ctx.knowledge.T_base_ooi = pose(T[:3, :3] @ MACHINE.T_tcp_tool[:3, :3], T[:3, 3] - 0.5 * T[:3, 2])
    return virtual, ctx


@pytest.mark.parametrize("ending", ["let go", "dead network"])
@pytest.mark.parametrize("presses", [8, pytest.param(100, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])])
def test_however_it_ends_the_machine_rests_within_the_ramp(ending, presses):
    """Presses spread over worlds, axes, directions and moments."""
    rng = np.random.default_rng(7 if ending == "let go" else 8)
    for number in range(presses):
        virtual, ctx = armed_before_a_wall(seed=1 + number)
        knots = knots_of_jog(virtual, ctx, AXES[int(rng.integers(len(AXES)))], (-1, 1)[number % 2])
        assert virtual.client.request_run(1 + number, knots, virtual.machine.t_plc_ns) == ()
        virtual.step(int(rng.integers(100, 2500)))
        assert virtual.machine.plc.state is PlcState.RUN
        t_s = virtual.trace().t_s[-1]
        if ending == "let go":
            virtual.client.request_stop("hold-to-run: button up")
            virtual.step(REST_MS)
            allowed_m = SPEED_M_S * RAMP_S
        else:
            pc_is_gone(virtual, REST_MS)
            allowed_m = SPEED_M_S * (RAMP_S + WATCHDOG_S)
        trace = virtual.trace()
        assert virtual.machine.plc.state is not PlcState.RUN
        assert moved_m(trace, t_s) <= allowed_m
        assert drift_m(trace) < STILL_M
        require_inside(trace, ctx)


def require_inside(trace, ctx):
    """Joint ranges and the clearance to the wall, of the joints and the tool as they truly moved."""
    q, wall = trace.q_encoder, ctx.wall
    assert (q >= CHAIN.q_min).all()
    assert (q <= CHAIN.q_max).all()
    seen, true = (clearances(Ts, MACHINE.T_tcp_tool, wall).min() for Ts in (tcp_poses(CHAIN, q), trace.Ts_base_tcp))
    assert seen >= wall.clearance_min_m
    assert true >= 0.9 * wall.clearance_min_m  # the encoders' zeros and the links are not the nominal ones


@pytest.mark.parametrize("seed", [1, 2])
def test_held_down_towards_the_wall_it_ends_in_front_of_it(seed):
    """The longest press: 0.5 m to a wall, at 30 mm/s. The server's clearance is 50 mm."""
    virtual, ctx = armed_before_a_wall(seed)
    ended = virtual.play(knots_of_jog(virtual, ctx, "z", -1))
    assert ended.reached, ended.reason
    virtual.step(REST_MS)
    require_inside(virtual.trace(), ctx)
    T = virtual.trace().Ts_base_tcp
    assert np.linalg.norm(T[-1, :3, 3] - T[0, :3, 3]) > 0.3


@pytest.mark.parametrize(
    ("axis", "direction", "why"), [("joint_2", 1, "lift"), pytest.param("joint_3", -1, "tilt", marks=pytest.mark.slow)]
)
def test_pressed_until_nothing_is_left_it_keeps_joint_ranges(axis, direction, why):
    """Without a wall: press after press in one direction, until the server refuses the next one."""
    virtual, ctx = armed_before_a_wall(seed=1)
    ctx.knowledge.T_base_ooi = None
    refused = ""
    for _ in range(PRESSES_MAX):
        try:
            knots = knots_of_jog(virtual, ctx, axis, direction)
        except JobFailedError as error:
            refused = str(error)
            break
        ended = virtual.play(knots)
        assert ended.reached, ended.reason
        virtual.step(REST_MS)
    assert why in refused
    q = virtual.trace().q_encoder
    assert (q >= CHAIN.q_min).all()
    assert (q <= CHAIN.q_max).all()
    assert np.ptp(q, axis=0).max() > np.deg2rad(5.0)  # it has moved, and not only been refused
