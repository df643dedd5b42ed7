"""From the settings file to what link and vision processes take."""

from server.camera.client import VisionSettings
from server.camera.sources import DeviceSource, FileSource, HttpSource
from server.link.client import LinkSettings
from server.settings import DeviceCameraSettings, FileCameraSettings, HttpCameraSettings, ServerSettings


def link_settings(settings: ServerSettings) -> LinkSettings:
    """Addresses and framing of the PLC link."""
    plc = settings.plc
    return LinkSettings(
        plc_host=plc.host,
        plc_port=plc.port,
        local_host=plc.local_host,
        local_port=plc.local_port,
        framing=plc.framing,
    )


def vision_settings(settings: ServerSettings) -> VisionSettings:
    """The camera source and how it is looked through."""
    match settings.camera:
        case HttpCameraSettings(url=url):
            source = HttpSource(url)
        case DeviceCameraSettings(index=index):
            source = DeviceSource(index)
        case FileCameraSettings(path=path):
            source = FileSource(path)
    return VisionSettings(source=source)
