"""Figures on real images: recall and corner errors of the marker search, rotation and length errors of the odometry.

Pure: images and truth come in as arrays and text, figures go out. Reading files is the command's work.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from time import perf_counter

import cv2
import numpy as np

from machine.description import StereoCamera
from machine.rotations import geodesic_angle, nearest_rotation
from server.vision.contracts import Array, Image, OdometryStatus
from server.vision.edge_fit import SideFit
from server.vision.errors import VisionError
from server.vision.marker_search import (
    IMAGE_SIDE_MIN_PX,
    FoundMarker,
    detect_markers,
    dictionary_by_name,
    find_markers,
    refined_marker,
    same_place,
    search_parameters,
)
from server.vision.odometry import OdometrySettings, StereoOdometry

REFERENCE_CENTRE_PX = 0.5  # the AprilTag reference detector calls the centre of the top left pixel (0.5, 0.5)
MATCH_PX = 4.0  # between the middles of a find and a listed tag
GROSS_PX = 2.0  # a corner farther off is another corner, not a badly measured one
NANOSECONDS = 1e9


class EvidenceError(VisionError):
    """A truth or calibration text that does not hold what it should."""


def find_all_markers(
    image: Image, dictionary: "cv2.aruco.Dictionary", perimeter_min_px: float = 20.0
) -> tuple[FoundMarker, ...]:
    """As `find_markers`, slow and thorough: more thresholds, and a second pass at twice the size for cells of 2 px."""
    if min(image.shape) < IMAGE_SIDE_MIN_PX:
        return ()
    thorough = search_parameters(2 * max(image.shape), perimeter_min_px)
    thorough.adaptiveThreshWinSizeStep = 4
    thorough.adaptiveThreshWinSizeMax = 43
    thorough.perspectiveRemovePixelPerCell = 8
    doubled = np.asarray(cv2.resize(image, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
    found = [
        FoundMarker(marker.marker_id, (marker.corners_px + 0.5) / 2.0 - 0.5)  # resize keeps outer edges, not centres
        for marker in detect_markers(doubled, dictionary, thorough)
    ]
    for marker in detect_markers(image, dictionary, thorough):
        if not any(same_place(marker, other) for other in found):
            found.append(marker)
    return tuple(found)


@dataclass(frozen=True, slots=True)
class TagTruth:
    """Listed tags: ids and corners (4, 2) [px, OpenCV's pixel centres]."""

    ids: tuple[int, ...]
    corners_px: Array


@dataclass(frozen=True, slots=True)
class TagFigures:
    """Marker search against a list. Corner errors per coordinate [px], over matched tags without gross differences."""

    n_listed: int
    n_matched: int
    n_unlisted: int  # a listed id at a place the list lacks
    n_false: int  # an id that the list does not know at all
    corner_rms_px: float
    corner_median_px: float
    contour_rms_px: float  # the same tags and corners before refinement
    n_gross: int  # matched tags with a corner more than 2 px off

    @property
    def recall(self) -> float:
        """Share of the listed tags that were found, 0..1."""
        return self.n_matched / max(self.n_listed, 1)


@dataclass(frozen=True, slots=True)
class GridFigures:
    """Marker search on a grid of ids 0..n-1."""

    n_expected: int
    n_found: int
    n_repeated: int
    n_false: int
    n_clean_sides: int


@dataclass(frozen=True, slots=True)
class OdometryFigures:
    """Odometry against recorded poses."""

    n_frames: int
    n_ok: int
    path_length_m: float
    rotation_mean_deg: float  # per frame
    rotation_max_deg: float
    rotation_total_deg: float  # last frame against the first
    time_median_ms: float
    time_p99_ms: float


def parse_tag_truth(text: str) -> TagTruth:
    """Truth of one photograph: lines `id, (x y), (x y), (x y), (x y)` of the reference detector.

    Raises: EvidenceError naming the line that is none.
    """
    ids, corners = [], []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        values = re.findall(r"-?\d+(?:\.\d+)?", line)
        if len(values) != 9:
            raise EvidenceError(
                f"truth line {number} has {len(values)} numbers; give an id and four corners (9 numbers)"
            )
        ids.append(int(values[0]))
        corners.append(np.array(values[1:], dtype=float).reshape(4, 2) - REFERENCE_CENTRE_PX)
    return TagTruth(tuple(ids), np.array(corners).reshape(-1, 4, 2))


def corner_differences(found_px: Array, listed_px: Array) -> Array:
    """Differences (4, 2) under the corner order (start and sense) that fits best: detectors differ in it."""
    orders = [np.roll(found_px, shift, axis=0)[::sense] for shift in range(4) for sense in (1, -1)]
    return min((order - listed_px for order in orders), key=lambda difference: float((difference**2).sum()))


def tag_figures(image: Image, truth: TagTruth, dictionary_name: str = "DICT_APRILTAG_36h11") -> TagFigures:
    """Recall and corner errors of the thorough search on one photograph (h, w)."""
    dictionary = dictionary_by_name(dictionary_name)
    contours = find_all_markers(image, dictionary)
    finds = [refined_marker(marker, image, dictionary, None) for marker in contours]
    pairs = _matches(contours, truth)
    fine = np.array([corner_differences(finds[k].corners_px, truth.corners_px[i]) for i, k in pairs]).reshape(-1, 4, 2)
    raw = np.array([corner_differences(contours[k].corners_px, truth.corners_px[i]) for i, k in pairs]).reshape(
        -1, 4, 2
    )
    gross = np.abs(fine).max(axis=(1, 2), initial=0.0) > GROSS_PX
    n_false = sum(marker.marker_id not in truth.ids for marker in contours)
    return TagFigures(
        n_listed=len(truth.ids),
        n_matched=len(pairs),
        n_unlisted=len(contours) - len(pairs) - n_false,
        n_false=n_false,
        corner_rms_px=_rms(fine[~gross]),
        corner_median_px=float(np.median(np.abs(fine))) if len(fine) else float("nan"),
        contour_rms_px=_rms(raw[~gross]),
        n_gross=int(gross.sum()),
    )


def _matches(found: Sequence[FoundMarker], truth: TagTruth) -> list[tuple[int, int]]:
    """(listed, found) indices, each used once, nearest first."""
    candidates = []
    for i, (marker_id, corners) in enumerate(zip(truth.ids, truth.corners_px, strict=True)):
        for k, marker in enumerate(found):
            apart = float(np.linalg.norm(marker.corners_px.mean(axis=0) - corners.mean(axis=0)))
            if marker.marker_id == marker_id and apart < MATCH_PX:
                candidates.append((apart, i, k))
    pairs: list[tuple[int, int]] = []
    for _, i, k in sorted(candidates):
        if all(i != other_i and k != other_k for other_i, other_k in pairs):
            pairs.append((i, k))
    return pairs


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def grid_figures(image: Image, n_expected: int, dictionary_name: str = "DICT_6X6_1000") -> GridFigures:
    """How many of a grid's markers one photograph (h, w) yields."""
    dictionary = dictionary_by_name(dictionary_name)
    found = find_markers(image, dictionary, perimeter_min_px=max(32.0, 0.015 * max(image.shape)))
    ids = [marker.marker_id for marker in found]
    expected = set(range(n_expected))
    clean = sum(refined_marker(marker, image, dictionary, None).side_fit is SideFit.CLEAN for marker in found)
    return GridFigures(
        n_expected=n_expected,
        n_found=len(expected & set(ids)),
        n_repeated=len(ids) - len(set(ids)),
        n_false=len(set(ids) - expected),
        n_clean_sides=clean,
    )


def rectified_camera(calibration_text: str, width_px: int, height_px: int) -> StereoCamera:
    """Camera of a rectified pair from its two 3x4 projection matrices, row by row (KITTI's P0 and P1).

    Raises: EvidenceError when the text does not hold 24 numbers.
    """
    values = np.array(re.findall(r"-?\d+\.?\d*(?:[eE][-+]?\d+)?", calibration_text), dtype=float)
    if values.size != 24:
        raise EvidenceError(f"calibration has {values.size} numbers; give two 3x4 projection matrices (24 numbers)")
    left, right = values.reshape(2, 3, 4)
    return StereoCamera(
        width_px=width_px,
        height_px=height_px,
        fx_px=left[0, 0],
        fy_px=left[1, 1],
        cx_px=left[0, 2],
        cy_px=left[1, 2],
        distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
        baseline_m=-right[0, 3] / right[0, 0],
        rate_hz=10.0,
        rectified=True,
    )


def parse_poses(text: str) -> Array:
    """Rotations (n, 3, 3) of a poses file with 12 numbers a line, brought back onto SO(3)."""
    return np.array([nearest_rotation(pose[:, :3]) for pose in _pose_rows(text)])


def path_length(text: str) -> float:
    """Way [m] through the positions of a poses file with 12 numbers a line."""
    return float(np.linalg.norm(np.diff(_pose_rows(text)[:, :, 3], axis=0), axis=1).sum())


def _pose_rows(text: str) -> Array:
    rows = np.array([[float(value) for value in line.split()] for line in text.splitlines() if line.strip()])
    return rows.reshape(-1, 3, 4)


def odometry_figures(
    camera: StereoCamera,
    pairs: Iterable[tuple[Image, Image]],
    rotations_truth: Array,
    settings: OdometrySettings | None = None,
    clock: Callable[[], float] = perf_counter,
) -> OdometryFigures:
    """Odometry over a sequence of pairs against the rotations of its truth (n, 3, 3); positions are not judged."""
    odometry = StereoOdometry(camera, settings)
    poses, statuses, times_ms = [], [], []
    for number, (left, right) in enumerate(pairs):
        started = clock()
        found = odometry.process(left, right, round(number / camera.rate_hz * NANOSECONDS))
        times_ms.append((clock() - started) * 1e3)
        poses.append(found.T_vo_cam)
        statuses.append(found.status)
    Ts = np.array(poses)
    truth = rotations_truth[: len(Ts)]
    steps_deg = [
        np.rad2deg(geodesic_angle(truth[i].T @ truth[i + 1], Ts[i, :3, :3].T @ Ts[i + 1, :3, :3]))
        for i in range(len(Ts) - 1)
    ]
    total = geodesic_angle(truth[0].T @ truth[-1], Ts[0, :3, :3].T @ Ts[-1, :3, :3])
    return OdometryFigures(
        n_frames=len(Ts),
        n_ok=sum(status is OdometryStatus.OK for status in statuses),
        path_length_m=float(np.linalg.norm(np.diff(Ts[:, :3, 3], axis=0), axis=1).sum()),
        rotation_mean_deg=float(np.mean(steps_deg)),
        rotation_max_deg=float(np.max(steps_deg)),
        rotation_total_deg=float(np.rad2deg(total)),
        time_median_ms=float(np.median(times_ms)),
        time_p99_ms=float(np.percentile(times_ms, 99)),
    )
