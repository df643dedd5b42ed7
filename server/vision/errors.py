"""The vision package's errors: broken contracts only. What an image shows is a status, never an error."""


class VisionError(Exception):
    """Base of vision's errors: names subject, value, limit, unit and remedy."""


class UnknownDictionaryError(VisionError):
    """A marker dictionary that does not exist."""


class NoMarkersError(VisionError):
    """A machine file without the markers that a pose source needs."""


class NoPoseError(VisionError):
    """An error to the goal was asked of a look or pair that has no poses."""
