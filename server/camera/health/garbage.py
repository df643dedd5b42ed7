"""Pictures that are no pictures: of another size than the camera file says, or what a decoder made of broken data."""

import numpy as np
from numba import njit

from machine.description import StereoCamera
from server.camera.contracts import StereoFrame
from server.camera.health.findings import FaultCode, Finding, Pair
from server.camera.health.thumbnail import CHANGE, IMAGE_SIDE_MIN_PX
from server.vision.contracts import Array

UNIFORM_ROWS_MIN = 2  # of 90: a decoder fills what is missing with one grey
STEP_MIN_GREY, STEP_MIN_RATIO = 5.0, 1.6  # of the mean step from a thumbnail row to the next
STEP_NEIGHBOUR_ROWS = 3  # a horizontal edge of the scene moves by no more from pair to pair (24 px)
BREAK_MIN_GREY, BREAK_RATIO = 10.0, 2.5
# A step that stays this long in a picture that keeps still is something in front of the camera
PERSISTENT_STEP_PAIRS = 150


def wrong_size(frame: StereoFrame, camera: StereoCamera | None) -> tuple[Finding, ...]:
    """Both eyes grey, of one size, and of the camera file's where one is given."""
    for name, image in (("left", frame.left), ("right", frame.right)):
        if image.ndim != 2 or image.dtype != np.uint8 or min(image.shape) < IMAGE_SIDE_MIN_PX:
            text = f"{name} image is {image.shape} {image.dtype}, not a grey 8-bit picture; check the camera source"
            return (Finding(FaultCode.WRONG_SIZE, text),)
    left, right = ((image.shape[1], image.shape[0]) for image in (frame.left, frame.right))
    wanted = left if camera is None else (camera.width_px, camera.height_px)
    if left == right == wanted:
        return ()
    text = (
        f"images are {left[0]} x {left[1]} px and {right[0]} x {right[1]} px; the camera file says {wanted[0]} x "
        f"{wanted[1]} px: set the camera's resolution, or load its file for this one"
    )
    return (Finding(FaultCode.WRONG_SIZE, text),)


class GarbageMonitor:
    """Data that broke off or went astray: from some row on the picture is another one, down to its end.

    Such a picture shows a step between two rows that no picture before it had there; and below the step everything has
    changed since the last good picture, above it no more than motion changes. Only `keep_as_reference` makes a picture
    a good one: after a black or a blurred one every edge would be new.
    """

    def __init__(self) -> None:
        self._good: tuple[Array, Array] = np.zeros(0), np.zeros(0)  # steps and bands of the last good picture
        self._now = self._good
        self._still = 0

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """Look for rows of one grey, for a step, and for a break between the rows above and those below."""
        steps = 0.5 * (pair.left_cells.row_steps + pair.right_cells.row_steps)
        bands = np.minimum(
            _band_changes(pair.left_cells.cell_statistics), _band_changes(pair.right_cells.cell_statistics)
        )
        self._now = steps, bands
        text = cut = _one_grey(pair)
        if not text and not pair.is_first and len(self._good[0]) == len(steps):
            row = int(_new_step(steps, self._good[0]))
            if row >= 0:
                text = (
                    f"a step through the picture at {100 * row // len(steps)} % of its height that was not there before"
                )
            elif _has_corrupt_lower_bands(bands, self._good[1]):
                text = "its lower part is another picture than just before, its upper part is not"
        self._still = self._still + 1 if text and not cut and bands.max() < BREAK_MIN_GREY else 0
        if text and self._still < PERSISTENT_STEP_PAIRS:
            return (_garbage_finding(text),)
        self._still = 0
        return ()

    def keep_as_reference(self) -> None:
        """The picture checked last was good in every other way, too: later ones are compared with it."""
        self._good = self._now


def _one_grey(pair: Pair) -> str:
    rows = min(pair.left_cells.one_grey_rows, pair.right_cells.one_grey_rows)
    whole = min(pair.left_cells.grey_thumbnail.shape[0], pair.right_cells.grey_thumbnail.shape[0])
    return f"the last {100 * rows // whole} % of its rows are one grey" if UNIFORM_ROWS_MIN <= rows < whole else ""


@njit(cache=True, nogil=True)
def _new_step(steps: Array, before: Array) -> int:
    """The row of a step that stands out, here and against the last good picture; -1 for none."""
    usual = np.sort(steps)[len(steps) // 2]
    for i in range(1, len(steps) - 1):
        low, high = max(i - STEP_NEIGHBOUR_ROWS, 0), min(i + STEP_NEIGHBOUR_ROWS + 1, len(steps))
        around = max(before[low:high].max(), max(steps[i - 1], steps[i + 1]))
        if steps[i] > around + STEP_MIN_GREY and steps[i] > STEP_MIN_RATIO * usual and steps[i] > 1.5 * around:
            return i
    return -1


@njit(cache=True, nogil=True)
def _band_changes(cells: Array) -> Array:
    """Median change of each band of rows since the pair before (9,) [grey levels]."""
    out = np.empty(cells.shape[0])
    for p in range(cells.shape[0]):
        out[p] = np.sort(cells[p, :, CHANGE])[cells.shape[1] // 2]
    return out


@njit(cache=True, nogil=True)
def _has_corrupt_lower_bands(bands: Array, before: Array) -> bool:
    """Whether from some band down all changed far more than in the pair before, and those above did not."""
    grown = bands / (before + 1.0)
    for row in range(1, len(bands)):
        below = grown[row:].min()
        if below > BREAK_RATIO * grown[:row].max() and below > BREAK_RATIO and bands[row:].min() > BREAK_MIN_GREY:
            return True
    return False


def _garbage_finding(text: str) -> Finding:
    return Finding(FaultCode.GARBAGE, f"compressed garbage: {text}; check cable, network and the camera's encoder")
