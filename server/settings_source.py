"""From [camera] of the settings to the source that the vision process opens, and the machine with that camera in it."""

import re
from dataclasses import replace

from machine.description import Machine, StereoCamera
from machine.lens import PRINCIPAL_OFFSET_MAX_FRAC, principal_off_frac
from server.camera.rectification import rectification_of
from server.camera.rectification_reading import read_calibration
from server.camera.sources.settings import (
    DeviceSource,
    EurocSource,
    FileSource,
    FolderSource,
    HttpSource,
    PlainSource,
    RecordingSource,
    RectifiedSource,
    RtspSource,
    SourceSettings,
)
from server.errors import SettingsError
from server.settings_camera import (
    CameraSettings,
    DeviceCameraSettings,
    EurocCameraSettings,
    FileCameraSettings,
    FolderCameraSettings,
    HttpCameraSettings,
    RecordingCameraSettings,
    RtspCameraSettings,
)


def plain_source(camera: CameraSettings) -> PlainSource:
    """The source as such, whatever the rig's calibration."""
    match camera:
        case HttpCameraSettings():
            return HttpSource(camera.url)
        case DeviceCameraSettings():
            device = camera.index if camera.path is None else camera.path
            return DeviceSource(device, camera.width_px, camera.height_px, camera.rate_hz, camera.pixel_format)
        case RtspCameraSettings():
            return RtspSource(camera.url, camera.timeout_s, camera.accept_inter_coded)
        case FileCameraSettings():
            return FileSource(camera.path, camera.accept_inter_coded)
        case FolderCameraSettings():
            return FolderSource(camera.left_glob, camera.right_glob, camera.rate_hz, camera.stamp_unit)
        case EurocCameraSettings():
            return EurocSource(camera.path, camera.speed)
        case RecordingCameraSettings():
            topics = (camera.left_topic, camera.right_topic, camera.pair_topic)
            return RecordingSource(camera.path, *topics, camera.speed)


def eye_size_px(camera: CameraSettings, machine: Machine) -> tuple[int, int]:
    """Width and height of one eye's pictures: as given, else half the device's, else the machine file's."""
    width, height = machine.camera.width_px, machine.camera.height_px
    if isinstance(camera, DeviceCameraSettings):
        width, height = camera.width_px // 2, camera.height_px
    return camera.eye_width_px or width, camera.eye_height_px or height


def machine_text_with_camera(text: str, camera: StereoCamera) -> str:
    """A machine file's text with this camera in place of its own: recordings must say what their pictures were.

    The mount stays. Parsing the text gives `camera` back to the last bit.
    """
    values = {
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        "fx_px": camera.fx_px,
        "fy_px": camera.fy_px,
        "cx_px": camera.cx_px,
        "cy_px": camera.cy_px,
        "distortion": list(camera.distortion),
        "baseline_m": camera.baseline_m,
        "rate_hz": camera.rate_hz,
        "rectified": "true" if camera.rectified else "false",
    }
    off_frac = principal_off_frac((camera.cx_px, camera.cy_px), (camera.width_px, camera.height_px))
    if off_frac > PRINCIPAL_OFFSET_MAX_FRAC:
        values["off_centre"] = "true"
    begin = re.search(r"^\[camera\][^\n]*$", text, re.MULTILINE)
    if begin is None:
        raise SettingsError("machine file: no [camera] section; give a whole machine file")
    behind = re.search(r"^\[", text[begin.end() :], re.MULTILINE)
    end = len(text) if behind is None else begin.end() + behind.start()
    section = text[begin.end() : end]
    for name in values:
        section = re.sub(rf"^\s*{name}\s*=\s*(\[[^\]]*\]|[^\n#]*)(#[^\n]*)?$\n?", "", section, flags=re.MULTILINE)
    written = "".join(f"{name} = {value}\n" for name, value in values.items())
    return f"{text[: begin.end()]}\n{written}{section}{text[end:]}"


def source_and_machine(camera: CameraSettings, machine: Machine) -> tuple[SourceSettings, Machine]:
    """The source, and the machine whose camera says what its pictures are.

    Without a calibration: the plain source and the machine as it is. With one: the source rectifies, and the machine
    holds the rectified camera. The mount `T_tcp_cam_left` stays: it means the rectified left eye.

    Raises: CalibrationFileError: file, field, remedy.
    """
    source = plain_source(camera)
    if camera.calibration is None:
        return source, machine
    paths = [camera.calibration] if isinstance(camera.calibration, str) else camera.calibration
    rig = read_calibration(paths, eye_size_px(camera, machine), camera.off_centre)
    rate_hz = camera.rate_hz if isinstance(camera, DeviceCameraSettings) else machine.camera.rate_hz
    rectified = rectification_of(rig, rate_hz).camera
    return RectifiedSource(source, rig, rate_hz), replace(machine, camera=rectified)
