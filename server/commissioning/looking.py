"""Pictures for a step: fresh pairs at rest, and what the markers in them say by themselves."""

from collections.abc import Sequence

import numpy as np

from machine.camera import undistort_to_rays
from machine.description import StereoCamera
from machine.rotations import Array, nearest_rotation
from recording.clock import mono_ns
from server.camera.client import VisionClient
from server.camera.contracts import FrameReport
from server.commissioning.moving import NotReadyError, wait_for
from server.commissioning.site import Site
from server.vision.contracts import ObjectPose

_SLACK_NS = 200_000_000  # a mapped exposure may lie this much behind the true one
_TIMEOUT_S = 15.0


def camera_of(site: Site) -> VisionClient:
    """The vision process' handle. Raises: NotReadyError: none was started."""
    if site.vision is None:
        raise NotReadyError("no camera was started; run the steps that look with a camera in the settings")
    return site.vision


async def fresh_pairs(site: Site, n: int, text: str) -> list[FrameReport]:
    """The next n pairs that were exposed from now on. Raises: NotReadyError: they did not come in time."""
    vision, t_from_ns = camera_of(site), mono_ns()

    def fresh() -> list[FrameReport]:
        reports = vision.reports_since(t_from_ns)
        return [report for report in reports if report.t_exposure_mapped_ns >= t_from_ns + _SLACK_NS]

    if not await wait_for(site, lambda: len(fresh()) >= n, _TIMEOUT_S, text):
        raise NotReadyError(
            f"{len(fresh())} of {n} pairs within {_TIMEOUT_S:.0f} s; {vision.stream_text or 'the camera is too slow'}"
        )
    return fresh()[:n]


def disparities_px(reports: Sequence[FrameReport]) -> list[float]:
    """Left minus right column of every marker that both eyes see, in every pair: positive for eyes that belong so."""
    return [
        float(np.median(view.corners_left_px[:, 0] - view.corners_right_px[:, 0]))
        for report in reports
        for view in report.observation.marker_views
        if view.corners_left_px is not None and view.corners_right_px is not None
    ]


def mean_pose(poses: Sequence[ObjectPose]) -> Array | None:
    """Median position and mean rotation of an object over pairs (4, 4); None where no pair has it."""
    Ts = [pose.T_cam_object for pose in poses if pose.T_cam_object is not None]
    if not Ts:
        return None
    T = np.eye(4)
    T[:3, :3] = nearest_rotation(np.mean([each[:3, :3] for each in Ts], axis=0))
    T[:3, 3] = np.median([each[:3, 3] for each in Ts], axis=0)
    return T


def corners_by_stereo(camera: StereoCamera, left_px: Array, right_px: Array) -> Array:
    """Corners of one marker by both eyes alone, without its size.

    Model:   z = baseline / (x_left - x_right) on undistorted rays, point = z (x_left, mean y, 1); parallel eyes.
    Args:    left_px, right_px: the same corners (n, 2) [raw px].
    Returns: (n, 3) [m] in the left eye; behind the eye where the eyes are swapped.
    """
    left, right = undistort_to_rays(camera, left_px), undistort_to_rays(camera, right_px)
    z = camera.baseline_m / (left[:, 0] - right[:, 0])
    y = 0.5 * (left[:, 1] + right[:, 1])
    return np.column_stack((z * left[:, 0], z * y, z))


def mean_side_m(corners: Array) -> float:
    """Mean side of a square by its corners in order (4, 3) [m]."""
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean())
