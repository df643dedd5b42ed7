"""Stereo pairs from two sets of image files, paired by name and played in the order of the numbers in their names."""

import csv
import glob
import re
from collections.abc import Iterable
from pathlib import Path

from recording.clock import mono_ns
from recording.files import read_text
from server.camera.contracts import StereoFrame
from server.camera.errors import CameraError, StreamError
from server.camera.sources.settings import EurocSource, FolderSource, StampUnit
from server.camera.sources.side_by_side import decode_grey
from server.camera.sources.stamped import Pacing, StampedStereoSource, StoredPair
from server.vision.contracts import Image

UNITS_NS: dict[StampUnit, int] = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
PLAUSIBLE_UNIX_TIMES_S = range(
    978_307_200, 4_102_444_800
)  # 2001 to 2099: a name is a time where one unit puts it there
TIMESTAMP_DIGITS_MIN = 16  # a longer count of pictures does not exist
WILDCARD_PATTERN = re.compile(r"(\*\*/|\*\*|\*|\?|\[[^\]]+\])")


class EurocStereoSource(StampedStereoSource):
    """Pairs of equal stamp; pictures without the other eye are left out and counted in `skipped`."""

    def __init__(self, settings: EurocSource) -> None:
        root = _dataset_root(Path(settings.path))
        lefts, rights = (_files_by_stamp(root / eye) for eye in ("cam0", "cam1"))
        stamps = sorted(lefts.keys() & rights.keys())
        if not stamps:
            raise CameraError(
                f"data set {root}: no stamp of cam0 ({len(lefts)} pictures) is also in cam1 ({len(rights)}); the eyes "
                "must be synchronised"
            )
        pairs = (_stored_pair(stamp, lefts[stamp], rights[stamp]) for stamp in stamps)
        super().__init__(f"data set {root}", pairs, settings.speed)
        self.skipped = len(lefts) + len(rights) - 2 * len(stamps)


def _stored_pair(stamp_ns: int, left: Path, right: Path) -> StoredPair:
    return StoredPair(stamp_ns, lambda: (read_grey(str(left)), read_grey(str(right))))


def _dataset_root(path: Path) -> Path:
    """The folder that holds cam0: the data set's mav0, or the folder given."""
    for root in (path / "mav0", path):
        if (root / "cam0").is_dir():
            return root
    raise CameraError(f"data set {path}: neither mav0/cam0 nor cam0 in it; give the folder that holds mav0")


def _files_by_stamp(eye: Path) -> dict[int, Path]:
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


class FolderStereoSource:
    """Pairs of equal name, that is what the patterns' wildcards stand for; played once at the given rate."""

    def __init__(self, settings: FolderSource) -> None:
        lefts, rights = _files_by_wildcard_name(settings.left_glob), _files_by_wildcard_name(settings.right_glob)
        by = f"by '{settings.left_glob}'", f"by '{settings.right_glob}'"
        names = paired_names(lefts, rights, by, "; the wildcards must stand for what the names of both eyes share")
        stamps = stamps_ns(names, settings.stamp_unit, settings.rate_hz)
        played = sorted(range(len(names)), key=stamps.__getitem__)  # 9.25 before 9.3, where the names are times
        self._files = [(lefts[names[k]], rights[names[k]]) for k in played]
        self._pacing = Pacing(settings.rate_hz)
        self._stamps_ns = [stamps[k] for k in played]
        self._number = 0
        self.skipped = 0
        self.state = ""

    @property
    def ended(self) -> bool:
        """Whether the last pair has been given out."""
        return self._number >= len(self._files)

    def read(self, timeout_s: float) -> StereoFrame | None:
        """The next pair, when it is due."""
        if self.ended or not self._pacing.wait(timeout_s):
            return None
        (left_file, right_file), t_exposure_ns = self._files[self._number], self._stamps_ns[self._number]
        self._number += 1
        self.state = f"image folder: end after {self._number} pairs" if self.ended else ""
        try:
            left, right = read_grey(left_file), read_grey(right_file)
        except CameraError as error:
            self.skipped, self.state = self.skipped + 1, str(error)
            return None
        return StereoFrame(left, right, t_exposure_ns, mono_ns(), self._number)

    def close(self) -> None:
        """Nothing to let go of."""


def stamps_ns(names: list[str], unit: StampUnit, rate_hz: float) -> list[int]:
    """Stamps [ns] of names in order: times in this unit, or in the one by which all are times of 2001 to 2099.

    Raises: CameraError: times by their setting or length, and not by their digits.
    """
    numbers = [re.split(r"[/\\]", name)[-1] for name in names]
    times = all(re.fullmatch(r"[0-9]+(\.[0-9]+)?", number) for number in numbers)
    if unit == "auto":
        whole = [int(number.split(".")[0]) for number in numbers] if times else [0]
        for unit_ns in UNITS_NS.values():
            if all(number * unit_ns // UNITS_NS["s"] in PLAUSIBLE_UNIX_TIMES_S for number in whole):
                return [_whole_ns(number, unit_ns) for number in numbers]
        unit = "number"
        if times and max(len(number) for number in numbers) >= TIMESTAMP_DIGITS_MIN:
            raise CameraError(
                f"image folder: '{numbers[0]}' is a time by its length, but in no unit one of the years 2001 to 2099; "
                "set [camera] stamp_unit to ns, us, ms or s, or to number"
            )
    if unit == "number":
        return [number * int(1e9 / rate_hz) for number in range(len(names))]
    if not times:
        raise CameraError(f"image folder: stamp_unit = {unit}, but a name is '{numbers[0]}'; set it to number")
    return [_whole_ns(number, UNITS_NS[unit]) for number in numbers]


def _whole_ns(number: str, unit_ns: int) -> int:
    """Without rounding: a float has too few digits for nanoseconds of today."""
    whole, _, fraction = number.partition(".")
    return int(whole) * unit_ns + (int(fraction) * unit_ns // 10 ** len(fraction) if fraction else 0)


def _files_by_wildcard_name(pattern: str) -> dict[str, str]:
    """Name -> file of all that the pattern finds; the name is what its wildcards stand for, without the ending."""
    parts = WILDCARD_PATTERN.split(pattern)
    kinds = {"**/": "(?:(.*)/)?", "**": "(.*)", "*": "([^/]*)", "?": "([^/])"}
    tokens = [
        kinds.get(part, f"({part.replace('[!', '[^')})") if n % 2 else re.escape(part) for n, part in enumerate(parts)
    ]
    form = re.compile("".join(tokens), re.DOTALL)
    found: dict[str, str] = {}
    for file in sorted(glob.glob(pattern, recursive=True)):
        match = form.fullmatch(file)
        text = "".join(part or "" for part in match.groups()) if match else file
        name = re.sub(r"\.[A-Za-z]\w*$", "", text)
        if name in found:
            raise CameraError(
                f"image folder: '{found[name]}' and '{file}' have one name; narrow the pattern '{pattern}'"
            )
        found[name] = file
    return found


def paired_names(lefts: dict[str, str], rights: dict[str, str], places: tuple[str, str], more: str = "") -> list[str]:
    """The names of the pairs, each in both eyes' files, in natural order. `places`, `more`: for the error.

    Raises: CameraError naming the first picture without the other eye's.
    """
    odd = natural_order(lefts.keys() ^ rights.keys())
    if lefts and rights and not odd:
        return natural_order(lefts)
    counts = f"{len(lefts)} left files {places[0]} and {len(rights)} right files {places[1]}"
    if not (lefts and rights):
        raise CameraError(f"image folder: {counts}; give patterns, or folders, with pictures of both eyes")
    eye, other, file = ("left", "right", lefts[odd[0]]) if odd[0] in lefts else ("right", "left", rights[odd[0]])
    raise CameraError(
        f"image folder: {eye} picture '{file}' has no {other} one of the same name, the first of {len(odd)} "
        f"({counts}); restore it or take it away{more}"
    )


def natural_order(names: Iterable[str]) -> list[str]:
    """2 before 10, and -1 before 0 where not all names begin with a minus (a separator then)."""
    listed = list(names)
    signed = not all(name.startswith("-") for name in listed)

    def key(name: str) -> list[tuple[int, int | str]]:
        if signed and re.fullmatch("-[0-9]+", name):
            return [(-1, int(name))]
        parts = [part for part in re.split(r"([0-9]+)", name) if part]
        return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts]

    return sorted(listed, key=key)


def read_grey(path: str) -> Image:
    """A picture file in grey (h, w).

    Raises: CameraError: it cannot be read, or its data are damaged.
    """
    try:
        return decode_grey(Path(path).read_bytes())
    except (OSError, StreamError) as error:
        raise CameraError(f"image file '{path}' cannot be read; give whole PNG or JPEG files ({error})") from error
