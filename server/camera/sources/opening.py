"""From settings to a source."""

from server.camera.contracts import StereoSource
from server.camera.sources.ahead import AheadSource
from server.camera.sources.device import DeviceStereoSource
from server.camera.sources.euroc import EurocStereoSource
from server.camera.sources.folder import FolderStereoSource
from server.camera.sources.http import HttpStereoSource
from server.camera.sources.recorded import RecordingStereoSource
from server.camera.sources.rectifying import RectifyingSource
from server.camera.sources.rtsp import RtspStereoSource
from server.camera.sources.settings import (
    DeviceSource,
    EurocSource,
    FileSource,
    FolderSource,
    HttpSource,
    RecordingSource,
    RectifiedSource,
    RtspSource,
    SourceSettings,
)
from server.camera.sources.video import FileStereoSource


def open_source(settings: SourceSettings) -> StereoSource:
    """The source that the settings describe.

    Raises: CameraError when a file or folder cannot be used; a camera that is not there yet is waited for.
    """
    match settings:
        case RectifiedSource():
            return RectifyingSource(open_source(settings.source), settings)
        case HttpSource():
            return HttpStereoSource(settings)
        case DeviceSource():
            return DeviceStereoSource(settings)
        case RtspSource():
            return RtspStereoSource(settings)
        case FileSource():
            return FileStereoSource(settings)
        case FolderSource():
            return FolderStereoSource(settings)
        case EurocSource():
            return EurocStereoSource(settings)
        case RecordingSource():
            return RecordingStereoSource(settings)


def open_ahead(settings: SourceSettings) -> StereoSource:
    """The same, a camera's next pair decoded while the one before is worked on; stored pairs wait until asked for.

    Raises: CameraError as open_source.
    """
    source = open_source(settings)
    camera = settings.source if isinstance(settings, RectifiedSource) else settings
    return AheadSource(source) if isinstance(camera, HttpSource | DeviceSource | RtspSource) else source
