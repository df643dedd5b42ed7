"""A slice of the fuzzing of both ends, and bugs planted on purpose: the oracles must find each of them.

The whole run is `longreach bench fuzz`.
"""

import struct
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from typing import Any

import pytest

from benchmarks.link.fuzz.counts import FuzzCounts, counts_from_json
from benchmarks.link.fuzz.engine import End, fuzz_chunk
from benchmarks.link.fuzz.frames import sealed
from machine.description import parse_machine_toml
from protocol import client_link, framing, plc_link
from protocol.codec import decode_command
from protocol.codes import PlcState, RejectCode
from protocol.gate import GateVerdict
from protocol.plc_link import PlcLink
from protocol.sequence import SequenceKind, classify_sequence
from sim_plc.plc import knot_checks, knot_ring

MACHINE = parse_machine_toml((files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def plc_end() -> FuzzCounts:
    return fuzz_chunk("plc", MACHINE, "slice", 2500)[0]


@pytest.fixture(scope="module")
def client_end() -> FuzzCounts:
    return fuzz_chunk("client", MACHINE, "slice", 3000)[0]


def test_the_plc_end_breaks_no_rule(plc_end: FuzzCounts) -> None:
    assert (plc_end.exceptions, plc_end.violations, plc_end.evidence) == (0, 0, [])


def test_the_client_end_breaks_no_rule(client_end: FuzzCounts) -> None:
    assert (client_end.exceptions, client_end.violations, client_end.evidence) == (0, 0, [])


@pytest.mark.slow  # four times the slice of the two tests above; millions of datagrams: `longreach bench fuzz`
@pytest.mark.parametrize(("end", "n"), [("plc", 8000), ("client", 10000)])
def test_a_longer_slice_breaks_no_rule(end: End, n: int) -> None:
    counts = fuzz_chunk(end, MACHINE, "slice", n)[0]
    assert (counts.exceptions, counts.violations, counts.evidence) == (0, 0, [])


def test_the_slice_goes_deep(plc_end: FuzzCounts, client_end: FuzzCounts) -> None:
    """Half is sealed again, every state and phase is met, and most refusals are seen."""
    for counts in (plc_end, client_end):
        assert counts.sealed >= counts.n // 2
        assert min(counts.taken, counts.silent, counts.refused) > counts.n // 50
        assert len(counts.situations) == len(PlcState)
        assert set(counts.sources) == {"honest", "corpus", "replay", "earlier session", "random"}
    assert len(plc_end.codes) >= 30
    assert len(client_end.codes) >= 11
    assert client_end.emitted > 1000


def test_a_chunk_comes_out_the_same_and_survives_as_json() -> None:
    first, found = fuzz_chunk("plc", MACHINE, "again", 300)
    second, found_again = fuzz_chunk("plc", MACHINE, "again", 300)
    assert first.as_json() == second.as_json()
    assert found == found_again
    assert counts_from_json(first.as_json()).as_json() == first.as_json()
    more = fuzz_chunk("plc", MACHINE, "more", 300, found, frozenset(first.signatures))[0]
    first.add(more)
    assert first.n == 600
    assert more.signatures <= first.signatures


# --- planted bugs -----------------------------------------------------------------------------------------------------


def no_crc(monkeypatch: pytest.MonkeyPatch) -> None:
    def decode(payload: bytes, key: bytes = b"") -> Any:
        return decode_command(sealed(payload, b""), key) if len(payload) == 1304 else decode_command(payload, key)

    monkeypatch.setattr(plc_link, "decode_command", decode)


def repetition_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    def classify(last: int, seq: int) -> Any:
        verdict = classify_sequence(last, seq)
        late = verdict.kind in (SequenceKind.DUPLICATE, SequenceKind.LATE)
        return replace(verdict, kind=SequenceKind.NEXT) if late else verdict

    monkeypatch.setattr(plc_link, "classify_sequence", classify)


def blind_pc_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PlcLink, "_check_echo", lambda *arguments: None)


def any_nonce_arms(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PlcLink, "_check_arm", lambda *arguments: None)


def no_joint_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(knot_ring, "check_knot", lambda *arguments: None)


def wrong_place(monkeypatch: pytest.MonkeyPatch) -> None:
    right = knot_checks.object_to_knot
    monkeypatch.setattr(knot_checks, "object_to_knot", lambda code, k, field, j=0: right(code, k + 1, field, j))


def refusal_feeds_the_watchdog(monkeypatch: pytest.MonkeyPatch) -> None:
    refuse = PlcLink._refuse

    def feeding(self: PlcLink, error: Any, seq: int, source: Any, t_plc_ns: int) -> Any:
        self._session.accepted_ns = t_plc_ns
        return refuse(self, error, seq, source, t_plc_ns)

    monkeypatch.setattr(PlcLink, "_refuse", feeding)


def short_frame_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    unwrap = framing.unwrap_eap

    def careless(datagram: bytes, *arguments: Any) -> bytes:
        struct.unpack_from("<H6sHHBB", datagram)
        return unwrap(datagram, *arguments)

    monkeypatch.setattr(framing, "unwrap_eap", careless)


def old_states_count(monkeypatch: pytest.MonkeyPatch) -> None:
    def classify(last: int, seq: int) -> Any:
        return replace(classify_sequence(last, seq), kind=SequenceKind.NEXT)

    monkeypatch.setattr(client_link, "classify_sequence", classify)


def open_gate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_link, "gate", lambda command, view, table: GateVerdict(command))


PLANTED: tuple[tuple[End, Callable[[pytest.MonkeyPatch], None], str], ...] = (
    ("plc", no_crc, "taken, but the rules say refused CRC@1300"),
    ("plc", repetition_counts, "taken, but the rules say silent"),
    ("plc", blind_pc_moves, "taken, but the rules say refused ECHO_STALE@40"),
    ("plc", any_nonce_arms, "taken, but the rules say refused NONCE@32"),
    ("plc", no_joint_limits, "but the rules say refused LIMIT_QD"),
    ("plc", wrong_place, "but the rules say refused LIMIT_Q"),
    ("plc", refusal_feeds_the_watchdog, "changed by what was not taken"),
    ("plc", short_frame_raises, "raised error("),
    ("client", old_states_count, "taken, but the rules say silent"),
    ("client", open_gate, "sent SERVO with IMPLIED_SPEED"),
)


@pytest.mark.parametrize(("end", "plant", "what"), PLANTED, ids=lambda value: getattr(value, "__name__", None))
def test_a_planted_bug_is_found(
    end: End, plant: Callable[[pytest.MonkeyPatch], None], what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(monkeypatch)
    for chunk in range(20):
        counts = fuzz_chunk(end, MACHINE, f"planted {chunk}", 500)[0]
        if any(what in text for text in counts.evidence):
            return
    pytest.fail(f"{what}: not found in 10,000 datagrams")


def test_the_codes_that_the_oracle_uses_have_their_numbers() -> None:
    """The oracle names codes by the enumeration; here they are once by number, as the documentation lists them."""
    numbers = {"EAP_HEADER": 1, "LENGTH": 2, "CRC": 6, "AUTH": 7, "SESSION": 12, "ECHO_STALE": 14, "TRAJ_ID": 41}
    assert {name: int(RejectCode[name]) for name in numbers} == numbers
