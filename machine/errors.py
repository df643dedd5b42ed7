"""The machine package's errors."""


class MachineError(Exception):
    """Base of all errors of this package: names subject, value, limit, unit and remedy."""


class MachineFileError(MachineError):
    """A machine file that cannot be used: names the field, its value, the bound and the unit."""
