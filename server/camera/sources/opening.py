"""From settings to a source."""

from server.camera.contracts import DeviceSource, FileSource, FolderSource, HttpSource, SourceSettings, StereoSource
from server.camera.sources.folder import FolderStereoSource
from server.camera.sources.http import HttpStereoSource
from server.camera.sources.video import DeviceStereoSource, FileStereoSource


def open_source(settings: SourceSettings) -> StereoSource:
    """The source that the settings describe.

    Raises: CameraError when a file or folder cannot be used; a camera that is not there yet is waited for.
    """
    match settings:
        case HttpSource():
            return HttpStereoSource(settings)
        case DeviceSource():
            return DeviceStereoSource(settings)
        case FileSource():
            return FileStereoSource(settings)
        case FolderSource():
            return FolderStereoSource(settings)
