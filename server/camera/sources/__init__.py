"""Where stereo pairs come from: one contract, one file per kind of source."""

from server.camera.contracts import DeviceSource, FileSource, FolderSource, HttpSource, SourceSettings

__all__ = ["DeviceSource", "FileSource", "FolderSource", "HttpSource", "SourceSettings"]
