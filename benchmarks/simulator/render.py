"""How fast pairs are rendered: ms per pair and per stage, on one thread."""

import time
from dataclasses import dataclass
from importlib.resources import files

import cv2
import numpy as np

from benchmarks.simulator.demo_scene import demo_tcp_pose, demo_world
from machine.description import parse_machine_toml
from machine.poses import pose
from machine.rotations import Array, rotation_from_rotvec
from sim_plc.camera.renderer import RenderSetup, StereoRenderer

_MACHINE = "hiab033.toml"


@dataclass(frozen=True, slots=True)
class RenderFigures:
    """What rendering costs on one thread."""

    n_pairs: int
    pairs_per_s: float
    ms_per_pair: float
    build_s: float  # texture, relief, rays, tool; and compiling on a machine's first run
    ms_per_stage: dict[str, float]


@dataclass(frozen=True, slots=True)
class _Approach:
    """A tool that approaches the OOI at 0.15 m/s from one start."""

    T_base_start: Array

    def pose_at(self, t_ns: int, /) -> Array:
        """T_base_tcp."""
        T = self.T_base_start.copy()
        T[2, 3] -= 0.15e-9 * t_ns
        return T


def bench_render(n: int = 50, seed: int = 1) -> RenderFigures:
    """Render `n` pairs of an approach from 0.9 m to 0.1 m with everything on: relief, structure, shutter, noise."""
    machine = parse_machine_toml(files("machine").joinpath("machines", _MACHINE).read_text())
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        start = time.perf_counter()
        truths = demo_world(
            machine, wall_relief_m=0.05, readout_s=0.011, exposure_s=0.004, texture_seed=seed, structure_frac=0.15
        )
        renderer = StereoRenderer(RenderSetup(*truths))
        tilt = pose(rotation_from_rotvec(np.array([0.05, -0.06, 0.04])), np.zeros(3))
        approach = _Approach(demo_tcp_pose(machine, 0.9, (0.05, 0.0)) @ tilt)
        rng = np.random.default_rng(seed)
        renderer.render(approach, 0, rng)
        build_s = time.perf_counter() - start
        renderer.times.total_s.clear()
        start = time.perf_counter()
        for t_mid_ns in np.linspace(0.0, 0.8e9 / 0.15, n):
            renderer.render(approach, int(t_mid_ns), rng)
        total_s = time.perf_counter() - start
    finally:
        cv2.setNumThreads(threads)
    stages = {stage: round(1e3 * spent_s / n, 2) for stage, spent_s in renderer.times.total_s.items()}
    return RenderFigures(n, round(n / total_s, 1), round(1e3 * total_s / n, 2), round(build_s, 2), stages)
