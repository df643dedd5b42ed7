"""Stereo pairs for teaching: stored ones from a folder, or live ones from the camera until enough are kept."""

import re
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from machine.description import StereoCamera
from machine.rotations import Array
from server.camera.contracts import StereoSource
from server.camera.errors import CameraError
from server.camera.sources.folder import natural_order, paired_names, read_grey
from server.errors import ServerError
from server.vision.contracts import Image
from server.vision.errors import VisionError
from server.vision.marker_search import dictionary_by_name
from server.vision.teach_contracts import TeachSettings, TeachView
from server.vision.teach_views import OfferedView, ViewKeeper, teach_view

IMAGE_FILE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm"}
STEREO_FOLDER_NAMES = (
    ("left", "right"),
    ("image_l", "image_r"),
    ("cam0/data", "cam1/data"),
    ("mav0/cam0/data", "mav0/cam1/data"),
)
READ_TIMEOUT_S = 0.5
FIRST_IMAGE_TIMEOUT_S = 30.0  # a camera that is there has sent one by then


class TargetError(ServerError):
    """Images or options that teaching cannot use."""


@dataclass(frozen=True, slots=True)
class MarkerSearch:
    """What is looked for in every pair."""

    camera: StereoCamera
    dictionary: "cv2.aruco.Dictionary"
    marker_ids: tuple[int, ...]

    def view_of(self, left: Image, right: Image) -> TeachView:
        """The markers of one pair. Raises: TargetError: the pictures have not the camera's size."""
        size = (self.camera.height_px, self.camera.width_px)
        if left.shape != size or right.shape != size:
            raise TargetError(
                f"pictures of {left.shape[1]} x {left.shape[0]} px, but the machine file's camera has {size[1]} x "
                f"{size[0]} px; give pictures as the camera made them"
            )
        return teach_view(left, right, self.dictionary, self.marker_ids, self.camera)


def stored_pairs(folder: Path) -> list[tuple[Path, Path | None]]:
    """Left and right files of equal name, in natural order; the right one is None where a file holds both eyes.

    Raises: TargetError: nothing there that could be stereo pairs.
    """
    for left_name, right_name in STEREO_FOLDER_NAMES:
        lefts, rights = _by_name(folder / left_name), _by_name(folder / right_name)
        if not lefts:
            continue
        try:
            names = paired_names(lefts, rights, (f"in {left_name}", f"in {right_name}"))
        except CameraError as error:
            raise TargetError(f"{folder}: {error}") from error
        return [(Path(lefts[name]), Path(rights[name])) for name in names]
    files = _picture_paths(folder)
    lefts = [path for path in files if path.stem.lower().endswith("left")]
    if lefts:
        return [(path, _right_eye_picture(path)) for path in lefts]
    if files:
        return [(path, None) for path in files]
    names = ", ".join(f"{left} and {right}" for left, right in STEREO_FOLDER_NAMES)
    raise TargetError(
        f"{folder}: no stereo pairs; give a folder with {names}, *left and *right, or side by side pictures"
    )


def _picture_paths(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    names = [path.name for path in folder.iterdir() if path.suffix.lower() in IMAGE_FILE_SUFFIXES and path.is_file()]
    return [folder / name for name in natural_order(names)]


def _by_name(folder: Path) -> dict[str, str]:
    """Name -> file; the name is without the ending and without the word left or right.

    Raises: TargetError: two pictures of one name.
    """
    found: dict[str, str] = {}
    for path in _picture_paths(folder):
        name = re.sub("(?i)left|right", "", path.stem)
        if name in found:
            raise TargetError(f"'{found[name]}' and '{path}' have one name; take one of them away")
        found[name] = str(path)
    return found


def _right_eye_picture(left: Path) -> Path:
    stem = left.stem
    ending = "RIGHT" if stem.endswith("LEFT") else "Right" if stem.endswith("Left") else "right"
    right = left.with_name(stem[:-4] + ending + left.suffix)
    if not right.is_file():
        raise TargetError(f"{left}: its right eye {right.name} is missing")
    return right


def read_pair(left: Path, right: Path | None) -> tuple[Image, Image]:
    """Grey pictures of one stored pair.

    Raises: TargetError: a file that is not a picture, or a side-by-side picture of odd width.
    """
    if right is not None:
        return _read_grey_picture(left), _read_grey_picture(right)
    both = _read_grey_picture(left)
    half = both.shape[1] // 2
    if both.shape[1] % 2:
        raise TargetError(f"{left}: width {both.shape[1]} px is odd; two equal eyes need an even width")
    return both[:, :half], both[:, half:]


def _read_grey_picture(path: Path) -> Image:
    try:
        return read_grey(str(path))
    except CameraError as error:
        raise TargetError(f"{path} is not a picture that can be read; give PNG or JPEG ({error})") from error


def stored_views(
    pairs: Sequence[tuple[Path, Path | None]], search: MarkerSearch, n_max: int
) -> Iterator[tuple[str, TeachView]]:
    """Name and markers of the stored pairs, thinned out evenly to at most `n_max`."""
    chosen = np.unique(np.linspace(0, len(pairs) - 1, min(n_max, len(pairs))).round().astype(int))
    for k in chosen:
        left, right = pairs[k]
        yield left.stem, search.view_of(*read_pair(left, right))


def live_views(
    source: StereoSource,
    search: MarkerSearch,
    settings: TeachSettings,
    n_views: int,
    timeout_s: float,
    report: Callable[[OfferedView, TeachView, list[TeachView]], None],
) -> list[TeachView]:
    """Views kept from a live camera, until there are enough, time is up, the source ends, or Ctrl-C.

    `report` gets the outcome of every pair.
    Raises: TargetError: no picture at all within half a minute, or within the time.
    """
    keeper = ViewKeeper(search.camera, settings)
    begun_s, first_s, any_pair = time.monotonic(), min(timeout_s, FIRST_IMAGE_TIMEOUT_S), False
    try:
        while len(keeper.views) < n_views and not source.ended:
            if time.monotonic() >= begun_s + (timeout_s if any_pair else first_s):
                break
            frame = source.read(READ_TIMEOUT_S)
            if frame is None:
                continue
            any_pair = True
            view = search.view_of(frame.left, frame.right)
            report(keeper.keep_if_new(view), view, keeper.views)
    except KeyboardInterrupt:  # enough, says the operator
        any_pair = True
    if not any_pair:
        raise TargetError(f"no image within {first_s:g} s; {source.state or 'check the camera'}")
    return keeper.views


def charuco_board(
    squares: str, square_mm: float, marker_mm: float, name: str, legacy: bool
) -> "cv2.aruco.CharucoBoard":
    """The board described by the command line. Raises: TargetError: not a board."""
    across, _, down = squares.partition("x")
    if not (across.isdigit() and down.isdigit() and int(across) >= 3 and int(down) >= 3):
        raise TargetError(f"--squares {squares!r} is not ACROSSxDOWN, such as 11x8, of 3 and more")
    if not marker_mm < square_mm:
        raise TargetError(f"--marker-mm {marker_mm:g} must be below --square-mm {square_mm:g}")
    try:
        known = dictionary_by_name(name)
    except VisionError as error:
        raise TargetError(str(error)) from error
    board = cv2.aruco.CharucoBoard((int(across), int(down)), 1e-3 * square_mm, 1e-3 * marker_mm, known)
    board.setLegacyPattern(legacy)
    return board


Seen = tuple[Array, Array]


def charuco_corners(detector: "cv2.aruco.CharucoDetector", points: Array, image: Image) -> Seen | None:
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
