"""Whole jobs in virtual time: the fast world's plant and odometry, but every look is of rendered pairs.

Real time plays no part, so the computer's load does not decide how many jobs there are. Left out are the link, the
camera stream and the odometry's own images: `fast_odometry` stands in, with noise fitted to rendered runs.
"""

from dataclasses import asdict, dataclass, replace

import numpy as np

from benchmarks.reproduce.fast_camera import FastCamera, Source
from benchmarks.reproduce.fast_cell import FastCell, context_of, run_plan
from benchmarks.reproduce.fast_machine import QuasiStaticMachine
from benchmarks.reproduce.noise_model import NoiseModel, fitted_noise
from benchmarks.targets.rendered import (
    CLICK_U_PX,
    CLICK_V_PX,
    NOT_CHOSEN,
    PRESET,
    TRIES,
    UNREACHABLE,
    PointCase,
)
from benchmarks.targets.scene import left_eye, true_target
from machine.description import Machine
from machine.poses import inverse_pose, pose
from machine.rotations import Array, geodesic_angle
from server.errors import ServerError
from server.jobs.context import PlanContext
from server.jobs.plans.positioning import position
from server.jobs.plans.reach import ReachPreview, reach_preview
from server.jobs.requests import MachineReading, Settle
from server.targets.anchor import anchor_target
from server.targets.contracts import AnchoredTarget, TargetSettings
from server.targets.source import TargetPoseSource
from server.targets.surface import measure_patch
from server.targets.taught import TaughtObject
from server.targets.tool_mask import ToolMask
from server.vision.aruco_source import ArucoPoseSource
from server.vision.contracts import Image, Look, PairObservation
from server.vision.look import average_look
from sim_plc.camera.renderer import StereoRenderer
from sim_plc.draw_scene import with_bare_rock
from sim_plc.draw_world import draw_world
from sim_plc.presets import PresetError
from sim_plc.world import World, rng_for

STEP_S = 0.5  # of the pairs shown to the source between looks: at the fastest path 25 mm apart
STAND_OFF_M = 0.1
MASK_SCALE = 2.0  # as `VisionSettings` has it


@dataclass(frozen=True, slots=True)
class JobErrors:
    """One job. true_mm: tool minus goal in true target axes after each move; rotation_deg: the same angle."""

    state: str
    reason: str
    true_mm: tuple[tuple[float, float, float], ...] = ()
    image_mm: tuple[tuple[float, float, float], ...] = ()
    rotation_deg: tuple[float, ...] = ()
    reached: bool = False


class RenderedCamera(FastCamera):
    """Looks at rendered pairs of a world; between looks the source sees the way."""

    def __init__(self, world: World, noise: NoiseModel, rng: np.random.Generator, machine: QuasiStaticMachine) -> None:
        super().__init__(world, noise, rng)
        nominal = world.nominal
        self._machine, self._seen_s, self._rng_image = machine, machine.t_s, rng
        self.renderer = StereoRenderer(world)
        self.source = TargetPoseSource(ArucoPoseSource(nominal), nominal.camera, tool_mask(nominal))

    def show(self, T_base_tcp: Array) -> tuple[PairObservation, Image, Image]:
        """One pair at rest and what the source makes of it."""
        left, right = self.renderer.render_static(T_base_tcp, self._rng_image)
        return self.source.observe(left, right, 0), left, right

    def look(self, T_base_tcp: Array, pairs: int, source: Source, spread_max_mm: float) -> Look:
        """The server's own mean over rendered pairs."""
        if source == "mono":
            raise ValueError("a target is found by both eyes only")
        trace = self._machine.trace(np.nextafter(self._seen_s, np.inf))
        for t_s in np.arange(self._seen_s + STEP_S, self._machine.t_s, STEP_S):
            self.show(trace.Ts_base_tcp[min(int(np.searchsorted(trace.t_s, t_s)), len(trace.t_s) - 1)])
        self._seen_s = self._machine.t_s
        return average_look([self.show(T_base_tcp)[0] for _ in range(pairs)], spread_max_mm)


@dataclass(slots=True)
class VirtualBench:
    """One drawn machine before a wall, at rest, with its true left eye."""

    world: World
    cell: FastCell
    camera: RenderedCamera
    ctx: PlanContext

    @property
    def T_ooi_cam(self) -> Array:
        """The true left eye now."""
        return left_eye(self.camera.renderer, self.cell.machine.T_base_tcp())

    def pair(self) -> tuple[PairObservation, Image, Image]:
        """What the camera shows now."""
        return self.camera.show(self.cell.machine.T_base_tcp())

    def reach(self, seen: PairObservation, target: AnchoredTarget | TaughtObject, T_cam_target: Array) -> ReachPreview:
        """The preview from here."""
        reading = self.cell.perform(Settle())
        if not isinstance(reading, MachineReading):
            raise TypeError("the fast world gave no reading")
        return reach_preview(self.ctx, reading, seen.tool, target, T_cam_target)

    def positioned(self, T_ooi_target: Array) -> JobErrors:
        """The positioning job on what the source serves, against the target's true place in the OOI's frame."""
        try:
            plan = position(self.ctx, True, lambda: self.cell.clock_ns)
            result = run_plan(plan, self.cell)
        except ServerError as error:
            return JobErrors("refused", str(error))
        goal = T_ooi_target @ pose(np.eye(3), np.array([0.0, 0.0, STAND_OFF_M]))
        scene = self.world.scene
        T_goal_base = inverse_pose(goal) @ inverse_pose(scene.T_base_ooi)
        moves = [move for move in result.moves if move.kind == "move" and move.after is not None]
        errors = [T_goal_base @ self.cell.true_looks[move.t_rest_plc_ns] @ scene.T_tcp_tool for move in moves]
        return JobErrors(
            state="done",
            reason=result.reason,
            true_mm=tuple(_three(1e3 * error[:3, 3]) for error in errors),
            image_mm=tuple((m.after.x_mm, m.after.y_mm, m.after.z_mm) for m in moves if m.after is not None),
            rotation_deg=tuple(float(np.rad2deg(geodesic_angle(np.eye(3), error[:3, :3]))) for error in errors),
            reached=result.reached,
        )


def virtual_bench(world: World) -> VirtualBench:
    """A world's machine at its start."""
    rng, noise = rng_for(world.seed, "virtual jobs"), fitted_noise()
    machine = QuasiStaticMachine(world)
    camera = RenderedCamera(world, noise, rng, machine)
    cell = FastCell(world, machine, camera, noise, rng, world.camera.latency_s)
    return VirtualBench(world, cell, camera, context_of(world, "ours"))


def virtual_case(machine: Machine, seed: int) -> PointCase | None:
    """One machine, one click among those that the preview accepts, one job; None where no such world can be drawn."""
    try:
        bench = virtual_bench(with_bare_rock(draw_world(machine, PRESET, seed)))
    except PresetError:
        return None
    none = PointCase(seed, NOT_CHOSEN, "", 0, 0, np.nan, np.nan, (), (), (), False, 0.0)
    target, refused = _clicked(bench, np.random.default_rng([seed, 0x636C69636B]), TargetSettings())
    none = replace(
        none,
        refused_clicks=len(refused) - refused.count(UNREACHABLE),
        unreachable_clicks=refused.count(UNREACHABLE),
    )
    if target is None:
        return replace(none, reason=f"no click was accepted: {sorted(set(refused))}")
    bench.camera.source.use_target(target)
    bench.ctx.knowledge.target = target
    T_ooi_cam, left = bench.T_ooi_cam, bench.world.camera.left
    T_cam_target = true_target(bench.camera.renderer.relief, left, T_ooi_cam, target.patch.pixel)
    apart = np.linalg.norm(target.T_ref_target[:3, 3]) - np.linalg.norm(T_cam_target[:3, 3])
    done = bench.positioned(T_ooi_cam @ T_cam_target)
    return replace(none, **asdict(done), place_mm=float(1e3 * abs(apart)), seconds=bench.cell.machine.t_s)


def _clicked(
    bench: VirtualBench, rng: np.random.Generator, settings: TargetSettings
) -> tuple[AnchoredTarget | None, list[str]]:
    """As the operator of `rendered`: the first click that is measured and reachable; why others were not."""
    refused: list[str] = []
    seen, left, right = bench.pair()
    camera = bench.world.nominal.camera
    for number in range(1, TRIES + 1):
        pixel = float(rng.uniform(*CLICK_U_PX)), float(rng.uniform(*CLICK_V_PX))
        found = measure_patch(left, right, camera, pixel, settings)
        if found.ok:
            found = anchor_target(number, found, left, right, camera, settings, bench.camera.source.masks_px)
        if not isinstance(found, AnchoredTarget):
            refused.append(found.status.value)
        elif bench.reach(seen, found, found.T_ref_target).status == "reachable":
            return found, refused
        else:
            refused.append(UNREACHABLE)
    return None, refused


def tool_mask(machine: Machine) -> ToolMask:
    """As the vision process masks the own tool."""
    return ToolMask([marker.marker_id for marker in machine.markers_on("tool")], MASK_SCALE)


def _three(values: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
