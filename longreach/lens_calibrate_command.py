"""`longreach camera calibrate`: the lens of one eye or a stereo rig from pictures of a ChArUco board."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
import yaml
from rich.console import Console
from rich.markup import escape
from rich.progress import track
from rich.table import Column, Table

from machine.rotations import Array, rotation_from_rotvec
from recording.files import write_durably
from server.calibration.lens_fit import BoardView, Coverage, LensFit, LensFitError, coverage_of, fit_lens
from server.camera.rectification_zed import SECTION_SUFFIX_BY_SIZE
from server.camera.target_pictures import (
    IMAGE_FILE_SUFFIXES,
    TargetError,
    charuco_board,
    charuco_corners,
    grey_picture,
    read_pair,
    stored_pairs,
)

# A calibrated lens or rig in the formats of others: ROS camera_info, OpenCV, Kalibr, and ZED's conf.

CAMERA_NAMES_BY_EYE_COUNT = {1: ("camera",), 2: ("left", "right")}


def write_lens(fit: LensFit, folder: Path) -> tuple[list[Path], list[str]]:
    """Write all forms that can hold it; the files, and why another is not written. Raises: OSError."""
    texts = {
        f"{name}.yaml": camera_info(fit, eye)
        for eye, name in enumerate(CAMERA_NAMES_BY_EYE_COUNT[len(fit.lens_parameters)])
    }
    texts |= {"kalibr.yaml": kalibr_camchain(fit), "opencv.yaml": opencv_yaml(fit)}
    notes = []
    if fit.rig_parameters is None:
        notes.append("no ZED conf: it is of two eyes")
    elif fit.size_px not in SECTION_SUFFIX_BY_SIZE:
        sizes = ", ".join(f"{width} x {height}" for width, height in SECTION_SUFFIX_BY_SIZE)
        notes.append(f"no ZED conf: it knows {sizes} px an eye only")
    else:
        texts["zed.conf"] = zed_conf(fit)
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        write_durably(folder / name, text)
    return [folder / name for name in texts], notes


def _camera_matrix(fit: LensFit, eye: int) -> Array:
    fx, fy, cx, cy = fit.lens_parameters[eye, :4]
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _left_to_right_transform(fit: LensFit) -> tuple[Array, Array]:
    """R and t [m] that take the left eye's points to the right one's."""
    assert fit.rig_parameters is not None  # two eyes
    return rotation_from_rotvec(fit.rig_parameters[:3]), fit.rig_parameters[3:]


def _rectification_per_eye(fit: LensFit) -> list[tuple[Array, Array]]:
    """Rectification and projection of each eye."""
    if fit.rig_parameters is None:
        return [(np.eye(3), np.hstack([_camera_matrix(fit, 0), np.zeros((3, 1))]))]
    R, t = _left_to_right_transform(fit)
    lenses = [(_camera_matrix(fit, eye), fit.lens_parameters[eye, 4:].copy()) for eye in (0, 1)]
    R1, R2, P1, P2 = cv2.stereoRectify(*lenses[0], *lenses[1], fit.size_px, R, t[:, None], alpha=0.0)[:4]
    return [(np.asarray(R1, float), np.asarray(P1, float)), (np.asarray(R2, float), np.asarray(P2, float))]


def camera_info(fit: LensFit, eye: int) -> str:
    """sensor_msgs/CameraInfo in YAML, as ROS's camera_info_manager reads it."""
    R, P = _rectification_per_eye(fit)[eye]
    body = {
        "image_width": fit.size_px[0],
        "image_height": fit.size_px[1],
        "camera_name": CAMERA_NAMES_BY_EYE_COUNT[len(fit.lens_parameters)][eye],
        "camera_matrix": _matrix_data(_camera_matrix(fit, eye)),
        "distortion_model": "plumb_bob",
        "distortion_coefficients": _matrix_data(fit.lens_parameters[eye, None, 4:]),
        "rectification_matrix": _matrix_data(R),
        "projection_matrix": _matrix_data(P),
    }
    return yaml.safe_dump(body, sort_keys=False, default_flow_style=None)


def _matrix_data(values: Array) -> dict[str, object]:
    rows, cols = values.shape
    return {"rows": rows, "cols": cols, "data": values.ravel().tolist()}


def opencv_yaml(fit: LensFit) -> str:
    """OpenCV's stereo YAML, with the names of its samples."""
    if fit.rig_parameters is None:
        return _file_storage(
            {"camera_matrix": _camera_matrix(fit, 0), "distortion_coefficients": fit.lens_parameters[:1, 4:]}, fit
        )
    R, t = _left_to_right_transform(fit)
    matrices = {
        "K1": _camera_matrix(fit, 0),
        "D1": fit.lens_parameters[:1, 4:],
        "K2": _camera_matrix(fit, 1),
        "D2": fit.lens_parameters[1:, 4:],
    }
    return _file_storage(matrices | {"R": R, "T": t[:, None]}, fit)


def _file_storage(matrices: dict[str, Array], fit: LensFit) -> str:
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML)
    storage.write("image_width", fit.size_px[0])
    storage.write("image_height", fit.size_px[1])
    for name, values in matrices.items():
        storage.write(name, np.ascontiguousarray(values))
    return storage.releaseAndGetString()


def kalibr_camchain(fit: LensFit) -> str:
    """Kalibr's camchain; it has four coefficients, so a k3 that matters is lost, and that is said in the file."""
    body: dict[str, object] = {}
    for eye in range(len(fit.lens_parameters)):
        camera: dict[str, object] = {
            "camera_model": "pinhole",
            "intrinsics": fit.lens_parameters[eye, :4].tolist(),
            "distortion_model": "radtan",
            "distortion_coeffs": fit.lens_parameters[eye, 4:8].tolist(),
            "resolution": list(fit.size_px),
            "rostopic": f"/cam{eye}/image_raw",
        }
        if eye == 1:
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = _left_to_right_transform(fit)
            camera["T_cn_cnm1"] = T.tolist()
        body[f"cam{eye}"] = camera
    lost = ", ".join(f"{value:.6g}" for value in fit.lens_parameters[:, 8])
    return f"# radtan has no k3; left out: {lost}\n" + yaml.safe_dump(body, sort_keys=False, default_flow_style=None)


def zed_conf(fit: LensFit) -> str:
    """ZED's conf at this image size."""
    ending = SECTION_SUFFIX_BY_SIZE[fit.size_px]
    lines = []
    for eye, side in enumerate(("LEFT", "RIGHT")):
        fx, fy, cx, cy, k1, k2, p1, p2, k3 = fit.lens_parameters[eye].tolist()
        lines += [f"[{side}_CAM_{ending}]", f"fx={fx!r}", f"fy={fy!r}", f"cx={cx!r}", f"cy={cy!r}"]
        lines += [f"k1={k1!r}", f"k2={k2!r}", f"p1={p1!r}", f"p2={p2!r}", f"k3={k3!r}", ""]
    assert fit.rig_parameters is not None  # the caller asked
    rx, ry, rz = fit.rig_parameters[:3].tolist()
    baseline, ty, tz = (-1e3 * fit.rig_parameters[3:]).tolist()
    lines += ["[STEREO]", f"Baseline={baseline!r}", f"TY={ty!r}", f"TZ={tz!r}"]
    lines += [f"RX_{ending}={rx!r}", f"CV_{ending}={ry!r}", f"RZ_{ending}={rz!r}", ""]
    return "\n".join(lines)


COVERAGE_CHARACTERS = " .:*#"


def calibrate(
    folder: Annotated[Path, typer.Argument(help="pictures of the board: stereo pairs, or with --mono of one eye")],
    squares: Annotated[str, typer.Option(help="the board's squares across and down, such as 11x8")],
    square_mm: Annotated[float, typer.Option(min=1.0, max=2000.0, help="side of a square [mm], measured on the print")],
    marker_mm: Annotated[float, typer.Option(min=1.0, max=2000.0, help="side of a marker [mm]")],
    dictionary: Annotated[str, typer.Option(help="the markers' dictionary")] = "DICT_5X5_100",
    legacy_pattern: Annotated[bool, typer.Option(help="a board printed with OpenCV before 4.6")] = False,
    mono: Annotated[bool, typer.Option("--mono", help="one eye")] = False,
    out: Annotated[Path | None, typer.Option("--out", help="folder for ROS, OpenCV, Kalibr and ZED files")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="write the full result here (JSON)")] = None,
) -> None:
    """Calibrate lens and stereo rig: intrinsics with sigmas, coverage, what to photograph next. Exit code 1: failed."""
    screen = Console()
    views, size = board_views(
        _picture_pairs(folder, mono), mono, charuco_board(squares, square_mm, marker_mm, dictionary, legacy_pattern)
    )
    try:
        fit = fit_lens(views, size)
    except LensFitError as error:
        screen.print(f"[bold red]not calibrated[/]: {escape(str(error))}", soft_wrap=True)
        raise typer.Exit(1) from error
    covered = coverage_of(views, fit)
    _show_lens_fit(fit, covered, screen)
    try:
        if json_file is not None:
            write_durably(json_file, json.dumps(_lens_fit_json(fit, covered), indent=1) + "\n")
        if out is not None:
            written, notes = write_lens(fit, out)
            screen.print("written: " + escape(", ".join(str(path) for path in written)), soft_wrap=True)
            for note in notes:
                screen.print(escape(note), soft_wrap=True)
    except OSError as error:
        raise TargetError(f"{error.filename} cannot be written: {error.strerror}") from error


def _picture_pairs(folder: Path, mono: bool) -> list[tuple[Path, Path | None]]:
    if not mono:
        return stored_pairs(folder)
    files = (
        sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_FILE_SUFFIXES)
        if folder.is_dir()
        else []
    )
    if not files:
        raise TargetError(f"{folder}: no pictures; give a folder of PNG or JPEG")
    return [(path, None) for path in files]


def board_views(
    files: Sequence[tuple[Path, Path | None]], mono: bool, board: "cv2.aruco.CharucoBoard"
) -> tuple[list[BoardView], tuple[int, int]]:
    """The corners in every picture, and the size of one eye's [px].

    Raises: TargetError: no picture, or pictures of several sizes.
    """
    detector = cv2.aruco.CharucoDetector(board)
    points = np.asarray(board.getChessboardCorners(), dtype=float)
    views, sizes = [], set[tuple[int, int]]()
    for left, right in track(files, "looking for the board", console=Console(stderr=True), transient=True):
        images = (grey_picture(left),) if mono else read_pair(left, right)
        sizes |= {(image.shape[1], image.shape[0]) for image in images}
        eyes = [charuco_corners(detector, points, image) for image in images]
        views.append(BoardView(left.stem, tuple(eyes)))
    if len(sizes) != 1:
        raise TargetError(f"pictures of several sizes {sorted(sizes)}; give those of one setting of the camera")
    return views, sizes.pop()


def _show_lens_fit(fit: LensFit, covered: Coverage, screen: Console) -> None:
    sigmas = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    table = Table("what", Column("value", justify="right"), Column("sigma", justify="right"))
    for name, value, sigma in zip(fit.covariance_names, fit.values, sigmas, strict=True):
        table.add_row(name, f"{value:.6g}", f"{sigma:.2g}")
    screen.print(table)
    screen.print(f"{len(fit.used_views)} views, rms {fit.rms_px:.3f} px a coordinate")
    for name, why in fit.dropped_views:
        screen.print(f"[yellow]left out[/] {escape(name)}: {escape(why)}", soft_wrap=True)
    most = max(int(covered.corner_counts.max()), 1)
    for eye, counts in enumerate(covered.corner_counts):
        screen.print(f"corners in the picture of eye {eye + 1} (blank: none)")
        for row in counts:
            screen.print(
                escape("|" + "".join(3 * COVERAGE_CHARACTERS[min(4, -(-4 * int(n) // most))] for n in row) + "|")
            )
    for text in covered.advice:
        screen.print(f"[yellow]next[/] {escape(text)}", soft_wrap=True)


def _lens_fit_json(fit: LensFit, covered: Coverage) -> dict[str, object]:
    sigmas = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    return {
        "size_px": list(fit.size_px),
        "values": dict(zip(fit.covariance_names, fit.values.tolist(), strict=True)),
        "sigmas": dict(zip(fit.covariance_names, sigmas.tolist(), strict=True)),
        "covariance": fit.covariance.tolist(),
        "rms_px": fit.rms_px,
        "used": list(fit.used_views),
        "dropped": [list(pair) for pair in fit.dropped_views],
        "coverage": covered.corner_counts.tolist(),
        "next": list(covered.advice),
    }
