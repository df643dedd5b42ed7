"""Once found, a fault stands until enough good pairs have come: one good picture in between proves nothing."""

from dataclasses import replace

from server.camera.health.findings import FaultCode, Finding

GOOD_PAIRS = 5
GOOD_PAIRS_OF = {  # where more must be seen
    FaultCode.STAMP_BACKWARDS: 10,  # the clock's map needs 8 pairs to find itself
    FaultCode.STAMP_JUMPED: 10,
    FaultCode.STAMP_STANDS: 10,
    FaultCode.LATE: 10,
    FaultCode.STARTING: 0,  # counts by itself
}


class Latch:
    """Holds findings by their code."""

    def __init__(self) -> None:
        self._held: dict[FaultCode, tuple[Finding, int]] = {}

    def hold(self, findings: tuple[Finding, ...]) -> tuple[Finding, ...]:
        """These findings, and those of before that have not been absent for long enough."""
        lingering: list[Finding] = []
        now = {finding.code: finding for finding in reversed(findings)}
        for code, (finding, left) in tuple(self._held.items()):
            if code in now:
                continue
            if left == 0:
                del self._held[code]
                continue
            self._held[code] = finding, left - 1
            lingering.append(replace(finding, text=f"{finding.text} (over; {left} more good pairs wanted)"))
        for code, finding in now.items():
            self._held[code] = finding, GOOD_PAIRS_OF.get(code, GOOD_PAIRS)
        return (*findings, *lingering)

    def clear(self) -> None:
        """Forget all."""
        self._held.clear()
