"""Looks at rendered images of drawn worlds, beside what exact corners would have given: data for the noise fit."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from benchmarks.reproduce.fast_camera import FastCamera, Source
from benchmarks.reproduce.noise_model import CornerNoise, LookNoise, NoiseModel, OdometryNoise
from benchmarks.reproduce.true_corners import EYES, EyeName, ObjectOn, TrueView, true_poses_cam
from machine.poses import inverse_pose, pose
from machine.rotations import Array, rotation_from_rotvec
from server.vision.aruco_source import ArucoPoseSource, MonoArucoPoseSource
from server.vision.contracts import Image, ObjectPoseSource, PoseStatus
from sim_plc.camera.renderer import StereoRenderer
from sim_plc.world import World, rng_for

JPEG_QUALITY = 95  # as the simulated camera's default
_NONE = CornerNoise(0.0, 0.0)
_EXACT = NoiseModel(
    LookNoise(_NONE, _NONE), LookNoise(_NONE, _NONE), OdometryNoise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), "exact corners"
)


@dataclass(frozen=True, slots=True)
class RenderedLook:
    """One object from one standpoint: poses in the left camera, measured in n pairs, true, and by exact corners.

    `T_cam_exact` carries the machine's lens, rig, print and layout errors; what `Ts_cam_measured` (n, 4, 4) differs
    from it is the corner finder's. `seen`: markers and eyes that count; `n_other` pairs with others are left out.
    """

    seed: int
    on: ObjectOn
    source: Source
    T_base_tcp: Array
    T_cam_true: Array
    T_cam_exact: Array
    Ts_cam_measured: Array
    seen: tuple[tuple[int, EyeName], ...]
    n_other: int


def standpoints(world: World, T_base_tcp_start: Array, n: int, rng: np.random.Generator) -> list[Array]:
    """True tool poses from the start to the goal, each a little turned: where looks are taken."""
    T_ooi_tool = inverse_pose(world.scene.T_base_ooi) @ T_base_tcp_start @ world.scene.T_tcp_tool
    goal = np.array([0.0, 0.0, 0.1])
    poses = []
    for share in np.linspace(0.0, 1.0, n):
        position = (1.0 - share) * T_ooi_tool[:3, 3] + share * goal + 0.01 * rng.standard_normal(3)
        turn = rotation_from_rotvec(np.deg2rad(2.0) * (1.0 - 0.7 * share) * rng.standard_normal(3))
        poses.append(world.scene.T_base_ooi @ pose(turn, position) @ inverse_pose(world.scene.T_tcp_tool))
    return poses


def rendered_looks(
    world: World, Ts_base_tcp: list[Array], n_frames: int, renderer: StereoRenderer | None = None
) -> Iterator[RenderedLook]:
    """Looks of both pose sources at both objects from each standpoint; those that failed are left out."""
    renderer = renderer or StereoRenderer(world)
    exact = FastCamera(world, _EXACT, rng_for(world.seed, "no noise"))
    rng, view = rng_for(world.seed, "rendered looks"), TrueView(world)
    for T_base_tcp in Ts_base_tcp:
        frames = [as_sent(*renderer.render_static(T_base_tcp, rng)) for _ in range(n_frames)]
        T_tool, T_ooi = true_poses_cam(world, T_base_tcp)
        sources: dict[Source, ObjectPoseSource] = {
            "stereo": ArucoPoseSource(world.nominal),
            "mono": MonoArucoPoseSource(world.nominal),
        }
        truths: dict[ObjectOn, Array] = {"tool": T_tool, "ooi": T_ooi}
        for name, source in sources.items():
            pairs = [source.observe(left, right, k) for k, (left, right) in enumerate(frames)]
            wanted = exact.pair(T_base_tcp, name, 0)
            for on, T_true in truths.items():
                found = [getattr(pair, on) for pair in pairs]
                expected = getattr(wanted, on)
                usable = [one for one in found if one.status is PoseStatus.OK]
                Ts = [one.T_cam_object for one in usable if one.marker_ids == expected.marker_ids]
                if expected.T_cam_object is not None and len(Ts) >= 2:
                    seen = seen_by(name, view, T_base_tcp, expected.marker_ids)
                    poses = (T_true, expected.T_cam_object, np.array(Ts))
                    look = RenderedLook(world.seed, on, name, T_base_tcp, *poses, seen, len(found) - len(Ts))
                    yield look


def seen_by(
    source: Source, view: TrueView, T_base_tcp: Array, marker_ids: tuple[int, ...]
) -> tuple[tuple[int, EyeName], ...]:
    """Which markers, in which eyes, a pose of these markers rests on."""
    eyes = EYES if source == "stereo" else ("left",)
    return tuple(
        (one.marker_id, eye)
        for one in view.corners(T_base_tcp)
        for eye in eyes
        if one.marker_id in marker_ids and (one.left_px if eye == "left" else one.right_px) is not None
    )


def as_sent(left: Image, right: Image) -> tuple[Image, Image]:
    """Through the camera's JPEG."""
    coded = cv2.imencode(".jpg", np.hstack((left, right)), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
    both = np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), np.uint8)
    eyes = np.hsplit(both, 2)
    return np.ascontiguousarray(eyes[0]), np.ascontiguousarray(eyes[1])
