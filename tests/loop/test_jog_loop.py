"""Jog on the real PC end, the real PLC program and the fine plant in virtual time: let go or gone silent, it rests."""

import numpy as np
import pytest

from benchmarks.simulator.virtual import VirtualMachine
from machine.chain import chain_of
from machine.kinematics import tcp_poses
from machine.poses import pose
from protocol.codes import PlcState
from server.jobs.context import PlanContext
from server.jobs.knowledge import Knowledge
from server.jobs.plans.jogging import jog
from server.jobs.requests import MachineReading, Move, Settle
from server.link.knots import knots_from, knots_of
from server.motion.jog import jog_axes
from server.motion.wall_clearance import clearances
from server.settings import ServerSettings, read_machine
from sim_plc.draw_world import draw_world

MACHINE = read_machine("hiab033")
CHAIN = chain_of(MACHINE)
AXES = jog_axes(CHAIN.n)
SPEED_M_S = 0.030
REST_MS = 1500
RAMP_S = 0.5 + 0.025  # longest ramp of the PLC, and one command of the link before it
WATCHDOG_S = 0.25


def context():
    """The machine before a wall half a metre ahead of its tool."""
    return PlanContext(MACHINE, CHAIN, ServerSettings(), Knowledge())


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
        virtual.machine.cycle()
        if virtual.machine.t_plc_ns % 10_000_000 == 0:
            virtual._note(virtual.machine.t_plc_ns)


def moved_m(trace, t_s):
    """How far the true tool gets from where it was at a moment [m]."""
    points = trace.Ts_base_tcp[trace.t_s >= t_s][:, :3, 3]
    return float(np.linalg.norm(points - points[0], axis=1).max())


@pytest.mark.parametrize("ending", ["let go", "dead network"])
def test_however_it_ends_the_machine_rests_within_the_ramp(ending):
    """100 presses each, spread over axes, directions and moments."""
    rng = np.random.default_rng(7 if ending == "let go" else 8)
    presses = 0
    for seed in range(1, 11):
        virtual = VirtualMachine(draw_world(MACHINE, "realistic", seed))
        virtual.arm()
        virtual.step(500)
        ctx = context()
        tool = virtual.machine.plant.T_base_tcp()
        ctx.knowledge.T_base_ooi = pose(tool[:3, :3] @ MACHINE.T_tcp_tool[:3, :3], tool[:3, 3] - 0.5 * tool[:3, 2])
        for number in range(10):
            axis, direction = AXES[int(rng.integers(len(AXES)))], (-1, 1)[number % 2]
            knots = knots_of_jog(virtual, ctx, axis, direction)
            assert virtual.client.request_run(100 * seed + number, knots, virtual.machine.t_plc_ns) == ()
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
            assert np.abs(np.diff(trace.q_ref[-20:], axis=0)).max() == 0.0
            print(ending,axis,virtual.machine.plc.state,round(moved_m(trace, t_s)*1e3,2), allowed_m*1e3)
            assert moved_m(trace, t_s) <= allowed_m
            presses += 1
            if ending == "dead network":
                virtual.client.request_reset()
                virtual.step(500)
                virtual.arm()
                virtual.step(300)
        q = virtual.trace().q_encoder
        assert (q >= CHAIN.q_min - 1e-3).all()
        assert (q <= CHAIN.q_max + 1e-3).all()
        wall = ctx.wall
        assert wall is not None
        assert clearances(virtual.trace().Ts_base_tcp, MACHINE.T_tcp_tool, wall).min() >= wall.clearance_min_m
    assert presses == 100
