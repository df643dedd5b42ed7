"""The camera's errors."""

from server.errors import ServerError


class CameraError(ServerError):
    """A camera, stream or file that cannot be used."""

    code = "camera"


class StreamError(CameraError):
    """Bytes from a camera stream that are not what the stream's format says."""

    code = "camera_stream"
