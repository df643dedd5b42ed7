"""What each kind of source needs to know: frozen data, since it crosses a process boundary.

Defaults are those of the settings (`server/settings_camera.py`).
"""

from dataclasses import dataclass
from typing import Literal

from server.camera.rectification_rig import RigCalibration

PixelFormat = Literal["MJPG", "YUYV"]
StampUnit = Literal["auto", "number", "s", "ms", "us", "ns"]


@dataclass(frozen=True, slots=True)
class HttpSource:
    """Multipart JPEG over HTTP, left and right side by side."""

    url: str


@dataclass(frozen=True, slots=True)
class DeviceSource:
    """A UVC device that gives side-by-side frames; `width_px` is that of both eyes together, 2560 for a ZED2 at 720p.

    `index`: number N of /dev/videoN, or a device's path (/dev/v4l/by-id/... stays when devices are plugged over).
    """

    index: int | str
    width_px: int
    height_px: int
    rate_hz: float
    pixel_format: PixelFormat


@dataclass(frozen=True, slots=True)
class RtspSource:
    """A network camera's RTSP stream of side-by-side frames, fetched over TCP."""

    url: str
    timeout_s: float = 5.0
    accept_inter_coded: bool = False


@dataclass(frozen=True, slots=True)
class FileSource:
    """A video file of side-by-side frames, played once at its own rate."""

    path: str
    accept_inter_coded: bool = False


@dataclass(frozen=True, slots=True)
class FolderSource:
    """Two sets of image files paired by name, played once. `stamp_unit`: of names that are times."""

    left_glob: str
    right_glob: str
    rate_hz: float
    stamp_unit: StampUnit = "auto"


@dataclass(frozen=True, slots=True)
class EurocSource:
    """A data set in EuRoC's layout (mav0/cam0/data.csv, data/*.png, cam1), played once by its stamps.

    `speed`: 1 is as recorded, 0.5 half as fast.
    """

    path: str
    speed: float = 1.0


@dataclass(frozen=True, slots=True)
class RecordingSource:
    """Foxglove images in an MCAP file, played once by their stamps: one topic for each eye, or one of both.

    `pair_topic`: side-by-side pictures; empty: `left_topic` and `right_topic` are used.
    """

    path: str
    left_topic: str = "/camera/left"
    right_topic: str = "/camera/right"
    pair_topic: str = ""
    speed: float = 1.0


PlainSource = HttpSource | DeviceSource | RtspSource | FileSource | FolderSource | EurocSource | RecordingSource


@dataclass(frozen=True, slots=True)
class RectifiedSource:
    """Another source, its pictures rectified by this rig; vision must then use `rectification_of(rig, ...).camera`."""

    source: PlainSource
    rig: RigCalibration
    rate_hz: float


SourceSettings = PlainSource | RectifiedSource
