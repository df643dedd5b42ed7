"""From the settings file to what link and vision processes take."""

from pathlib import Path

from machine.description import StereoCamera
from protocol.authentication import parse_key
from protocol.errors import LocalProtocolError
from recording.files import read_text
from server.camera.contracts import VisionSettings
from server.camera.own_structure import mask_polygons
from server.camera.sources.settings import SourceSettings
from server.errors import SettingsError
from server.link.client import LinkSettings
from server.settings import ServerSettings
from server.settings_camera import CameraSettings

PREVIEW_WIDTH_PX = 1280  # the panel shows 720p; recordings keep ten pictures a second of it
PREVIEW_RATE_HZ = 30.0


def read_key(path: str | None) -> bytes:
    """The key of the PLC link from its file; no file, no key.

    Raises: SettingsError: the file cannot be read or holds no key.
    """
    if path is None:
        return b""
    try:
        return parse_key(read_text(Path(path)))
    except OSError as error:
        raise SettingsError(f"[plc] auth_key_file = '{path}': {error.strerror}") from error
    except LocalProtocolError as error:
        raise SettingsError(f"[plc] auth_key_file = '{path}': {error}") from error


def link_settings(settings: ServerSettings) -> LinkSettings:
    """Addresses and framing of the PLC link."""
    plc = settings.plc
    return LinkSettings(
        plc_host=plc.host,
        plc_port=plc.port,
        local_host=plc.local_host,
        local_port=plc.local_port,
        framing=plc.framing,
        pc_net_id=plc.pc_net_id,
        plc_net_id=plc.plc_net_id,
        key=read_key(plc.auth_key_file),
    )


def vision_settings(source: SourceSettings, section: CameraSettings, camera: StereoCamera) -> VisionSettings:
    """How pictures from this source, of this camera, are looked through.

    Raises: SettingsError: a mask's picture cannot be used.
    """
    return VisionSettings(
        source=source,
        preview_width_px=PREVIEW_WIDTH_PX,
        preview_rate_hz=PREVIEW_RATE_HZ,
        mask_left=mask_polygons(section.mask_left, camera, "mask_left"),
        mask_right=mask_polygons(section.mask_right, camera, "mask_right"),
    )
