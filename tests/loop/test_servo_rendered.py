"""The closed loop on rendered pictures and the real marker detector, in virtual time, on drawn machines.

Each exposure is rendered at rest, without motion blur and rolling shutter, and without the checks of the picture's
health. Over real UDP: `longreach bench servo`.
"""

from dataclasses import replace

import numpy as np
import pytest
from servo_virtual import VirtualCell, drive

from benchmarks.reproduce.rendered_looks import as_sent
from server.jobs.plans.servoing import servo
from server.vision.aruco_source import ArucoPoseSource
from server.vision.look import average_look
from sim_plc.camera.renderer import StereoRenderer
from sim_plc.draw_world import draw_world

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]


class RenderedCell(VirtualCell):
    """The virtual cell whose poses come from pictures of the drawn world, its wall put before the tool."""

    def __post_init__(self):
        super().__post_init__()
        world = draw_world(self.machine, self.preset, self.seed)
        world = replace(world, scene=replace(world.scene, T_base_ooi=self.T_base_ooi))
        self.renderer, self.source = StereoRenderer(world), ArucoPoseSource(self.machine)

    def pair(self, T_base_tcp):
        return self.source.observe(*as_sent(*self.renderer.render_static(T_base_tcp, self.rng)), 0)

    def _look(self):
        return average_look([self.pair(self.virtual.machine.plant.T_base_tcp()) for _ in range(5)], 1.0)

    def _seen(self, frame, fault):
        seen = super()._seen(frame, fault)
        if isinstance(frame, int):
            return seen
        pair = self.pair(frame.T_base_tcp)
        return replace(seen, tool=pair.tool, ooi=pair.ooi)


@pytest.mark.parametrize("seed", [1, 2])
def test_it_arrives_by_pictures(seed):
    cell = RenderedCell(seed=seed, rate_hz=10.0, latency_s=0.06, start_error_mm=(6.0, -5.0, 40.0))
    result = drive(servo(cell.context(silence_max_ms=170.0), lambda: cell.t_ns), cell)
    print(f"seed {seed}: {result.reason}; {result.pairs} pairs, {result.corrections} tails, true {cell.error_mm()} mm")
    assert result.reached, result.reason
    assert np.abs(cell.error_mm()).max() <= 5.0
