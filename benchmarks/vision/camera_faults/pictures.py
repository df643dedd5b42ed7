"""Good pictures of one seed, rendered once: at rest in front of the OOI, and on a path there and back."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from benchmarks.link.load.replay_camera import to_and_fro
from machine.description import Machine
from machine.poses import pose
from machine.rotations import Array
from sim_plc.camera.faults import SCENE_FAULTS, FaultKind, faulty_scene
from sim_plc.camera.renderer import StereoRenderer
from sim_plc.camera.texture import Grey
from sim_plc.draw_world import draw_world
from sim_plc.plant.plant import Plant
from sim_plc.world import World, rng_for

RATE_HZ = 30.0
AT_REST = 16  # pictures with noise of their own, shown in random order
ON_PATH = 60
PATH_M, PATH_S = 0.15, 4.0  # sideways and back: 0.12 m/s at the most

PairOfEyes = tuple[Grey, Grey]


@dataclass(frozen=True, slots=True)
class _Sideways:
    """A tool that goes sideways and back in its own plane, gently at both ends."""

    T_base_start: Array

    def pose_at(self, t_ns: int, /) -> Array:
        """T_base_tcp."""
        angle = np.pi * t_ns * 1e-9 / (0.5 * PATH_S)
        shift = 0.5 * PATH_M * (1.0 - np.cos(angle)) * np.array([1.0, 0.4, 0.3])
        return self.T_base_start @ pose(np.eye(3), shift)


@dataclass(frozen=True, slots=True)
class Pictures:
    """Pairs at rest and on the path, with the scene as it should be and with each fault of the scene."""

    at_rest: dict[FaultKind, tuple[PairOfEyes, ...]]
    on_path: tuple[PairOfEyes, ...]

    def stream(self, moving: bool, seed: int) -> Iterator[dict[FaultKind, PairOfEyes]]:
        """Endless: for every moment the pair of each scene (a scene without its own pictures shows the good one)."""
        rng = np.random.default_rng(seed)
        if moving:
            order = to_and_fro(len(self.on_path))
            skipped = int(rng.integers(0, 2 * len(self.on_path)))
            for number, index in enumerate(order):
                if number >= skipped:
                    yield {FaultKind.NONE: self.on_path[index]}
        last = 0
        for _ in count():
            last = (last + 1 + int(rng.integers(0, AT_REST - 1))) % AT_REST  # never the same one twice
            yield {kind: pairs[last] for kind, pairs in self.at_rest.items()}


def render_pictures(machine: Machine, seed: int, preset: str = "realistic") -> Pictures:
    """All pictures of one seed; about 100 pairs."""
    world = draw_world(machine, preset, seed)
    T_base_tcp = Plant(world.plant, world.q_start_rad).T_base_tcp()
    rng = rng_for(seed, "camera")
    at_rest = {
        kind: _rest(_with_fault(world, kind), T_base_tcp, rng)
        for kind in (FaultKind.NONE, *sorted(SCENE_FAULTS, key=lambda kind: kind.value))
    }
    renderer, path = StereoRenderer(world), _Sideways(T_base_tcp)
    times_ns = [round(number * 0.5 * PATH_S * 1e9 / (ON_PATH - 1)) for number in range(ON_PATH)]
    return Pictures(at_rest, tuple(renderer.render(path, t_ns, rng) for t_ns in times_ns))


def _with_fault(world: World, kind: FaultKind) -> World:
    return replace(world, scene=faulty_scene(kind, world.scene))


def _rest(world: World, T_base_tcp: Array, rng: np.random.Generator) -> tuple[PairOfEyes, ...]:
    renderer = StereoRenderer(world)
    return tuple(renderer.render_static(T_base_tcp, rng) for _ in range(AT_REST))
