"""Who calls, its role, and what each role may do. Default deny: what is not in the table needs an operator."""

from dataclasses import dataclass
from enum import StrEnum


class Role(StrEnum):
    """Of a key or a session."""

    VIEWER = "viewer"  # sees everything but the audit, commands nothing
    OPERATOR = "operator"  # a person at the machine
    FLEET = "fleet"  # a program: every command carries an Idempotency-Key, control is never taken by force
    ENGINEER = "engineer"  # an operator who may also hold control as engineer
    ADMIN = "admin"  # everything


@dataclass(frozen=True, slots=True)
class Caller:
    """Who sends a request: the key's name, its role, and from where.

    `by_key`: identified by a key or by a session that a key opened; otherwise any user of this computer.
    """

    name: str = "local"
    role: str = "operator"
    address: str = ""
    by_key: bool = False


ANYBODY: frozenset[Role] = frozenset()
EVERY_ROLE = frozenset(Role)
HUMAN_ROLES = frozenset({Role.OPERATOR, Role.ENGINEER, Role.ADMIN})
COMMANDING_ROLES = HUMAN_ROLES | {Role.FLEET}

#: Without a key: whether it lives, how one logs in, and the stop, which never needs anything.
KEYLESS_ROUTES = {
    ("GET", "/healthz"),
    ("GET", "/readyz"),
    ("GET", "/login"),
    ("POST", "/v1/session"),
    ("POST", "/v1/stop"),
}
SAFE_METHODS = {"GET", "HEAD", "OPTIONS"}
METHODS = SAFE_METHODS | {"POST", "PUT", "PATCH", "DELETE"}
COMMAND_PATHS = ("/v1/jobs", "/v1/lease", "/v1/disarm", "/v1/reset", "/v1/target")


def roles_needed(method: str, path: str) -> frozenset[Role]:
    """The roles of which one is needed; empty: the route is open to everyone."""
    if (method.replace("HEAD", "GET"), path) in KEYLESS_ROUTES:
        return ANYBODY
    if _is_path_under(path, "/v1/audit"):
        return HUMAN_ROLES
    if _is_path_under(path, "/v1/hold"):
        return HUMAN_ROLES
    if method not in METHODS or any(path == open_path for _, open_path in KEYLESS_ROUTES):
        return EVERY_ROLE  # there is no such route: 405 for everybody who is known
    if method in SAFE_METHODS or (method == "DELETE" and path == "/v1/session"):
        return EVERY_ROLE
    if path.startswith("/v1/jobs/") and path.endswith("/cancel"):
        return EVERY_ROLE  # a stop of one job: as STOP, every known caller may
    return COMMANDING_ROLES if any(_is_path_under(path, command) for command in COMMAND_PATHS) else HUMAN_ROLES


def _is_path_under(path: str, prefix: str) -> bool:
    return path == prefix or path.startswith(prefix + "/")
