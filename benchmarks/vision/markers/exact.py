"""Part (i): exact projections with Gaussian corner noise, one cell at a time."""

import numpy as np

from benchmarks.vision.markers.cells import Cell, random_pose
from benchmarks.vision.markers.judged import (
    OPTIMAL_MARGIN,
    CellResult,
    Looks,
    counts,
    nearer_to_mirror,
    normalised_bias,
    ratios,
    tilt_bound_deg,
)
from benchmarks.vision.markers.opencv_rivals import ippe_left
from benchmarks.vision.markers.optimal import bounds, global_fit, predict
from machine.description import Marker, StereoCamera
from machine.markers import marker_corners
from machine.rotations import Array
from server.vision.contracts import PoseStatus
from server.vision.object_pose import PoseSettings, estimate_object_pose
from server.vision.pose_problem import Sighting

MARKER_ID = 1
SHIPPED = PoseSettings()


def look(camera: StereoCamera, side_m: float, seen: Array, settings: PoseSettings = SHIPPED) -> Looks:
    """The estimator on every look; seen (n, 16): left corners, then right ones. A look without a pose is NaN."""
    marker = Marker(marker_id=MARKER_ID, side_m=side_m, on="ooi", T_on_marker=np.eye(4))
    found = [
        estimate_object_pose(
            "ooi", (Sighting(marker, one[:8].reshape(4, 2), one[8:].reshape(4, 2)),), camera, settings
        )[0]
        for one in seen
    ]
    Ts = np.array([np.full((4, 4), np.nan) if one.T_cam_object is None else one.T_cam_object for one in found])
    covariances = np.array([np.full((6, 6), np.nan) if one.covariance is None else one.covariance for one in found])
    return Looks(Ts, covariances, np.array([one.status is not PoseStatus.OK for one in found]))


def run_cell(cell: Cell, camera: StereoCamera, n: int, seed: int) -> CellResult:
    """n looks of one cell, each with its own true pose and noise, judged against yardsticks of the bench's own."""
    rng = np.random.default_rng(cell.seed(seed))
    truths = np.array([random_pose(cell, camera, rng) for _ in range(n)])
    corners = marker_corners(cell.side_m)
    seen = predict(camera, truths, corners) + rng.normal(0.0, cell.sigma_px, (n, 16))
    best = bounds(camera, truths, corners, cell.sigma_px)
    optimal = global_fit(camera, corners, seen, truths, cell.sigma_px)
    looks = look(camera, cell.side_m, seen, PoseSettings(sigma_px=cell.sigma_px))
    rivals = np.array([ippe_left(camera, cell.side_m, one[:8].reshape(4, 2)) for one in seen])
    eyes, left = np.array([0.5 * camera.baseline_m, 0.0, 0.0]), np.zeros(3)
    return CellResult(
        side_m=cell.side_m,
        distance_m=cell.distance_m,
        tilt_deg=cell.tilt_deg,
        sigma_px=cell.sigma_px,
        n=n,
        tilt_bound_deg=tilt_bound_deg(truths, best),
        ratios={
            "ours": ratios(looks.Ts, truths, best, ~looks.flagged),
            "ours, flagged too": ratios(looks.Ts, truths, best),
            "IPPE": ratios(rivals[:, 0], truths, best),
            "IPPE+LM": ratios(rivals[:, 1], truths, best),
        },
        biases=normalised_bias(looks.Ts, truths, best),
        flagged_optimal=int((optimal.margin < OPTIMAL_MARGIN).sum()),
        flips_opencv=int(nearer_to_mirror(rivals[:, 1], truths, left).sum()) if cell.tilt_deg > 0.0 else 0,
        known=counts(looks, truths, cell.tilt_deg, eyes),
        shipped=counts(look(camera, cell.side_m, seen), truths, cell.tilt_deg, eyes),
    )
