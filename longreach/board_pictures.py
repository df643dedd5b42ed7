"""Pictures of a ChArUco board: the board in the command line's words, and its corners in a picture."""

from pathlib import Path

import cv2
import numpy as np
import typer

from longreach.target_sources import TargetError
from server.calibration.contracts import Array
from server.camera.errors import CameraError
from server.camera.sources.folder import read_grey
from server.vision.contracts import Image
from server.vision.errors import VisionError
from server.vision.marker_search import dictionary_by_name


def board_of(squares: str, square_mm: float, marker_mm: float, name: str, legacy: bool) -> "cv2.aruco.CharucoBoard":
    """The board described by the command line. Raises: typer.BadParameter: not a board."""
    across, _, down = squares.partition("x")
    if not (across.isdigit() and down.isdigit() and int(across) >= 3 and int(down) >= 3):
        raise typer.BadParameter(f"--squares {squares!r} is not ACROSSxDOWN, such as 11x8, of 3 and more")
    if not marker_mm < square_mm:
        raise typer.BadParameter(f"--marker-mm {marker_mm:g} must be below --square-mm {square_mm:g}")
    try:
        known = dictionary_by_name(name)
    except VisionError as error:
        raise typer.BadParameter(str(error)) from error
    board = cv2.aruco.CharucoBoard((int(across), int(down)), 1e-3 * square_mm, 1e-3 * marker_mm, known)
    board.setLegacyPattern(legacy)
    return board


Seen = tuple[Array, Array]


def corners_of(detector: "cv2.aruco.CharucoDetector", points: Array, image: Image) -> Seen | None:
    """Points (n, 3) [m] and corners (n, 2) [px]."""
    px, ids, _, _ = detector.detectBoard(image)
    if ids is None or len(ids) < 4:
        return None
    return points[np.asarray(ids, dtype=np.int64).ravel()], np.asarray(px, dtype=float).reshape(-1, 2)


def grey_picture(path: Path) -> Image:
    """A stored picture (h, w). Raises: TargetError: it cannot be read."""
    try:
        return read_grey(str(path))
    except CameraError as error:
        raise TargetError(f"{path} is not a picture that can be read; give PNG or JPEG ({error})") from error
