"""Good pairs of five kinds of scene: how often does health find something where nothing is wrong?"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from benchmarks.link.load.replay_camera import to_and_fro
from benchmarks.simulator.demo_scene import demo_tcp_pose, demo_world
from benchmarks.vision.camera_faults.camera import Line
from benchmarks.vision.camera_faults.pictures import PairOfEyes
from machine.description import Machine
from machine.poses import pose
from machine.rotations import Array
from server.camera.contracts import StereoFrame, VisionSettings
from server.camera.process import build_pipeline
from server.camera.sources.settings import HttpSource
from sim_plc.camera.renderer import PoseHistory, RenderSetup, StereoRenderer
from sim_plc.camera.texture import Grey
from sim_plc.draw_world import draw_world
from sim_plc.plant.plant import Plant
from sim_plc.world import rng_for

DISTINCT = 90
RATE_HZ = 30.0
SPEED_M_S = 0.15
SHADOW_GAIN = 0.45
GOOD_KINDS = ("rest", "motion", "approach", "low_texture", "shadow")


@dataclass(frozen=True, slots=True)
class GoodCase:
    """False alarms over good pairs of one kind of scene: pairs that health kept from a look, and by which words."""

    kind: str
    seed: int
    pairs: int
    alarms: int
    texts: dict[str, int]


@dataclass(frozen=True, slots=True)
class _Moving:
    """T_base_tcp by a function of the time [s]."""

    place: Callable[[float], Array]

    def pose_at(self, t_ns: int, /) -> Array:
        """T_base_tcp."""
        return self.place(t_ns * 1e-9)


def run_good(machine: Machine, kind: str, seed: int, pairs: int) -> GoodCase:
    """Pairs of one kind, there and back, through the JPEG line and the pipeline (markers, no odometry)."""
    line = Line(seed)
    sent = [line.send(pair).frame for pair in _pictures(machine, kind, seed)]
    frames = [frame for frame in sent if frame is not None]
    pipeline = build_pipeline(VisionSettings(HttpSource("http://unused/")), machine)
    texts: Counter[str] = Counter()
    alarms = 0
    for frame in islice(_stream(frames, seed), pairs):
        report = pipeline.process(frame, 0)
        alarms += not report.fit_for_look
        texts.update(set(report.warnings))
    pipeline.close()
    return GoodCase(kind, seed, pairs, alarms, dict(texts.most_common(5)))


def _stream(frames: list[StereoFrame], seed: int) -> Iterator[StereoFrame]:
    """The same pictures again and again under new stamps, late by a latency of their own."""
    rng = np.random.default_rng([seed, 2])
    for number, index in enumerate(to_and_fro(len(frames))):
        t_ns = round((number + 1) * 1e9 / RATE_HZ)
        late_ns = round(1e6 * (50.0 + rng.exponential(3.0)))
        yield replace(frames[index], t_exposure_ns=t_ns, t_receive_mono_ns=t_ns + late_ns, sequence=number)


def _pictures(machine: Machine, kind: str, seed: int) -> Iterator[PairOfEyes]:
    renderer, path = _scene(machine, kind, seed)
    rng = rng_for(seed, "camera")
    for number in range(DISTINCT):
        left, right = renderer.render(path, round(number * 1e9 / RATE_HZ), rng)
        if kind == "shadow":
            yield _shadowed(left, number / DISTINCT), _shadowed(right, number / DISTINCT)
        else:
            yield left, right


def _scene(machine: Machine, kind: str, seed: int) -> tuple[StereoRenderer, PoseHistory]:
    if kind in ("approach", "low_texture"):
        contrast = 0.2 if kind == "low_texture" else 1.0
        truth = demo_world(
            machine,
            wall_relief_m=0.05,
            readout_s=0.011,
            exposure_s=0.004,
            texture_contrast_frac=contrast,
            texture_seed=seed,
        )
        reach_m = SPEED_M_S * DISTINCT / RATE_HZ
        return StereoRenderer(RenderSetup(*truth)), _Moving(
            lambda t_s: demo_tcp_pose(machine, 0.1 + reach_m - SPEED_M_S * t_s, (0.03, 0.0))
        )
    world = draw_world(machine, "realistic", seed)
    T_start = Plant(world.plant, world.q_start_rad).T_base_tcp()
    if kind in ("rest", "shadow"):
        return StereoRenderer(world), _Moving(lambda _: T_start)
    return StereoRenderer(world), _Moving(lambda t_s: T_start @ _round(t_s))


def _round(t_s: float) -> Array:
    """A circle of 0.1 m at 0.15 m/s, begun at rest."""
    angle = min(t_s, 0.5) * t_s * SPEED_M_S / 0.1
    return pose(np.eye(3), 0.1 * np.array([np.sin(angle), 1.0 - np.cos(angle), 0.5 * np.sin(angle)]))


def _shadowed(image: Grey, share: float) -> Grey:
    """The edge of a shadow that moves over the picture, soft as the sun makes it."""
    height, width = image.shape
    edge = (1.4 * share - 0.2) * width
    along = np.arange(width)[None, :] + 0.4 * np.arange(height)[:, None] - 0.2 * height
    light = SHADOW_GAIN + (1.0 - SHADOW_GAIN) / (1.0 + np.exp(-(along - edge) / 15.0))
    return np.clip(image * light + 0.5, 0, 255).astype(np.uint8)
