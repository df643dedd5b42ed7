"""The same work by others: OpenCV's plain full-frame marker detector, and PyPI's toy-vo on the KITTI clip."""

import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.vision.evidence import odometry_figures, parse_poses
from benchmarks.vision.rate.pairs import PairsInMemory
from benchmarks.vision.real_pictures import kitti_camera, kitti_pairs
from machine.description import StereoCamera
from machine.rotations import geodesic_angle
from server.vision.contracts import Array, Image
from server.vision.marker_search import dictionary_by_name


def plain_aruco_ms(pairs: PairsInMemory, dictionary_name: str, n: int) -> tuple[float, float]:
    """Median and 99th percentile [ms] of `ArucoDetector` with sub-pixel corners over both whole eyes, one thread."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(dictionary_by_name(dictionary_name), parameters)
    spent = []
    for left, right in pairs.pairs[:n]:
        started = time.thread_time()
        detector.detectMarkers(left)
        detector.detectMarkers(right)
        spent.append((time.thread_time() - started) * 1e3)
    return float(np.median(spent)), float(np.percentile(spent, 99))


@dataclass(frozen=True, slots=True)
class OdometryRace:
    """Two odometries over the same clip: seconds per pair, rotation error per frame [deg], path length [m]."""

    name: str
    ms_per_pair: float
    rotation_deg: float
    path_length_m: float


def race_on_kitti(folder: Path) -> list[OdometryRace]:
    """Ours, and toy-vo where it is installed; process time, so that a busy machine does not decide."""
    camera = kitti_camera(folder)
    truth = parse_poses((folder / "poses.txt").read_text(encoding="utf-8"))
    odometry_figures(camera, list(kitti_pairs(folder))[:3], truth)  # compiled before it is timed
    pairs = list(kitti_pairs(folder))
    started = time.process_time()
    ours = odometry_figures(camera, pairs, truth)
    spent = (time.process_time() - started) * 1e3 / len(pairs)
    races = [OdometryRace("longreach", spent, ours.rotation_mean_deg, ours.path_length_m)]
    other = _toy_vo(camera, pairs, truth)
    return [*races, other] if other is not None else races


def _toy_vo(camera: StereoCamera, pairs: list[tuple[Image, Image]], truth: Array) -> OdometryRace | None:
    try:
        from toy_vo import StereoEstimator  # pyright: ignore[reportMissingImports]
    except ImportError:
        return None
    none, no_turn, shift = np.zeros(5), np.zeros(3), np.array([-camera.baseline_m, 0.0, 0.0])
    eye = (camera.matrix, none, "OpenCVModel5", camera.width_px, camera.height_px)
    estimator = StereoEstimator(*eye, *eye, no_turn, shift)
    Ts = []
    started = time.process_time()
    for left, right in pairs:
        Ts.append(np.array(estimator.process_frame(left, right)["T_w_cam0"]))
    spent = (time.process_time() - started) * 1e3 / len(pairs)
    steps = [
        np.rad2deg(geodesic_angle(truth[i].T @ truth[i + 1], Ts[i][:3, :3].T @ Ts[i + 1][:3, :3]))
        for i in range(len(Ts) - 1)
    ]
    length = float(np.linalg.norm(np.diff(np.array(Ts)[:, :3, 3], axis=0), axis=1).sum())
    return OdometryRace("toy-vo", spent, float(np.mean(steps)), length)
