"""Browser sessions: a cookie in place of a key, in memory only; a restart logs everybody out."""

import hashlib
import secrets
from dataclasses import dataclass

SESSION_LIFETIME_S = 12 * 3600.0
SESSIONS_MAX = 1000
SESSION_COOKIE_NAME = "longreach_session"


@dataclass(frozen=True, slots=True)
class Session:
    """Which key it stands for: it ends with that key, and has that key's role."""

    key_sha256: str
    ends_s: float


class Sessions:
    """Mutable on purpose. Cookies are kept as hashes, so that a memory dump opens nothing."""

    def __init__(self) -> None:
        self._kept: dict[str, Session] = {}

    def open(self, key_sha256: str, now_s: float) -> str:
        """The new cookie's value, for the key of that SHA-256."""
        token = secrets.token_urlsafe(32)
        self._kept[_token_digest(token)] = Session(key_sha256, now_s + SESSION_LIFETIME_S)
        if len(self._kept) > SESSIONS_MAX:
            self._kept.pop(next(iter(self._kept)))
        return token

    def find_session(self, token: str, now_s: float) -> Session | None:
        """Which it is, while it lives."""
        session = self._kept.get(_token_digest(token))
        return session if session is not None and now_s < session.ends_s else None

    def close(self, token: str) -> None:
        """Log out."""
        self._kept.pop(_token_digest(token), None)


def _token_digest(token: str) -> str:
    return hashlib.sha256(token.encode("utf-8", "surrogateescape")).hexdigest()
