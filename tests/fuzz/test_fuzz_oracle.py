"""The oracles against the golden bytes and against numbers known otherwise; mutators and snapshots by themselves."""

import struct
import zlib
from importlib.resources import files
from pathlib import Path
from random import Random

import numpy as np
import pytest

from benchmarks.link.fuzz import oracle_knots
from benchmarks.link.fuzz.frames import sealed
from benchmarks.link.fuzz.mutators import mutated_bytes, mutated_command, mutated_state, with_value
from benchmarks.link.fuzz.oracle_bytes import Subscription, command_breach, state_breach, unframed
from benchmarks.link.fuzz.oracle_fields import KnotFields, command_fields, state_fields
from benchmarks.link.fuzz.picture import picture
from benchmarks.link.fuzz.plc_end import VARIANTS, PlcEnd
from benchmarks.link.fuzz.verdict import Breach
from machine.description import parse_machine_toml
from protocol.codes import PlcState, RejectCode
from protocol.limits import AxisLimits, LimitTable

VECTORS = Path(__file__).parents[1] / "vectors"
KEY = bytes(range(32))
NAN = 0x7FF8_0000_0000_0001
TABLE = LimitTable((AxisLimits("slew", -2.0, 2.5, 0.5, 2.0),))


def golden(name: str) -> bytes:
    """A file of tests/vectors; its README says how they are read."""
    first, *lines = (VECTORS / name).read_text(encoding="utf-8").splitlines()
    data = bytearray(int(first.split()[-1]))
    for line in lines:
        offset, _, rest = line.partition(":")
        token, at = rest.split("#")[0].strip(), int(offset)
        if token == "CRC":
            data[at:] = zlib.crc32(bytes(data[:at])).to_bytes(4, "little")
        elif token.startswith("VECTOR"):
            data[at:] = golden(token.split()[1])
        else:
            value = bytes.fromhex("02 a8 60 ae" if token == "LAYOUT" else token)
            data[at : at + len(value)] = value
    return bytes(data)


@pytest.mark.parametrize("name", ["hmlink1_command.txt", "hmlink1_hello.txt", "hmlink11_servo_signed.txt"])
def test_the_oracle_takes_the_golden_commands(name: str) -> None:
    key = KEY if "signed" in name else b""
    assert command_breach(golden(name), key) is None
    assert command_breach(golden(name), bytes(32)) == Breach(RejectCode.AUTH, 1280)


@pytest.mark.parametrize("name", ["hmlink1_state.txt", "hmlink11_state_signed.txt"])
def test_the_oracle_takes_the_golden_states(name: str) -> None:
    key = KEY if "signed" in name else b""
    assert state_breach(golden(name), key) is None
    assert state_breach(golden(name), bytes(32)) == Breach(RejectCode.AUTH, 544)


def test_the_oracle_reads_the_golden_fields() -> None:
    command = command_fields(golden("hmlink1_command.txt"))
    assert (command.session, command.seq, command.mode, command.traj_id) == (0xDEADBEEF, 42, 3, 5)
    assert (command.knot_first, command.knot_count, command.speed_override) == (12, 2, 0.5)
    assert (command.knots[0][0], command.knots[0][1][:2], command.knots[1][1][5]) == (50_000_000, (1.0, -2.0), 3.0)
    assert state_fields(golden("hmlink1_state.txt")).session == 0xDEADBEEF
    assert command_fields(golden("hmlink1_hello.txt")).hello


@pytest.mark.parametrize("direction", ["command", "state"])
def test_the_oracle_unwraps_the_golden_frames(direction: str) -> None:
    frame, payload = golden(f"hmlink1_eap_{direction}.txt"), golden(f"hmlink1_{direction}.txt")
    eap = Subscription(frame[2:8], int.from_bytes(frame[14:16], "little"))
    assert unframed(frame, eap) == payload
    assert unframed(payload, None) == payload
    for offset in (0, 1, 2, 8, 14, 16):
        broken = with_value(frame, offset, 1, frame[offset] ^ 1)
        assert unframed(broken, eap) == Breach(RejectCode.EAP_HEADER, 0)


def test_the_oracle_finds_every_changed_byte_of_a_command() -> None:
    payload = golden("hmlink1_command.txt")
    early = {0: 3, 1: 3, 2: 3, 3: 3, 4: 4, 7: 2, 8: 2, 9: 2, 12: 5, 13: 5, 14: 5, 15: 5}  # before the CRC is looked at
    for offset in range(1304):
        breach = command_breach(with_value(payload, offset, 1, payload[offset] ^ 0x10), b"")
        assert breach is not None
        assert breach.code == early.get(offset, 6), offset


def test_the_oracle_names_the_place_of_every_number_that_is_not_finite() -> None:
    payload = golden("hmlink1_command.txt")
    places = [72, *(80 + 200 * k + 8 + 8 * i for k in range(6) for i in range(24))]
    for at in places:
        breach = command_breach(sealed(with_value(payload, at, 8, NAN), b""), b"")
        assert breach == Breach(RejectCode.NOT_FINITE, at)
    times = [80 + 200 * k for k in range(6)]
    assert all(command_breach(sealed(with_value(payload, at, 8, NAN), b""), b"") is None for at in times)


def knot(t_ms: int, q: float, qd: float = 0.0, qdd: float = 0.0) -> KnotFields:
    rest = (0.0,) * 7
    return t_ms * 1_000_000, (q, *rest), (qd, *rest), (qdd, *rest)


def test_the_peaks_are_those_of_the_quintic() -> None:
    """Against the polynomial that numpy solves for from the six conditions, looked at in very many points."""
    rng = Random(3)
    for _ in range(50):
        T = rng.choice((0.005, 0.05, 0.2))
        a, b = ([rng.uniform(-1, 1) for _ in range(3)] for _ in range(2))
        powers = np.eye(6)
        rows = [np.polyval(np.polyder(powers[k][::-1], d), x) for x in (0.0, T) for d in range(3) for k in range(6)]
        c = np.polynomial.Polynomial(np.linalg.solve(np.array(rows).reshape(6, 6), np.array([*a, *b])))
        qd, qdd = oracle_knots.peaks(knot(0, *a), knot(0, *b), 0, T)
        assert qd == pytest.approx(np.abs(c.deriv(1)(np.arange(1, 8) / 8.0 * T)).max(), rel=1e-5)
        everywhere = np.abs(c.deriv(2)(np.linspace(0.0, T, 20_001))).max()
        assert max(qdd, abs(a[2]), abs(b[2])) == pytest.approx(everywhere, rel=1e-5)


def test_the_oracle_is_sure_past_a_limit_and_not_on_it() -> None:
    def found(q: float, qd: float = 0.0, qdd: float = 0.0) -> list[tuple[str, int, bool]]:
        breaches = oracle_knots.one_knot(knot(0, q, qd, qdd), 1, TABLE, 1.10)
        return [(breach.code.name, breach.offset, breach.sure) for breach in breaches]

    assert found(1.0, 0.49, 1.9) == []
    assert found(0.0, 0.5) == [("LIMIT_QD", 352, False)]
    assert found(0.0, 0.501) == [("LIMIT_QD", 352, True)]
    assert found(0.0, 0.0, -2.01) == [("LIMIT_QDD", 416, True)]
    assert found(2.6)[0] == ("LIMIT_Q", 288, True)
    assert found(2.49, 0.4) == [("LIMIT_Q", 288, True)]  # in range, but there is no room to stop: 2.49 + 0.4^2 / 4.4
    assert found(2.49, -0.4) == []


def test_a_picture_shows_whatever_changes() -> None:
    machine = parse_machine_toml((files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8"))
    end = PlcEnd(machine, VARIANTS[0], Random(8))
    end.reach(PlcState.RUN)
    plc = end.plc
    before = picture(plc)
    assert picture(plc) == before
    for change in (
        lambda: setattr(plc.link._session, "accepted_ns", plc.link._session.accepted_ns + 1),
        lambda: setattr(plc.link, "nonce", plc.link.nonce + 1),
        lambda: plc.ring.knots.__setitem__((3, 1, 0), 0.5),
        lambda: setattr(plc.ring, "end", plc.ring.end + 1),
        lambda: plc.reference.q.__setitem__(2, plc.reference.q[2] + 1e-12),
        lambda: setattr(plc.reference.servo, "ending", not plc.reference.servo.ending),
        lambda: setattr(plc.panel, "lever_taken", True),
        lambda: setattr(plc.monitor, "latched", plc.monitor.latched | 4),
    ):
        change()
        after = picture(plc)
        assert after != before
        before = after


def test_mutators_take_any_bytes_and_repeat_themselves() -> None:
    rng, again = Random(4), Random(4)
    for size in (0, 1, 13, 79, 80, 568, 1303, 1304, 1305):
        for _ in range(40):
            data, same = rng.randbytes(size), again.randbytes(size)
            for mutate in (mutated_command, mutated_state):
                assert mutate(data, {}, [data], rng) == mutate(same, {}, [same], again)
            assert mutated_bytes(data, (), rng) == mutated_bytes(same, (), again)


def test_what_is_sealed_is_sound_again() -> None:
    payload = golden("hmlink1_command.txt")
    changed = with_value(payload, 72, 8, struct.unpack("<Q", struct.pack("<d", 0.25))[0])
    assert command_breach(changed, b"") == Breach(RejectCode.CRC, 1300)
    assert command_breach(sealed(changed, b""), b"") is None
    assert command_breach(sealed(changed, KEY), KEY) is None
