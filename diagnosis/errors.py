"""The diagnosis' errors."""


class DiagnosisError(Exception):
    """A diagnosis that cannot be made: names what is missing or wrong, its value, the limit and the remedy."""
