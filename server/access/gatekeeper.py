"""Who is calling and whether they may: host, origin, lock-out, key or cookie, role. Pure but for the key file."""

import logging
from dataclasses import dataclass, field

from server.access.errors import AccessError, RoleError
from server.access.hosts import host_allowed, origin_allowed
from server.access.keys import ApiKey, KeyRing
from server.access.roles import ANYBODY, SAFE_METHODS, Caller, Role, roles_needed
from server.access.sessions import Sessions

log = logging.getLogger(__name__)


# Lock-out after wrong keys: six failures of one address, then a minute of silence. Pure; time is an argument.

LOGIN_FAILURES_MAX = 6
LOGIN_LOCKOUT_S = 60.0
TRACKED_ADDRESSES_MAX = 10_000  # an attacker with many addresses fills this, not the memory


@dataclass(frozen=True, slots=True)
class Failures:
    """Of one address."""

    n_failures: int
    last_s: float


class Lockout:
    """Mutable on purpose: who failed how often."""

    def __init__(self) -> None:
        self._failed: dict[str, Failures] = {}

    def locked_s(self, address: str, now_s: float) -> float:
        """Seconds until this address may try again; 0 when it may."""
        failed = self._failed.get(address)
        if failed is None or failed.n_failures < LOGIN_FAILURES_MAX:
            return 0.0
        return max(0.0, failed.last_s + LOGIN_LOCKOUT_S - now_s)

    def count_failure(self, address: str, now_s: float) -> None:
        """One more wrong key; a minute without one forgets the earlier ones."""
        before = self._failed.pop(address, None)
        count = before.n_failures + 1 if before and now_s - before.last_s < LOGIN_LOCKOUT_S else 1
        self._failed[address] = Failures(count, now_s)
        if len(self._failed) > TRACKED_ADDRESSES_MAX:
            self._failed.pop(next(iter(self._failed)))  # the one that failed longest ago

    def clear_failed_attempts(self, address: str) -> None:
        """A right key."""
        self._failed.pop(address, None)


class HostError(AccessError):
    """The Host header is not one of this server's names."""

    code = "foreign_host"
    status = 421
    hint = "use the address, or add the name to [http] allowed_hosts"


class OriginError(AccessError):
    """Another web page sent this request."""

    code = "foreign_origin"
    hint = "open the panel itself; other pages may not command the machine"


class KeyRequiredError(AccessError):
    """No key, or one that is not in force."""

    code = "unauthorized"
    status = 401
    hint = "send 'Authorization: Bearer KEY', or log in at /login; keys are made by `longreach keys add`"


class LockedOutError(AccessError):
    """Too many wrong keys from this address."""

    code = "locked_out"
    status = 429
    hint = "wait a minute; a stop needs no key"


@dataclass(frozen=True, slots=True)
class Credentials:
    """What a request carries about itself."""

    method: str
    path: str
    address: str
    host: str
    origin: str | None = None
    bearer: str = field(default="", repr=False)
    cookie: str = field(default="", repr=False)


class Gatekeeper:
    """Mutable on purpose: failures and sessions. Without keys everybody on this computer is its operator."""

    def __init__(self, keys: KeyRing, allowed_hosts: tuple[str, ...] = ()) -> None:
        self.keys, self.sessions, self._lockout = keys, Sessions(), Lockout()
        self._hosts = allowed_hosts

    @property
    def open(self) -> bool:
        """Whether there are no keys: then the server listens on loopback only."""
        return self.keys.path is None

    def identify_caller(self, request: Credentials, now_s: float) -> Caller:
        """Who it is. Raises: HostError, OriginError, LockedOutError, KeyRequiredError, RoleError."""
        if not host_allowed(request.host, self._hosts):
            raise HostError(f"host '{request.host[:64]}' is not one of this server's names")
        if request.method not in SAFE_METHODS and not origin_allowed(request.origin, request.host):
            raise OriginError(f"a page of {(request.origin or '')[:64]} may not command this machine")
        roles = _required_roles(request)
        if self.open:
            return self._require_role(Caller("local", Role.OPERATOR, request.address), roles, request)
        if roles == ANYBODY and not (request.bearer or request.cookie):
            return Caller("anonymous", "", request.address)
        caller = self._identify_caller(request, now_s, required=roles != ANYBODY)
        return self._require_role(caller, roles, request)

    def admits_still(self, request: Credentials, now_s: float) -> bool:
        """Whether a connection that was admitted may go on: its key is in force, its session lives, its role may.

        A key that was revoked in the meantime is not a guess: it does not count towards the lock-out.
        """
        roles = _required_roles(request)
        if self.open or roles == ANYBODY:
            return True
        key = self.keys.find_key(request.bearer, now_s) if request.bearer else self._by_session(request.cookie, now_s)
        return key is not None and key.role in roles

    def log_in(self, secret: str, address: str, now_s: float) -> str:
        """A cookie for a key. Raises: LockedOutError, KeyRequiredError."""
        return self.sessions.open(self._by_key(secret, address, now_s).sha256, now_s)

    def _identify_caller(self, request: Credentials, now_s: float, required: bool) -> Caller:
        try:
            key = self._presented_key(request, now_s)
            return Caller(key.name, key.role, request.address, by_key=True)
        except Exception as error:  # a defect of ours too: a stop is a stop, whatever key it carries
            if required:
                raise
            if not isinstance(error, AccessError):
                log.exception("the caller of %s is unknown", request.path)
            return Caller("anonymous", "", request.address)

    def _presented_key(self, request: Credentials, now_s: float) -> ApiKey:
        if request.bearer:
            return self._by_key(request.bearer, request.address, now_s)
        key = self._by_session(request.cookie, now_s)
        if key is None:
            raise KeyRequiredError(self._none_in_force() or "no key given, or the session has ended")
        return key

    def _by_session(self, cookie: str, now_s: float) -> ApiKey | None:
        session = self.sessions.find_session(cookie, now_s)
        return self.keys.in_force(session.key_sha256, now_s) if session is not None else None

    def _none_in_force(self) -> str:
        """The text for the caller; the reason itself names a file, so it is only in the log, the faults and /readyz."""
        return (
            "the server cannot read its key file; until it can, no key is accepted"
            if self.keys.why_no_key_valid
            else ""
        )

    def _by_key(self, secret: str, address: str, now_s: float) -> ApiKey:
        left_s = self._lockout.locked_s(address, now_s)
        if left_s > 0.0:
            raise LockedOutError(
                f"too many wrong keys from {address}; {left_s:.0f} s left", {"retry_s": f"{left_s:.0f}"}
            )
        key = self.keys.find_key(secret, now_s)
        if key is None and self.keys.why_no_key_valid:  # no guess: it may be a good one
            raise KeyRequiredError(self._none_in_force())
        if key is None:
            self._lockout.count_failure(address, now_s)
            raise KeyRequiredError("the key is wrong or was revoked")
        self._lockout.clear_failed_attempts(address)
        return key

    def _require_role(self, caller: Caller, roles: frozenset[Role], request: Credentials) -> Caller:
        if roles and caller.role not in roles:
            wanted = ", ".join(sorted(roles))
            raise RoleError(f"role {caller.role} may not {request.method} {request.path}; required: {wanted}")
        return caller


def _required_roles(request: Credentials) -> frozenset[Role]:
    return roles_needed("GET" if request.method == "WEBSOCKET" else request.method, request.path)
