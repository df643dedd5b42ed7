"""The link's errors as the server sees them."""


class LinkError(Exception):
    """The PLC link cannot do what was asked: says why and what to do."""


class LinkRefusedError(LinkError):
    """The PLC or our own motion gate refused; nothing moves."""


class LinkSilentError(LinkError):
    """Nothing is heard from the PLC, or the link process is gone."""
