"""Episodes of fuzzing against the PLC's end: a state is reached, then datagrams come while time goes on."""

from collections import deque
from collections.abc import Hashable
from random import Random

from benchmarks.link.fuzz.corpus import Corpus
from benchmarks.link.fuzz.counts import FuzzCounts
from benchmarks.link.fuzz.coverage import LineTrace
from benchmarks.link.fuzz.frames import framed, sealed
from benchmarks.link.fuzz.mutators import mutated_command, mutated_meaning, mutated_motion
from benchmarks.link.fuzz.plc_check import Outcome, PlcCheck
from benchmarks.link.fuzz.plc_end import SOURCE, VARIANTS, PlcEnd
from benchmarks.link.fuzz.verdict import Violation
from machine.description import Machine
from protocol.codes import Mode, PlcState, RejectCode
from protocol.layout import COMMAND_SIZE

_SEAL_SHARE = 0.8  # of the mutated ones, so that what lies behind the CRC is met
_TRACE_EVERY = 199  # one datagram in this many is run with lines traced
_STRANGERS = (("pc", 50112), ("other", 50111), None)
_TARGETS = (*PlcState, PlcState.HOLD, PlcState.HOLD, PlcState.RUN, PlcState.RUN, PlcState.RUN, PlcState.STOPPING)
_FITTING = {PlcState.LINKED: Mode.ARM, PlcState.FAULT: Mode.RESET, PlcState.LOCAL: Mode.HOLD}  # what is asked there
_AWAY = 25  # datagrams met in another state than the episode's, before a new episode begins


class PlcFuzz:
    """One chunk of datagrams; all that is random comes out of `rng`."""

    end = "plc"

    def __init__(self, machine: Machine, rng: Random, corpus: Corpus) -> None:
        self._machine, self._rng, self.corpus = machine, rng, corpus
        self.counts = FuzzCounts(self.end)
        self._archive: deque[bytes] = deque(maxlen=500)  # honest payloads of earlier sessions
        self._trace = LineTrace()
        self._newest = b""

    def run(self, n: int) -> FuzzCounts:
        """n datagrams, in as many episodes as it takes."""
        while self.counts.n < n:
            self._episode(min(self._rng.choice((60, 150, 300)), n - self.counts.n))
        self.counts.signatures |= self.corpus.signatures
        self.counts.lines |= self._trace.lines
        return self.counts

    def _episode(self, n: int) -> None:
        rng = self._rng
        target = rng.choice(_TARGETS)
        n = min(n, 20) if target in (PlcState.BOOT, PlcState.DISARMED) else n
        end = PlcEnd(self._machine, rng.choice(VARIANTS), rng)
        end.reach(target)
        check, away = PlcCheck(end), 0
        for _ in range(n):
            away = away + 1 if end.state is not target else 0
            if away > _AWAY:
                break
            if self._one(end, check).raised or not self._survives_time(end, check):
                break
        self._archive.extend(end.recorded)
        self.counts.emitted += end.n_states

    def _survives_time(self, end: PlcEnd, check: PlcCheck) -> bool:
        """Whether the PLC goes on: what it has taken must not break its next cycles either."""
        try:
            self._pass_time(end, check)
        except Exception as error:  # any exception at all is the finding
            self.counts.exceptions += 1
            self.counts.blame(Violation(self.end, f"a cycle raised {error!r}", end.state.name, self._newest))
            return False
        return True

    def _pass_time(self, end: PlcEnd, check: PlcCheck) -> None:
        """Mostly none: several datagrams meet the same cycle. Sometimes the honest PC gets a word in."""
        rng = self._rng
        if rng.random() > 0.3 or end.state is PlcState.BOOT:
            return
        silence = rng.random()
        if rng.random() < 0.02:
            end.heal()
        end.pass_time(1200 if silence < 0.0005 else 260 if silence < 0.002 else rng.choice((1, 1, 2, 5)))
        end.look()
        if rng.random() < 0.3 and end.plc.link.session:
            keep_alive = end.state in (PlcState.RUN, PlcState.STOPPING) and not end.oracle.servo
            end.give(end.honest.window() if keep_alive else end.honest.plain(Mode.HEARTBEAT))
        check.moved()

    def _one(self, end: PlcEnd, check: PlcCheck) -> Outcome:
        payload, origin = self._payload(end)
        counts, rng = self.counts, self._rng
        if origin != "replay":
            counts.mutated += 1
            if rng.random() < _SEAL_SHARE:
                payload = sealed(payload, end.variant.key)
                counts.sealed += 1
        datagram = self._newest = framed(payload, end.variant.plc_wire(), rng)
        source: Hashable = SOURCE if rng.random() < 0.97 else rng.choice(_STRANGERS)
        situation = end.state.name
        lines: set[str] = set()
        if counts.n % _TRACE_EVERY == 0:
            trace = LineTrace()
            outcome: Outcome = trace.run(lambda: check.deliver(datagram, source))
            lines = trace.lines
            self._trace.lines |= lines
        else:
            outcome = check.deliver(datagram, source)
        self._note(outcome, situation, origin, datagram, end)
        self.corpus.offer(payload, repr(outcome.signature), lines)
        return outcome

    def _payload(self, end: PlcEnd) -> tuple[bytes, str]:
        """What the next datagram is made of."""
        rng, honest = self._rng, end.honest
        choice = rng.random()
        if choice < 0.03:
            return rng.randbytes(rng.choice((0, 1, 13, 14, 22, 40, 568, COMMAND_SIZE, COMMAND_SIZE, 1450))), "random"
        if choice < 0.15:
            recorded = self._archive if choice < 0.09 and self._archive else end.recorded
            if recorded:
                return rng.choice(recorded), "replay"
        if end.state in (PlcState.HOLD, PlcState.RUN) and rng.random() < 0.5:
            base = self._motion(end)
            return (base if rng.random() < 0.25 else mutated_motion(base, honest.near(), rng)), "honest"
        base, origin = self._honest(end), "honest"
        if choice < 0.45:
            kept = self.corpus.pick()
            if kept is not None:
                whole = len(kept) == COMMAND_SIZE and rng.random() < 0.7
                base, origin = honest.restamped(kept) if whole else kept, "corpus"
        elif choice < 0.53 and self._archive:
            base, origin = honest.restamped(rng.choice(self._archive)), "earlier session"
        how = rng.random()
        if how < 0.12:
            return base, origin
        if how < 0.30 and len(base) == COMMAND_SIZE:
            return mutated_meaning(base, honest.near(), rng), origin
        return mutated_command(base, honest.near(), self._donors(end), rng), origin

    def _donors(self, end: PlcEnd) -> list[bytes]:
        return [*end.recorded[-8:], *list(self._archive)[-4:]]

    def _honest(self, end: PlcEnd) -> bytes:
        """The next payload of a PC that means well."""
        rng, honest = self._rng, end.honest
        if not end.plc.link.session and rng.random() < 0.6:
            return honest.hello()
        fitting = _FITTING.get(end.state)
        if fitting is not None and rng.random() < 0.4:
            return honest.plain(fitting)
        choice = rng.random()
        if choice < 0.6:
            return self._motion(end)
        if choice < 0.7:
            return honest.hello()
        return honest.plain(rng.choice((*Mode, Mode.HEARTBEAT, Mode.HEARTBEAT, Mode.ARM)))

    def _motion(self, end: PlcEnd) -> bytes:
        """Knots or a servo target, as the honest PC would send them now."""
        rng, honest = self._rng, end.honest
        choice = rng.random()
        if end.oracle.servo and end.state is PlcState.RUN and choice < 0.6:
            return honest.servo()
        if choice < 0.45:
            return honest.window(start=rng.random() < 0.85)
        if choice < 0.65:
            return honest.prefill()
        return honest.tail() if choice < 0.85 else honest.servo()

    def _note(self, outcome: Outcome, situation: str, origin: str, datagram: bytes, end: PlcEnd) -> None:
        counts = self.counts
        counts.n += 1
        counts.situations[situation] += 1
        counts.sources[origin] += 1
        counts.exceptions += outcome.raised
        if not outcome.raised:
            name = outcome.kind.value
            setattr(counts, name, getattr(counts, name) + 1)
            if outcome.code:
                counts.codes[RejectCode(outcome.code).name] += 1
        if outcome.problems:
            variant = f"{situation}, eap {end.variant.eap}, key {bool(end.variant.key)}, t {end.t_ns}"
            counts.blame(Violation(self.end, "; ".join(outcome.problems), variant, datagram))
