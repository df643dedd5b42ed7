"""`longreach bench vision-real`: the detector and the odometry on images that nobody rendered."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.vision.evidence import (
    grid_figures,
    odometry_figures,
    parse_poses,
    parse_tag_truth,
    path_length,
    rectified_camera,
    tag_figures,
)
from machine.description import StereoCamera
from server.camera.sources.folder import natural_order
from server.vision.contracts import Image


def bench_vision_real(data: Path, console: Console) -> None:
    """Print recall and corner errors on photographs, rotation and length on the KITTI clip; what is absent is said."""
    _tags(data / "markers" / "apriltag_photos", console)
    _grid(data / "markers" / "aruco_photos" / "aruco_grid_iphone.jpg", console)
    _kitti(data / "stereo" / "kitti_clip", console)


def _grey(path: Path) -> Image:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise FileNotFoundError(f"{path} is not an image that OpenCV reads")
    return np.asarray(image, dtype=np.uint8)


def _tags(folder: Path, console: Console) -> None:
    photographs = sorted(folder.glob("*.jpg"))
    if not photographs:
        console.print(f"no photographs in {folder}: skipped")
        return
    table = Table(title="AprilTag photographs", title_justify="left")
    for heading in ("photograph", "listed", "found", "recall", "corner RMS px", "median px", "gross", "false ids"):
        table.add_column(heading)
    for path in photographs:
        found = tag_figures(_grey(path), parse_tag_truth(path.with_suffix(".txt").read_text(encoding="utf-8")))
        table.add_row(
            path.name[:18],
            str(found.n_listed),
            str(found.n_matched),
            f"{found.recall:.3f}",
            f"{found.corner_rms_px:.2f}",
            f"{found.corner_median_px:.2f}",
            str(found.n_gross),
            str(found.n_false),
        )
    console.print(table)


def _grid(path: Path, console: Console) -> None:
    if not path.is_file():
        console.print(f"no {path}: skipped")
        return
    found = grid_figures(_grey(path), 400)
    console.print(
        f"ArUco phone photograph: {found.n_found} of {found.n_expected} markers of the grid, "
        f"{found.n_false} false, {found.n_repeated} repeated"
    )


def _kitti(folder: Path, console: Console) -> None:
    if not folder.is_dir():
        console.print(f"no {folder}: skipped")
        return
    if next(kitti_pairs(folder), None) is None:
        console.print(f"no pictures in {folder / 'image_l'}: skipped")
        return
    camera, text = kitti_camera(folder), (folder / "poses.txt").read_text(encoding="utf-8")
    found, recorded_m = odometry_figures(camera, kitti_pairs(folder), parse_poses(text)), path_length(text)
    off_pct = 100.0 * (found.path_length_m / recorded_m - 1.0)
    console.print(
        f"KITTI clip, {camera.width_px} x {camera.height_px} px: {found.n_ok} of {found.n_frames} frames OK, rotation "
        f"error {found.rotation_mean_deg:.3f} deg per frame, path {found.path_length_m:.2f} m ({off_pct:+.2f} % of the "
        f"recorded poses' {recorded_m:.2f} m; by GPS, which is no truth of translation over so short a way)"
    )


def kitti_camera(folder: Path) -> StereoCamera:
    """The clip's rectified camera, its size as its pictures say."""
    height_px, width_px = next(kitti_pairs(folder))[0].shape
    return rectified_camera((folder / "calib.txt").read_text(encoding="utf-8"), width_px, height_px)


def kitti_pairs(folder: Path) -> Iterator[tuple[Image, Image]]:
    """The rectified grey pairs of the clip in order."""
    for left in map(Path, natural_order(str(file) for file in (folder / "image_l").glob("*.png"))):
        yield _grey(left), _grey(folder / "image_r" / left.name)
