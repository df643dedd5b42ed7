"""Addresses as they may be shown: in states, logs, settings, recordings and errors, without the secrets in them.

What may be meant as a secret is one: `http://u:p/w@h/a`, where %2F was forgotten, is refused, and shown without it.
"""

import re

_USER = re.compile(r"[^/?#@\s]*")
_NO_USER = re.compile(r"[^:/?#@]*(/[^:?#@]*)?[?#].*=")  # an @ in a query is of no user, and its fields are masked
_HARMLESS = (
    "action|channel|camera|cam|stream|subtype|profile|codec|format|fps|rate|resolution|size|width|height|quality"
)
_QUERY = re.compile(rf"(?i)([?&;](?!(?:{_HARMLESS}|compression|user|username|id|x|y)=)[^=&;#\s]*=)[^&;#\s'\"]*")


def without_password(text: str) -> str:
    """The text with `***` for the password, or the token, before a host, and for fields of a query that may be secret.

    An address without its scheme counts as one, since the password of a user who forgets it is in it all the same.
    """
    return _QUERY.sub(r"\1***", _without_user(text))


def _without_user(text: str) -> str:
    head, at, rest = text.rpartition("@")
    before, scheme, info = head.partition("://")
    if not scheme:
        before, info = "", head
    if not at or not (scheme or ":" in info) or _NO_USER.match(info):
        return text
    user, colon, _ = info.partition(":")
    return f"{before}{scheme}{f'{user}:' if colon and _USER.fullmatch(user) else ''}***@{rest}"
