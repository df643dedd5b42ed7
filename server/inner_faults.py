"""What is wrong inside the server itself. Its parts report; the fault list, the panel's alarms and /readyz show it."""

from collections.abc import Callable

KEYS_UNREADABLE_FAULT_ID = "keys_unreadable"
SERVER_PART_FAILED_FAULT_ID = "server_part_failed"


class InnerFaults:
    """Mutable on purpose: parts join while the server is put together."""

    def __init__(self) -> None:
        self._parts: list[tuple[str, Callable[[], str]]] = []

    def watch(self, fault_id: str, problem: Callable[[], str]) -> None:
        """Include this part from now on; `problem` returns an empty text while all is well."""
        self._parts.append((fault_id, problem))

    @property
    def active(self) -> dict[str, str]:
        """Fault id -> what is wrong now, of all parts that report a problem."""
        found: dict[str, str] = {}
        for fault_id, part in self._parts:
            if text := part():
                found[fault_id] = f"{found[fault_id]}; {text}" if fault_id in found else text
        return found
