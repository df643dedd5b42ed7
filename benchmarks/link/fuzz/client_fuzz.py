"""Episodes of fuzzing against the PC's end: a phase is reached, then datagrams come while time goes on."""

from collections import deque
from random import Random

from benchmarks.link.fuzz.client_end import ClientEnd
from benchmarks.link.fuzz.corpus import Corpus
from benchmarks.link.fuzz.counts import FuzzCounts
from benchmarks.link.fuzz.coverage import LineTrace
from benchmarks.link.fuzz.frames import framed, sealed
from benchmarks.link.fuzz.mutators import mutated_state
from benchmarks.link.fuzz.oracle_bytes import unframed
from benchmarks.link.fuzz.oracle_fields import state_fields
from benchmarks.link.fuzz.picture import picture
from benchmarks.link.fuzz.plc_check import Outcome
from benchmarks.link.fuzz.plc_end import VARIANTS
from benchmarks.link.fuzz.verdict import Kind, Verdict, Violation
from protocol.client_events import ClientEvent, ClientPhase, DatagramDropped, LinkClosed, RejectSeen, StateReceived
from protocol.codes import RejectCode
from protocol.layout import STATE_SIZE
from protocol.limits import LimitTable

_SEAL_SHARE = 0.8
_TRACE_EVERY = 199  # one datagram in this many is run with lines traced
_APART = frozenset({"counters"})
_TARGETS = (*ClientPhase, ClientPhase.RUNNING, ClientPhase.RUNNING, ClientPhase.ARMED)


class ClientFuzz:
    """One chunk of datagrams; all that is random comes out of `rng`."""

    end = "client"

    def __init__(self, table: LimitTable, rng: Random, corpus: Corpus) -> None:
        self._table, self._rng, self.corpus = table, rng, corpus
        self.counts = FuzzCounts(self.end)
        self._archive: deque[bytes] = deque(maxlen=500)
        self._trace = LineTrace()

    def run(self, n: int) -> FuzzCounts:
        """n datagrams, in as many episodes as it takes."""
        while self.counts.n < n:
            self._episode(min(self._rng.choice((60, 150, 300)), n - self.counts.n))
        self.counts.signatures |= self.corpus.signatures
        self.counts.lines |= self._trace.lines
        return self.counts

    def _episode(self, n: int) -> None:
        rng = self._rng
        end = ClientEnd(self._table, rng.choice(VARIANTS), rng)
        end.reach(rng.choice(_TARGETS))
        for _ in range(n):
            if end.link.closed and rng.random() < 0.3:
                break
            if self._one(end).raised or not self._pass_time(end):
                break
        self._archive.extend(end.recorded)

    def _pass_time(self, end: ClientEnd) -> bool:
        """Mostly none; else a turn of the client's own, whose words are judged. False: it raised."""
        rng = self._rng
        if rng.random() > 0.3:
            return True
        try:
            if rng.random() < 0.15:
                end.wish()
            n_turns = rng.choice((1, 3, 6, 14, 60)) if rng.random() < 0.05 else 1
            turns = [end.turn(hear=rng.random() < 0.7) for _ in range(n_turns)]
        except Exception as error:  # any exception at all is the finding
            self.counts.exceptions += 1
            self._blame(f"poll or send raised {error!r}", end, b"")
            return False
        for turn in turns:
            self.counts.emitted += turn.sent is not None
            if turn.problems:
                self._blame("; ".join(turn.problems), end, turn.sent or b"")
        if rng.random() < 0.7:
            end.tell()
        return True

    def _one(self, end: ClientEnd) -> Outcome:
        payload, origin = self._payload(end)
        counts, rng = self.counts, self._rng
        if origin != "replay":
            counts.mutated += 1
            if rng.random() < _SEAL_SHARE:
                payload = sealed(payload, end.variant.key)
                counts.sealed += 1
        datagram = framed(payload, end.variant.client_wire(), rng)
        phase = end.phase.name
        lines: set[str] = set()
        if counts.n % _TRACE_EVERY == 0:
            trace = LineTrace()
            outcome: Outcome = trace.run(lambda: self._deliver(end, datagram))
            lines = trace.lines
            self._trace.lines |= lines
        else:
            outcome = self._deliver(end, datagram)
        self._note(outcome, phase, origin, datagram, end)
        self.corpus.offer(payload, repr(outcome.signature), lines)
        return outcome

    # --- one datagram -------------------------------------------------------------------------------------------------

    def _deliver(self, end: ClientEnd, datagram: bytes) -> Outcome:
        link, phase = end.link, end.phase
        verdict = end.oracle.judge(datagram, end.t_ns)
        before, counters = picture(link, _APART), _counters(end)
        try:
            events = link.receive(datagram, end.t_ns)
        except Exception as error:  # any exception at all is the finding
            return Outcome(Kind.REFUSED, -1, 0, (phase, type(error).__name__), (f"raised {error!r}",), raised=True)
        dropped = events[0] if events and isinstance(events[0], DatagramDropped) else None
        kind = Kind.REFUSED if dropped else Kind.TAKEN if events else Kind.SILENT
        code = int(dropped.code) if dropped else 0
        problems = _against_verdict(verdict, kind, code)
        if kind is Kind.TAKEN and not problems:
            problems = self._after_taken(end, datagram, events)
        elif kind is not Kind.TAKEN:
            steps = tuple(b - a for a, b in zip(counters, _counters(end), strict=True))
            problems += _against_change(kind, verdict, end, before != picture(link, _APART), steps, events)
        names = tuple(type(event).__name__ for event in events)
        return Outcome(kind, code, 0, (phase, code, names, end.phase), tuple(problems))

    def _after_taken(self, end: ClientEnd, datagram: bytes, events: list[ClientEvent]) -> list[str]:
        payload = unframed(datagram, end.oracle.eap)
        if not isinstance(payload, bytes):
            return ["taken, though the frame is wrong"]
        closes = end.oracle.take(payload, end.t_ns)
        fields, first = state_fields(payload), events[0]
        problems = []
        if not isinstance(first, StateReceived) or first.state is not end.link.state:
            return ["the first event is not the state"]
        got = (first.state.seq, first.state.t_send_ns, int(first.state.plc_state), first.state.q_ref)
        if got != (fields.seq, fields.t_send_ns, fields.plc_state, fields.q_ref):
            problems.append("the event holds other values than the datagram")
        if any(isinstance(event, RejectSeen) for event in events) and not fields.reject_code:
            problems.append("a refusal was seen that the state does not tell of")
        if closes is not any(isinstance(event, LinkClosed) for event in events) or end.link.closed is not closes:
            problems.append("closed, or not, against the rule")
        return problems

    # --- what the datagrams are made of -------------------------------------------------------------------------------

    def _payload(self, end: ClientEnd) -> tuple[bytes, str]:
        rng, plc = self._rng, end.plc
        choice = rng.random()
        if choice < 0.03:
            return rng.randbytes(rng.choice((0, 1, 13, 14, 22, 40, STATE_SIZE, STATE_SIZE, 1304))), "random"
        if choice < 0.15:
            recorded = self._archive if choice < 0.09 and self._archive else end.recorded
            if recorded:
                return rng.choice(recorded), "replay"
        session = end.link.session if rng.random() < 0.96 else rng.choice((0, end.link.session + 1))
        plc.tick() if rng.random() < 0.5 else None
        base, origin = plc.payload(), "honest"
        if choice < 0.45:
            kept = self.corpus.pick()
            if kept is not None:
                whole = len(kept) == STATE_SIZE and rng.random() < 0.7
                base, origin = plc.restamped(kept, session % (1 << 32)) if whole else kept, "corpus"
        elif choice < 0.53 and self._archive:
            base, origin = plc.restamped(rng.choice(self._archive), session % (1 << 32)), "earlier session"
        if rng.random() < 0.12:
            return base, origin
        donors = [*end.recorded[-8:], *list(self._archive)[-4:]]
        return mutated_state(base, plc.near(end.link.session), donors, rng), origin

    # --- counting -----------------------------------------------------------------------------------------------------

    def _note(self, outcome: Outcome, phase: str, origin: str, datagram: bytes, end: ClientEnd) -> None:
        counts = self.counts
        counts.n += 1
        counts.situations[phase] += 1
        counts.sources[origin] += 1
        counts.exceptions += outcome.raised
        if not outcome.raised:
            name = outcome.kind.value
            setattr(counts, name, getattr(counts, name) + 1)
            if outcome.code:
                counts.codes[RejectCode(outcome.code).name] += 1
        if outcome.problems:
            self._blame("; ".join(outcome.problems), end, datagram)

    def _blame(self, what: str, end: ClientEnd, datagram: bytes) -> None:
        variant = f"{end.phase.name}, eap {end.variant.eap}, key {bool(end.variant.key)}, t {end.t_ns}"
        self.counts.blame(Violation(self.end, what, variant, datagram))


def _counters(end: ClientEnd) -> tuple[int, ...]:
    c = end.link.counters
    return c.sent, c.received, c.lost, c.duplicate_or_late, c.malformed, c.rejected


def _against_verdict(verdict: Verdict, kind: Kind, code: int) -> list[str]:
    codes = {c for c, _ in verdict.may}
    if kind is verdict.kind and (kind is not Kind.REFUSED or code in codes):
        return []
    got = RejectCode(code).name if kind is Kind.REFUSED else kind.value
    return [f"{got}, but the rules say {verdict.kind.value} {[RejectCode(c).name for c in sorted(codes)]}"]


def _against_change(
    kind: Kind, verdict: Verdict, end: ClientEnd, changed: bool, steps: tuple[int, ...], events: list[ClientEvent]
) -> list[str]:
    """What was not taken leads to no event but Dropped, and moves one counter at most."""
    problems = ["events beside the refusal"] if len(events) > 1 else []
    if changed:
        problems.append("changed by what was not taken")
    expected = (0, 0, 0, 0, 1, 0) if kind is Kind.REFUSED else (0, 0, 0, 0 if end.oracle.closed else 1, 0, 0)
    if steps != expected:
        problems.append(f"counters (sent, received, lost, stale, bad, rejected) moved by {steps}")
    return problems
