"""The recording package's errors."""


class RecordingError(Exception):
    """A recording that cannot be written, read or converted: names file, field, value and remedy."""
