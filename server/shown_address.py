"""Addresses as they may be shown: in states, logs, settings, recordings and errors, without the passwords in them."""

import re

_USER = re.compile(r"(?<=://)([^/\s:@]*):[^/\s]*@")
_QUERY = re.compile(r"(?i)([?&][^=&#\s]*(?:pass|pwd|secret|token|auth|key)[^=&#\s]*=)[^&#\s'\"]*")


def without_password(text: str) -> str:
    """The text with `***` for the password of every user:password@host, and for fields of a query that are secret."""
    return _QUERY.sub(r"\1***", _USER.sub(r"\1:***@", text))
