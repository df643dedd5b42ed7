"""After a calibration path the server knows on which side of their play the joints truly rest."""

import numpy as np

from benchmarks.reproduce.fast_cell import context_of, fast_cell
from benchmarks.reproduce.fast_machine import QuasiStaticMachine
from benchmarks.reproduce.noise_model import fitted_noise
from server.jobs.plans.positioning import position
from server.jobs.requests import TakeLook
from server.settings import read_machine
from sim_plc.draw_world import draw_world

SLEW = 0


def test_slew_stands_where_the_encoders_left_it_not_where_the_reference_turned():
    world = draw_world(read_machine("hiab033"), "realistic", 7001)
    machine = QuasiStaticMachine(world)
    cell, ctx = fast_cell(world, machine, fitted_noise()), context_of(world, "ours")
    plan, reply, seen = position(ctx, True, lambda: cell.clock_ns), None, []
    while len(seen) < 3:
        request = plan.send(reply)
        if isinstance(request, TakeLook):
            lag = machine._state.q[SLEW] - machine._state.output[SLEW]
            true = lag / (0.5 * world.plant.kinematics.backlash_rad[SLEW])
            believed = 0.0 if ctx.knowledge.backlash_sides is None else ctx.knowledge.backlash_sides[SLEW]
            seen.append((true, believed))
        reply = cell.perform(request)
    _, oriented, calibrated = seen
    assert np.allclose(oriented, 1.0, atol=0.05)
    assert calibrated[1] == np.sign(calibrated[0]) == -1.0
