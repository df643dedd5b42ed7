"""Reports to systemd (`Type=notify`): ready, status, alive, stopping. Without systemd all of it does nothing."""

import asyncio
import logging
import os
import socket
from collections.abc import Callable, MutableMapping

log = logging.getLogger(__name__)
STATUS_PERIOD_MAX_S = 5.0  # between two reports where no watchdog requires a shorter time


class ServiceManager:
    """One datagram a report, as sd_notify(3) describes it; a report that cannot be sent never disturbs the server."""

    def __init__(self, address: str, watchdog_s: float | None, status: Callable[[], str]) -> None:
        self._address, self._watchdog_s, self._status = address, watchdog_s, status
        self._stopping = self._failed = False

    @classmethod
    def of_environment(
        cls, status: Callable[[], str], environment: MutableMapping[str, str] = os.environ
    ) -> "ServiceManager":
        """What systemd set for this process. It is taken out: a child process must not report in our name."""
        address = environment.pop("NOTIFY_SOCKET", "")
        limit_us, process_id = environment.pop("WATCHDOG_USEC", ""), environment.pop("WATCHDOG_PID", "")
        ours = limit_us.isdecimal() and int(limit_us) > 0 and process_id in ("", str(os.getpid()))
        return cls(address, int(limit_us) * 1e-6 if ours else None, status)

    def ready(self) -> None:
        """The panel answers, and a STOP is accepted."""
        self._send("READY=1")

    def stopping(self) -> None:
        """The end has begun: the motion is ramped down first."""
        self._stopping = True
        self._send("STOPPING=1\nSTATUS=stopping: ramps the machine down, then closes the recordings")

    async def keep_alive(self) -> None:
        """From the event loop, at least twice in a watchdog period: systemd restarts a server whose loop hangs."""
        period_s = STATUS_PERIOD_MAX_S if self._watchdog_s is None else min(STATUS_PERIOD_MAX_S, 0.5 * self._watchdog_s)
        while self._address:
            self._send("WATCHDOG=1")
            if not self._stopping:
                self._send(f"STATUS={self._status_text()}")
            await asyncio.sleep(period_s)

    def _status_text(self) -> str:
        try:
            return " ".join(self._status().split())
        except Exception as error:  # the watchdog's datagram must go on; /readyz shows the defect as well
            log.exception("the status for systemd cannot be made")
            return f"status unknown: {error!r}"

    def _send(self, text: str) -> None:
        if not self._address:
            return
        where = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
                sender.setblocking(False)
                sender.sendto(text.encode(), where)
        except OSError as error:
            if not self._failed:
                log.warning("systemd cannot be informed at %s: %s", self._address, error)
            self._failed = True
        else:
            self._failed = False
