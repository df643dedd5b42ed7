"""API keys: 256 random bits each, of which the file holds only a SHA-256. Why not scrypt: docs/decisions/."""

import hashlib
import hmac
import json
import logging
import secrets
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from recording.clock import mono_s
from recording.files import read_text, write_durably
from server.access.roles import Role
from server.errors import SettingsError

log = logging.getLogger(__name__)

API_KEY_PREFIX = "longreach_"
KEY_NAME_CHARS_MAX = 64
# With the guard's period a revoked key is out of force within a second, open connections included
KEY_FILE_CHECK_PERIOD_S = 0.4


class KeysError(SettingsError):
    """A key file that cannot be used, or a name that is taken or unknown."""

    code = "keys"


@dataclass(frozen=True, slots=True)
class ApiKey:
    """One key as it is kept: everything but the key."""

    name: str
    role: Role
    sha256: str
    made_unix_s: float
    revoked_unix_s: float | None = None


def new_key() -> str:
    """A fresh secret."""
    return API_KEY_PREFIX + secrets.token_urlsafe(32)


def digest_of(key: str) -> str:
    """What is kept of a key."""
    return hashlib.sha256(key.encode("utf-8", "surrogateescape")).hexdigest()


def key_by_secret(keys: tuple[ApiKey, ...], presented: str) -> ApiKey | None:
    """The key that was presented, unless revoked."""
    return key_by_digest(keys, digest_of(presented))


def key_by_digest(keys: tuple[ApiKey, ...], sha256: str) -> ApiKey | None:
    """The key of that SHA-256, unless revoked; every kept one is compared, in constant time."""
    match = [key for key in keys if hmac.compare_digest(key.sha256, sha256) and key.revoked_unix_s is None]
    return match[0] if match else None


def with_key(keys: tuple[ApiKey, ...], name: str, role: Role, secret: str, t_unix_s: float) -> tuple[ApiKey, ...]:
    """One key more. Raises: KeysError: the name is in use, empty or too long."""
    if not 0 < len(name) <= KEY_NAME_CHARS_MAX or not name.isprintable():
        raise KeysError(f"key name {name[:KEY_NAME_CHARS_MAX]!r}: give 1 to {KEY_NAME_CHARS_MAX} printable characters")
    if any(key.name == name and key.revoked_unix_s is None for key in keys):
        raise KeysError(f"key '{name}' exists; revoke it first or choose another name")
    return (*keys, ApiKey(name, role, digest_of(secret), t_unix_s))


def without_key(keys: tuple[ApiKey, ...], name: str, t_unix_s: float) -> tuple[ApiKey, ...]:
    """The key of that name revoked; it stays in the list. Raises: KeysError: no key has that name."""
    if not any(key.name == name and key.revoked_unix_s is None for key in keys):
        raise KeysError(f"no valid key '{name}'; `longreach keys list` shows all")
    return tuple(
        replace(key, revoked_unix_s=t_unix_s) if key.name == name and key.revoked_unix_s is None else key
        for key in keys
    )


def read_keys(path: Path) -> tuple[ApiKey, ...]:
    """The keys of a file; none when it does not exist. Raises: KeysError: it cannot be read or is not a key file."""
    try:
        rows = json.loads(read_text(path))["keys"]
        return tuple(ApiKey(**{**row, "role": Role(row["role"])}) for row in rows)
    except FileNotFoundError:
        return ()
    except OSError as error:
        raise KeysError(f"key file {path}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise KeysError(f"{path} is not a key file ({error}); make one with `longreach keys add`") from error


def write_keys(path: Path, keys: tuple[ApiKey, ...]) -> None:
    """In one step. A new file is readable by its owner only; one that was there keeps owner and mode.

    Raises: KeysError: it cannot be written.
    """
    write_private(path, json.dumps({"keys": [asdict(key) for key in keys]}, indent=1) + "\n")


def write_private(path: Path, text: str) -> None:
    """A file that only its owner reads; one that is replaced keeps owner and mode where this user may give them.

    Raises: KeysError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_durably(path, text, private=True)
    except OSError as error:
        raise KeysError(f"{path}: {error.strerror}; give a writable folder") from error


def first_key(path: Path, role: Role, secret_path: Path) -> bool:
    """Make one key if the file holds none in force, and write its secret to `secret_path`; whether one was made."""
    keys = read_keys(path)
    if any(key.revoked_unix_s is None for key in keys):
        return False
    secret = new_key()
    write_private(secret_path, secret + "\n")
    write_keys(path, with_key(keys, "first", role, secret, time.time()))
    return True


class KeyRing:
    """The keys in force: the file is read again when it changes. While it cannot be read, no key is in force."""

    def __init__(self, path: Path | None) -> None:
        """Raises: KeysError: there is a file that cannot be read; a server does not start with it."""
        self._path = path
        self._stamp: tuple[int, ...] | None = None
        self._looked_s = mono_s()
        self._keys: tuple[ApiKey, ...] = ()
        self._problem = ""
        if path is not None:
            self._read(path)

    @property
    def path(self) -> Path | None:
        """Where they are kept; None: there are none."""
        return self._path

    @property
    def why_no_key_valid(self) -> str:
        """Why no access key is valid, although the key file may hold some; empty when all is well."""
        return self._problem

    def refresh(self, now_s: float) -> None:
        """Look at the file again, at most every KEY_FILE_CHECK_PERIOD_S, and read it when it has changed.

        A file that went away or cannot be read leaves no key: a revocation that could not be read is one.
        """
        if self._path is None or now_s - self._looked_s < KEY_FILE_CHECK_PERIOD_S:
            return
        self._looked_s = now_s
        problem = self._problem
        try:
            self._read(self._path)
        except KeysError as error:
            self._keys, self._stamp = (), None
            self._problem = f"no key is in force: {error}"
        if self._problem != problem:
            log.error(self._problem or f"key file {self._path} is read again")

    def _read(self, path: Path) -> None:
        """Raises: KeysError: it cannot be read or is not a key file."""
        try:
            state = path.stat()
            stamp = (state.st_mtime_ns, state.st_ctime_ns, state.st_ino)
        except OSError:
            stamp = None
        if stamp is None or stamp != self._stamp:
            self._keys, self._stamp = read_keys(path), stamp
        self._problem = "" if stamp else f"no key is in force: key file {path} is not there; `longreach keys add`"

    def find_key(self, presented: str, now_s: float) -> ApiKey | None:
        """The key that was presented, if it is in force."""
        return self.in_force(digest_of(presented), now_s)

    def in_force(self, sha256: str, now_s: float) -> ApiKey | None:
        """The key of that SHA-256, if it is in force; another key of the same name is another key."""
        self.refresh(now_s)
        return key_by_digest(self._keys, sha256)

    @property
    def has_no_valid_key(self) -> bool:
        """Whether no key is in force."""
        return all(key.revoked_unix_s is not None for key in self._keys)
