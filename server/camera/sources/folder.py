"""Stereo pairs from two sets of image files in name order, as KITTI stores them."""

import glob
import time
from pathlib import Path

from server.camera.contracts import StereoFrame
from server.camera.errors import CameraError, StreamError
from server.camera.sources.pacing import Pacing
from server.camera.sources.settings import FolderSource
from server.camera.sources.side_by_side import decode_grey
from server.vision.contracts import Image

STAMP_DIGITS = 16  # a name with at least this many digits is a stamp in ns, not a number


class FolderStereoSource:
    """Pairs in name order, played once at the given rate."""

    def __init__(self, settings: FolderSource) -> None:
        self._lefts = sorted(glob.glob(settings.left_glob))
        self._rights = sorted(glob.glob(settings.right_glob))
        if not self._lefts or len(self._lefts) != len(self._rights):
            raise CameraError(
                f"image folder: {len(self._lefts)} left files by '{settings.left_glob}' and {len(self._rights)} right "
                f"files by '{settings.right_glob}'; both must be equal and above 0"
            )
        self._pacing = Pacing(settings.rate_hz)
        self._period_ns = int(1e9 / settings.rate_hz)
        self._number = 0
        self.skipped = 0
        self.state = ""

    @property
    def ended(self) -> bool:
        """Whether the last pair has been given out."""
        return self._number >= len(self._lefts)

    def read(self, timeout_s: float) -> StereoFrame | None:
        """The next pair, when it is due."""
        if self.ended or not self._pacing.wait(timeout_s):
            return None
        left_file, right_file = self._lefts[self._number], self._rights[self._number]
        self._number += 1
        self.state = f"image folder: end after {self._number} pairs" if self.ended else ""
        try:
            left, right = read_grey(left_file), read_grey(right_file)
        except CameraError as error:
            self.skipped, self.state = self.skipped + 1, str(error)
            return None
        stem = Path(left_file).stem
        stamped = stem.isdigit() and len(stem) >= STAMP_DIGITS
        t_exposure_ns = int(stem) if stamped else (self._number - 1) * self._period_ns
        return StereoFrame(left, right, t_exposure_ns, time.monotonic_ns(), self._number)

    def close(self) -> None:
        """Nothing to let go of."""


def read_grey(path: str) -> Image:
    """A picture file in grey (h, w).

    Raises: CameraError: it cannot be read, or its data are damaged.
    """
    try:
        return decode_grey(Path(path).read_bytes())
    except (OSError, StreamError) as error:
        raise CameraError(f"image file '{path}' cannot be read; give whole PNG or JPEG files ({error})") from error
