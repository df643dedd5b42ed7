"""What can be wrong with a compensation."""

from server.errors import SettingsError


class CompensationError(SettingsError):
    """A diagnosis that must not be used, or effects that cannot be compensated."""
