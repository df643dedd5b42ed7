"""Where stereo pairs come from: one contract, one file per kind of source."""

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

__all__ = [
    "DeviceSource",
    "EurocSource",
    "FileSource",
    "FolderSource",
    "HttpSource",
    "PlainSource",
    "RecordingSource",
    "RectifiedSource",
    "RtspSource",
    "SourceSettings",
]
