"""Check every listening address before anything starts; one line names the faulty one."""

import errno
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

from server.errors import SettingsError

RETRY_S = 0.5
NOT_THERE_YET = (errno.EADDRNOTAVAIL, errno.ENODEV)  # as at boot, before the network is up


@dataclass(frozen=True, slots=True)
class Address:
    """Where something is going to listen. `host_option`, `port_option`: what gives another host or port."""

    host: str
    port: int
    host_option: str
    port_option: str
    kind: socket.SocketKind = socket.SOCK_STREAM
    family: socket.AddressFamily = socket.AF_UNSPEC
    taken_by: str = "another program; give another one"

    def try_it(self) -> None:
        """Bind and let go. Raises: OSError."""
        infos = socket.getaddrinfo(self.host, self.port, self.family, self.kind, flags=socket.AI_PASSIVE)
        for family, kind, protocol, _, where in infos:
            with socket.socket(family, kind, protocol) as probe:
                if kind is socket.SOCK_STREAM:
                    probe.setsockopt(
                        socket.SOL_SOCKET, socket.SO_REUSEADDR, 1
                    )  # what an ended program left does not count
                if family == socket.AF_INET6:
                    probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                probe.bind(where)

    @classmethod
    def of_plc_link(cls, host: str, port: int, taken_by: str) -> Self:
        """Our end of the link to the PLC. `taken_by`: what most likely has it, and what to do."""
        kinds = (socket.SOCK_DGRAM, socket.AF_INET)
        return cls(host, port, "[plc] local_host", "--plc-local-port", *kinds, taken_by)

    def problem(self, error: OSError) -> str:
        """What is wrong, and what to do."""
        udp = "udp " if self.kind is socket.SOCK_DGRAM else ""
        if error.errno == errno.EADDRINUSE:
            return f"{udp}port {self.port} is taken by {self.taken_by} by {self.port_option}"
        if isinstance(error, socket.gaierror) or error.errno in NOT_THERE_YET:
            return (
                f"'{self.host}' is not an address of this computer ({error.strerror}); give one by {self.host_option}"
            )
        return f"{udp}port {self.port} on '{self.host}': {error.strerror}; give another one by {self.port_option}"


def require_bindable(
    addresses: Sequence[Address], wait_s: float = 0.0, waiting: Callable[[str], None] = lambda _text: None
) -> None:
    """Try all of them. An address that this computer does not have yet is waited for; `waiting` is called once.

    Raises: SettingsError: the first that nothing can listen on, and why.
    """
    until_s, announced = time.monotonic() + wait_s, False
    for address in addresses:
        while True:
            try:
                address.try_it()
                break
            except OSError as error:
                missing = isinstance(error, socket.gaierror) or error.errno in NOT_THERE_YET
                if not missing or time.monotonic() >= until_s:
                    raise SettingsError(address.problem(error)) from error
            if not announced:
                waiting(
                    f"'{address.host}' is not an address of this computer yet; waiting for it, {wait_s:.0f} s at most"
                )
                announced = True
            time.sleep(min(RETRY_S, max(0.0, until_s - time.monotonic())))
