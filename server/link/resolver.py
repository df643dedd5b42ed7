"""Name resolution that never makes the link wait: a thread asks, the loop looks at the newest answer."""

import socket
import threading

from server.link.udp_end import Address


class Resolver:
    """The PLC's address; `refresh` while no session is open, since a container's address may change."""

    def __init__(self, host: str, port: int) -> None:
        self._host, self._port = host, port
        self._wanted = threading.Event()
        self.address: Address | None = None
        self.error = ""
        threading.Thread(target=self._work, name="link-resolver", daemon=True).start()
        self.refresh()

    def refresh(self) -> None:
        """Ask again; returns at once."""
        self._wanted.set()

    def _work(self) -> None:
        while True:
            self._wanted.wait()
            self._wanted.clear()
            try:
                found = socket.getaddrinfo(self._host, self._port, socket.AF_INET, socket.SOCK_DGRAM)
            except (OSError, UnicodeError) as error:
                self.error = f"PLC host '{self._host}' cannot be resolved: {error}; check [plc] host in the settings"
                continue
            host, port = found[0][4][:2]
            self.address, self.error = (str(host), int(port)), ""
