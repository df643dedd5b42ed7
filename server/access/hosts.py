"""Checks of the Host and Origin headers: which name the browser called, and which page sent the request. Pure."""

import ipaddress
from functools import lru_cache
from urllib.parse import urlsplit


@lru_cache(64)  # every request asks, nearly all of them for one name
def host_allowed(host: str, extra: tuple[str, ...] = ()) -> bool:
    """Whether a Host header names this server: an IP address, localhost, or a name that the settings allow.

    A page that rebinds its own name to our address (DNS rebinding) sends that name, never an address.
    """
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    return name == "localhost" or name in extra or _is_address(name)


def is_loopback(host: str) -> bool:
    """Whether a bind address is reachable from this computer only."""
    if host == "localhost":
        return True
    return _is_address(host) and ipaddress.ip_address(host).is_loopback


def origin_allowed(origin: str | None, host: str) -> bool:
    """Whether a request comes from our own page, or from a program, which sends no Origin."""
    if origin is None:
        return True
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    return parts.scheme in ("http", "https") and parts.netloc == host


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
