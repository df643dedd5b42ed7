"""Odometry over rendered calibration paths of drawn worlds, beside the true path: data for the odometry's noise."""

from collections.abc import Callable, Generator
from dataclasses import dataclass

import cv2
import numpy as np

from benchmarks.reproduce.fast_cell import FastCell, context_of, fast_cell, run_plan
from benchmarks.reproduce.fast_lens import bent_path, lens_affine
from benchmarks.reproduce.fast_machine import QuasiStaticMachine, Trace
from benchmarks.reproduce.noise_model import NoiseModel
from benchmarks.reproduce.odometry_fit import OdometryRunPair
from benchmarks.reproduce.rendered_looks import as_sent
from benchmarks.reproduce.true_corners import TrueView
from machine.poses import inverse_pose, pose
from machine.rotations import Array, rotation_from_rotvec, rotvec_from_rotation
from server.jobs.context import Method, PlanContext
from server.jobs.plans.calibrating import plan_path
from server.jobs.plans.looking import good_look
from server.jobs.requests import Arm, MachineReading, Move, Request, Settle, StartOdometry, expect_reply
from server.motion.contracts import PlanStatus
from server.targets.tool_mask import plate_and_shaft
from server.vision.contracts import OdometryStatus
from server.vision.odometry import StereoOdometry
from sim_plc.camera.renderer import StereoRenderer
from sim_plc.world import World, rng_for

RATE_HZ = 15.0  # pairs a second that the vision process keeps up with beside everything else
MASK_SCALE = 2.0  # as the server's default
GOOD_SHARE_MIN = 0.9  # of the pairs; a run that is lost more often is refused by the server too
_EDGE_S = 0.05  # exposure and readout need poses before and after


class NoPathError(RuntimeError):
    """This world gives no path or no odometry to learn from."""


@dataclass(frozen=True, slots=True)
class RenderedPath:
    """One run. `affine` (3, 3): what the world's lens makes of the way; the fast world has it too: it is no noise."""

    seed: int
    method: Method
    run: OdometryRunPair
    affine: Array
    lost_share: float

    @property
    def against_bent(self) -> OdometryRunPair:
        """The run beside the true path as the lens bends it."""
        return OdometryRunPair(self.run.Ts_vo_cam, bent_path(self.run.Ts_true, self.affine), self.run.rate_hz)


@dataclass(frozen=True, slots=True)
class TraceHistory:
    """True tool poses between the rows of a trace, straight lines between them."""

    trace: Trace

    def pose_at(self, t_ns: int, /) -> Array:
        """T_base_tcp (4, 4)."""
        t, Ts = self.trace.t_s, self.trace.Ts_base_tcp
        k = int(np.clip(np.searchsorted(t, 1e-9 * t_ns) - 1, 0, len(t) - 2))
        share = float(np.clip((1e-9 * t_ns - t[k]) / (t[k + 1] - t[k]), 0.0, 1.0))
        turn = rotvec_from_rotation(Ts[k, :3, :3].T @ Ts[k + 1, :3, :3])
        position = (1.0 - share) * Ts[k, :3, 3] + share * Ts[k + 1, :3, 3]
        return pose(Ts[k, :3, :3] @ rotation_from_rotvec(share * turn), position)


def driven_path(world: World, method: Method, noise: NoiseModel) -> Trace:
    """The calibration path of a method as the fast machine drives it from its start.

    Raises: NoPathError: the server's own planner refuses it here.
    """
    cell = fast_cell(world, QuasiStaticMachine(world), noise)
    return run_plan(_path_plan(context_of(world, method), cell), cell)


def _path_plan(ctx: PlanContext, cell: FastCell) -> Generator[Request, object, Trace]:
    yield from good_look(ctx)
    reading = expect_reply((yield Settle()), MachineReading)
    plan = plan_path(ctx, reading)
    if plan.status is not PlanStatus.OK or plan.trajectory is None:
        raise NoPathError(f"no calibration path: {plan.reason}")
    yield Arm()
    yield StartOdometry()
    t_from_s = cell.machine.t_s
    yield Move(plan.trajectory, "calibration path")
    yield Settle()
    return cell.machine.trace(t_from_s)


def rendered_path(
    world: World, method: Method, noise: NoiseModel, advance: Callable[[int, int], None] = lambda done, total: None
) -> RenderedPath:
    """Render the path's pairs, send them through JPEG and the server's odometry.

    Raises: NoPathError: no path, or the odometry was lost too often.
    """
    trace = driven_path(world, method, noise)
    history, renderer, rng = TraceHistory(trace), StereoRenderer(world), rng_for(world.seed, "rendered path")
    odometry, masks = StereoOdometry(world.nominal.camera), tool_masks(world, trace.Ts_base_tcp[0])
    stamps = np.arange(trace.t_s[0] + _EDGE_S, trace.t_s[-1] - _EDGE_S, 1.0 / RATE_HZ)
    found, kept = [], []
    for number, t_ns in enumerate(round(1e9 * t) for t in stamps):
        left, right = as_sent(*renderer.render(history, t_ns, rng))
        one = odometry.process(left, right, t_ns, *masks)
        if one.status is not OdometryStatus.LOST:
            found.append(one.T_vo_cam)
            kept.append(t_ns)
        advance(number + 1, len(stamps))
    if len(kept) < GOOD_SHARE_MIN * len(stamps):
        raise NoPathError(f"seed {world.seed}: odometry lost in {len(stamps) - len(kept)} of {len(stamps)} pairs")
    Ts = np.array([history.pose_at(t) @ world.camera.T_tcp_cam_left for t in kept])
    run = OdometryRunPair(np.array(found), inverse_pose(Ts[0]) @ Ts, RATE_HZ)
    affine = lens_affine(world, trace.Ts_base_tcp[0])
    return RenderedPath(world.seed, method, run, affine, 1.0 - len(kept) / len(stamps))


def tool_masks(world: World, T_base_tcp: Array) -> tuple[list[Array], list[Array]]:
    """Polygons over the tool in both eyes, as the pipeline masks it."""
    tools = [one for one in TrueView(world).corners(T_base_tcp) if one.on == "tool"]
    lefts = [plate_and_shaft(one.left_px, MASK_SCALE) for one in tools if one.left_px is not None]
    rights = [plate_and_shaft(one.right_px, MASK_SCALE) for one in tools if one.right_px is not None]
    return lefts, rights


def one_thread() -> None:
    """OpenCV in one thread: a bench is a guest beside others."""
    cv2.setNumThreads(1)
