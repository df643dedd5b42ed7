"""Stereo pairs of a data set in EuRoC's layout: mav0/cam0/data.csv names stamps and files, cam1 the other eye's."""

import csv
from pathlib import Path

from recording.files import read_text
from server.camera.errors import CameraError
from server.camera.sources.folder import read_grey
from server.camera.sources.settings import EurocSource
from server.camera.sources.stamped import StampedStereoSource, StoredPair


class EurocStereoSource(StampedStereoSource):
    """Pairs of equal stamp; pictures without the other eye are left out and counted in `skipped`."""

    def __init__(self, settings: EurocSource) -> None:
        root = _root(Path(settings.path))
        lefts, rights = (_listed(root / eye) for eye in ("cam0", "cam1"))
        stamps = sorted(lefts.keys() & rights.keys())
        if not stamps:
            raise CameraError(
                f"data set {root}: no stamp of cam0 ({len(lefts)} pictures) is also in cam1 ({len(rights)}); the eyes "
                "must be synchronised"
            )
        pairs = (_pair(stamp, lefts[stamp], rights[stamp]) for stamp in stamps)
        super().__init__(f"data set {root}", pairs, settings.speed)
        self.skipped = len(lefts) + len(rights) - 2 * len(stamps)


def _pair(stamp_ns: int, left: Path, right: Path) -> StoredPair:
    return StoredPair(stamp_ns, lambda: (read_grey(str(left)), read_grey(str(right))))


def _root(path: Path) -> Path:
    """The folder that holds cam0: the data set's mav0, or the folder given."""
    for root in (path / "mav0", path):
        if (root / "cam0").is_dir():
            return root
    raise CameraError(f"data set {path}: neither mav0/cam0 nor cam0 in it; give the folder that holds mav0")


def _listed(eye: Path) -> dict[int, Path]:
    """Stamp [ns] -> file, of data.csv."""
    listing = eye / "data.csv"
    try:
        text = read_text(listing)
    except OSError as error:
        raise CameraError(f"data set: {listing} cannot be read ({error.strerror}); give a whole data set") from error
    found: dict[int, Path] = {}
    for number, row in enumerate(csv.reader(text.splitlines()), start=1):
        if not row or row[0].lstrip().startswith("#"):
            continue
        if len(row) < 2 or not row[0].strip().isdigit():
            raise CameraError(f"data set: {listing} line {number} is not 'stamp [ns], file name'")
        found[int(row[0])] = eye / "data" / row[1].strip()
    return found
