"""[camera] of the server's settings: which source, and which calibration of the rig; strict, every field named."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, field_validator

from server.shown_address import without_password

Shown = PlainSerializer(without_password, return_type=str)  # a dump goes to REST, recordings and reports

Pixel = Annotated[float, Field(ge=-8192.0, le=16384.0)]
MaskPolygon = Annotated[tuple[tuple[Pixel, Pixel], ...], Field(min_length=3, max_length=400)]
Mask = Annotated[str, Field(min_length=1)] | Annotated[tuple[MaskPolygon, ...], Field(max_length=60)]


class Strict(BaseModel):
    """A section of the settings: unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*")
    @classmethod
    def _require_utf8(cls, value: object) -> object:
        """Recordings and answers hold the settings as UTF-8; the command line can give names that are not."""
        texts = [text for text in (value if isinstance(value, list | tuple) else [value]) if isinstance(text, str)]
        if any("\ud800" <= letter <= "\udfff" for text in texts for letter in text):
            raise ValueError("it is not UTF-8; give a name that is")
        return value


class _CameraSection(Strict):
    """What every kind of source has in common.

    `calibration`: file of the rig (ZED SNxxxx.conf, OpenCV stereo YAML, Kalibr camchain, KITTI calib.txt), a list of
    two (ROS camera_info or EuRoC sensor.yaml, the left eye's first; OpenCV intrinsics and extrinsics), or a folder
    that holds them. Pictures are then rectified, and the rig's rectified camera takes the place of the machine file's.
    Absent: pictures are taken as they come, and the machine file's camera says what they are.
    `eye_width_px`, `eye_height_px`: size of one eye's pictures where it is not that of the machine file's camera; a
    ZED's file is read for this size.
    `off_centre`: confirms a calibration whose principal point lies far from the middle, as of a cropped picture.
    `mask_left`, `mask_right`: where an eye sees the machine itself, and nothing of the scene is looked for: polygons of
    [u, v] in px of the picture as vision sees it (rectified, where a calibration is given), or a picture file of the
    same size, white there. `longreach camera check` proposes them.
    """

    calibration: str | Annotated[list[str], Field(min_length=1, max_length=2)] | None = None
    eye_width_px: Annotated[int, Field(ge=16, le=8192)] | None = None
    eye_height_px: Annotated[int, Field(ge=16, le=8192)] | None = None
    off_centre: bool = False
    mask_left: Mask = ()
    mask_right: Mask = ()


class HttpCameraSettings(_CameraSection):
    """A camera served over HTTP as multipart JPEG, side by side; with a password: http://user:password@host/path."""

    kind: Literal["http"] = "http"
    url: Annotated[str, Field(pattern=r"^http://[^/\s]+"), Shown] = "http://127.0.0.1:8090/stream"


class DeviceCameraSettings(_CameraSection):
    """A UVC device with side-by-side frames; the defaults are those of a ZED2 at 720p.

    `path` instead of `index`: /dev/v4l/by-id/... stays the same when devices are plugged over. `width_px`: both eyes.
    """

    kind: Literal["device"]
    index: Annotated[int, Field(ge=0, le=63)] = 0
    path: Annotated[str, Field(pattern=r"^/dev/")] | None = None
    width_px: Annotated[int, Field(ge=32, le=16384, multiple_of=2)] = 2560
    height_px: Annotated[int, Field(ge=16, le=8192)] = 720
    rate_hz: Annotated[float, Field(gt=0.0, le=240.0)] = 60.0
    pixel_format: Literal["YUYV", "MJPG"] = "YUYV"


class RtspCameraSettings(_CameraSection):
    """A network camera whose stream shows both eyes side by side.

    `accept_inter_coded`: also H.264, H.265 and the like, whose decoder hides damage until the next key frame.
    """

    kind: Literal["rtsp"]
    url: Annotated[str, Field(pattern=r"^rtsps?://[^/\s]+"), Shown]
    timeout_s: Annotated[float, Field(ge=0.5, le=60.0)] = 5.0
    accept_inter_coded: bool = False


class FileCameraSettings(_CameraSection):
    """A video file of side-by-side frames; `accept_inter_coded` as for RTSP."""

    kind: Literal["file"]
    path: str
    accept_inter_coded: bool = False


class FolderCameraSettings(_CameraSection):
    """Image files of both eyes; `*` and `?` stand for any letters, `**` for folders.

    Two files are a pair where the wildcards stand for the same: left/*.png and right/*.png, or *_l.png and *_r.png.
    `stamp_unit`: of names that are times; auto finds times of the years 2001 to 2099 in s, ms, us or ns, other names
    are numbers and stamped by `rate_hz`.
    """

    kind: Literal["folder"]
    left_glob: str
    right_glob: str
    rate_hz: Annotated[float, Field(gt=0.0, le=1000.0)] = 15.0
    stamp_unit: Literal["auto", "number", "s", "ms", "us", "ns"] = "auto"


class EurocCameraSettings(_CameraSection):
    """A data set in EuRoC's layout; `calibration` = the same folder reads its sensor.yaml files."""

    kind: Literal["euroc"]
    path: str
    speed: Annotated[float, Field(gt=0.0, le=100.0)] = 1.0


class RecordingCameraSettings(_CameraSection):
    """An MCAP file with Foxglove images of both eyes: two topics, or `pair_topic` with side-by-side pictures."""

    kind: Literal["recording"]
    path: str
    left_topic: str = "/camera/left"
    right_topic: str = "/camera/right"
    pair_topic: str = ""
    speed: Annotated[float, Field(gt=0.0, le=100.0)] = 1.0


CameraSettings = Annotated[
    HttpCameraSettings
    | DeviceCameraSettings
    | RtspCameraSettings
    | FileCameraSettings
    | FolderCameraSettings
    | EurocCameraSettings
    | RecordingCameraSettings,
    Field(discriminator="kind"),
]


def with_stream(section: CameraSettings, url: str | None) -> dict[str, object]:
    """A section's fields with the stream of another address in place of its source; None or "": as it is.

    What is known of the rig stays: pictures that are not rectified any more would silently bias every pose.
    """
    if not url:
        return dict(section)
    rig = {name: getattr(section, name) for name in _CameraSection.model_fields}
    return {**rig, "kind": "http", "url": url}
