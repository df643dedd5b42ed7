"""One datagram into the PLC, and everything that must hold afterwards."""

from collections.abc import Hashable
from dataclasses import dataclass

from benchmarks.link.fuzz.oracle_bytes import unframed
from benchmarks.link.fuzz.oracle_fields import CommandFields, StateFields, command_fields
from benchmarks.link.fuzz.picture import picture
from benchmarks.link.fuzz.plc_end import PlcEnd
from benchmarks.link.fuzz.verdict import Breach, Kind, Verdict
from protocol.codes import PlcState, RejectCode
from protocol.plc_events import CommandRejected, PlcLinkEvent, StateChanged
from protocol.plc_states import PlcEvent

_APART = frozenset({"_counters", "_reject", "peer", "refused"})  # looked at one by one below


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a datagram led to, and what is wrong with that (empty: nothing)."""

    kind: Kind
    code: int
    offset: int
    signature: tuple[object, ...]
    problems: tuple[str, ...] = ()
    raised: bool = False


@dataclass(frozen=True, slots=True)
class _Snapshot:
    inside: object
    cycle_counters: object
    peer: Hashable
    counters: tuple[int, ...]


def _snapshot(end: PlcEnd) -> _Snapshot:
    plc, counters = end.plc, end.plc.link._counters
    numbers = (
        counters.accepted,
        counters.lost,
        counters.duplicates,
        counters.late,
        counters.malformed,
        counters.watchdog_trips,
    )
    return _Snapshot(picture(plc, _APART), picture(plc._counters), plc.link.peer, numbers)


class PlcCheck:
    """Feeds one PLC; keeps the last snapshot as long as nothing else moves the PLC in between."""

    def __init__(self, end: PlcEnd) -> None:
        self.end = end
        self._before: _Snapshot | None = None

    def moved(self) -> None:
        """The PLC was moved by something else than `deliver`."""
        self._before = None

    def deliver(self, datagram: bytes, source: Hashable) -> Outcome:
        """Give it one datagram and judge what comes of it."""
        end = self.end
        before = self._before or _snapshot(end)
        verdict, state = end.oracle.judge(datagram, source, end.t_ns), end.state
        end.plc.link.refused = None  # as if the state that answers an earlier one had been sent
        try:
            events = end.plc.receive(datagram, end.t_ns, source)
        except Exception as error:  # any exception at all is the finding
            self._before = None
            signature = (state, type(error).__name__)
            return Outcome(Kind.REFUSED, -1, -1, signature, (f"raised {error!r}",), raised=True)
        refusal = events[0] if events and isinstance(events[0], CommandRejected) else None
        kind = Kind.REFUSED if refusal else Kind.TAKEN if events else Kind.SILENT
        code, offset = (int(refusal.code), refusal.field_offset) if refusal else (0, 0)
        problems = _against_verdict(verdict, kind, code, offset)
        if kind is Kind.TAKEN and not problems:
            problems = self._after_taken(datagram, source)
        elif kind is not Kind.TAKEN:
            problems += self._after_refused(before, kind, refusal, events, state)
        place = offset if offset < 80 else 80 + (offset - 80) % 200 // 8
        kinds = tuple(type(event).__name__ for event in events)
        return Outcome(kind, code, offset, (state, code, place, kinds, end.state), tuple(problems))

    # --- taken --------------------------------------------------------------------------------------------------------

    def _after_taken(self, datagram: bytes, source: Hashable) -> list[str]:
        end, self._before = self.end, None
        payload = unframed(datagram, end.oracle.eap)
        if isinstance(payload, Breach):
            return ["taken, though the frame is wrong"]
        before, command = end.oracle.seen, command_fields(payload)
        expected = end.oracle.take(payload, source)
        try:
            end.look()
        except Exception as error:  # a bad state, or any other trouble with what was taken
            return [f"the state after it: {error!r}"]
        return _against_effects(before, end.oracle.seen, command, expected)

    # --- refused or dropped -------------------------------------------------------------------------------------------

    def _after_refused(
        self,
        before: _Snapshot,
        kind: Kind,
        refusal: CommandRejected | None,
        events: list[PlcLinkEvent],
        state: PlcState,
    ) -> list[str]:
        """Nothing has changed but the counters; the one exception is a blind PC whose motion is stopped."""
        after = self._before = _snapshot(self.end)
        if refusal is not None and refusal.code is RejectCode.ECHO_STALE and state is PlcState.RUN:
            return self._after_stale_echo(events)
        problems = ["events beside the refusal"] if len(events) > 1 else []
        if after.inside != before.inside or after.cycle_counters != before.cycle_counters:
            problems.append("changed by what was not taken")
        told_why = refusal is not None and refusal.code is RejectCode.CFG and not self.end.plc.link.session
        if after.peer != before.peer and not told_why:
            problems.append("peer changed by what was not taken")
        if self.end.plc.link.refused is not None and refusal is None:
            problems.append("an answer for what was not refused")
        steps = tuple(b - a for a, b in zip(before.counters, after.counters, strict=True))
        expected = {(0, 0, 0, 0, 1, 0)} if kind is Kind.REFUSED else {(0, 0, 1, 0, 0, 0), (0, 0, 0, 1, 0, 0)}
        if steps not in expected:
            problems.append(f"counters (ok, lost, dup, late, bad, trips) moved by {steps}")
        return problems + self._against_record(refusal)

    def _after_stale_echo(self, events: list[PlcLinkEvent]) -> list[str]:
        self._before = None
        self.end.look()
        stopped = StateChanged(PlcState.RUN, PlcState.STOPPING, PlcEvent.SOFT_STOP)
        return [] if events[1:] == [stopped] else ["a blind PC's motion was not just stopped"]

    def _against_record(self, refusal: CommandRejected | None) -> list[str]:
        """What the next states will tell of it."""
        noted = self.end.plc.link._reject
        if refusal is None or (noted.code, noted.field_offset, noted.seq) == (
            refusal.code,
            refusal.field_offset,
            refusal.seq,
        ):
            return []
        return [f"noted {noted} for {refusal}"]


def _against_verdict(verdict: Verdict, kind: Kind, code: int, offset: int) -> list[str]:
    if kind is Kind.REFUSED and (code, offset) in verdict.may:
        return []
    if kind is verdict.kind and kind is not Kind.REFUSED:
        return []
    may = [f"{RejectCode(c).name}@{o}" for c, o in sorted(verdict.may)[:6]]
    got = f"{RejectCode(code).name}@{offset}" if kind is Kind.REFUSED else kind.value
    return [f"{got}, but the rules say {verdict.kind.value} {' '.join(may)}"]


def _against_effects(before: StateFields, after: StateFields, command: CommandFields, expected: PlcState) -> list[str]:
    """Whether the state after an accepted command is the one that the documentation promises."""
    problems = []
    if after.plc_state != expected:
        problems.append(f"state {PlcState(after.plc_state).name}, must be {expected.name}")
    if after.session != (command.session if expected is not PlcState.DISARMED else 0):
        problems.append(f"session {after.session:#x}")
    disarmed = expected is PlcState.DISARMED
    if (after.nonce != before.nonce) is not disarmed:
        problems.append("nonce renewed, or not, against the rule")
    fed = (command.seq, command.t_send_ns, 0)
    if not disarmed and (after.ack_seq, after.t_pc_echo_ns, after.rx_age_us) != fed:
        problems.append("acknowledgement is not of this command")
    if not disarmed and after.q_ref != before.q_ref:  # unarmed it is where the joints are
        problems.append("the reference moved without a cycle")
    return problems
