"""Parts of the delivered link by themselves: CRC-32, SHA-256, HMAC, self-check, readings that are no numbers, MAIN."""

import hashlib
import hmac
import zlib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from st_harness import MACHINE, MS, TABLE, state_fields
from st_plc import CLOCK, RECEIVERS, DeliveredPlc, delivered, delivered_program, sample_bytes, use_key
from st_program import load_program

from protocol import layout
from protocol.codec import decode_state, encode_command
from protocol.codes import FaultBit, HeaderFlag, Mode, PlcState, RejectCode, WarnBit
from protocol.limits import cfg_id
from protocol.messages import Command
from sim_plc.plc.sample import PlantSample

VECTORS = Path(__file__).parents[1] / "vectors"
T0 = 5_000 * MS
TICK = 10 * MS


def hello(seq=1, session=9, key=b"", **fields):
    return encode_command(Command(session, seq, t_send_ns=seq, hello=True, cfg_id=cfg_id(TABLE), **fields), key)


def heartbeat(seq, session=9, mode=Mode.HEARTBEAT, key=b"", **fields):
    return encode_command(Command(session, seq, t_send_ns=seq, mode=mode, cfg_id=cfg_id(TABLE), **fields), key)


def sample(**changes):
    zeros = np.zeros(6)
    whole = PlantSample(np.deg2rad([10.0, 40.0, -80.0, 5.0, -40.0, 3.0]), zeros, zeros, zeros, 19e6, 40.0)
    return replace(whole, **changes)


def state_of(plc, t_ns, key=b""):
    return decode_state(plc.build_state(t_ns), key)


# --- sums and tags --------------------------------------------------------------------------------------------------


def test_crc_32_is_the_usual_one():
    crc = delivered_program().function("F_HmCrc32")
    rng = np.random.default_rng(1)
    assert crc(b"123456789", 9) == 0xCBF43926
    for length in (0, 1, 2, 3, 31, 564, 1300):
        data = rng.bytes(length)
        assert crc(data or b"\0", length) == zlib.crc32(data)


@pytest.mark.parametrize("length", [0, 1, 3, 55, 56, 57, 63, 64, 65, 119, 120, 128, 544, 1280])
def test_sha_256_at_every_edge_of_its_padding(length):
    data = np.random.default_rng(length).bytes(length)
    block = delivered_program().new("FB_HmSha256")
    half = length // 2
    block.method("Start")
    block.method("Append", data[:half] or b"\0", half)
    block.method("Append", data[half:] or b"\0", length - half)
    block.method("Finish")
    assert bytes(block.aDigest) == hashlib.sha256(data).digest()


@pytest.mark.parametrize("key_length", [16, 31, 32, 63, 64])
def test_hmac_with_every_kind_of_key(key_length):
    rng = np.random.default_rng(key_length)
    key, data = rng.bytes(key_length), rng.bytes(544)
    program = delivered_program()
    use_key(program, key)
    block = program.new("FB_HmHmac")
    block.method("Sign", data, len(data))
    tag = hmac.new(key, data, hashlib.sha256).digest()[:16]
    assert bytes(block.aTag) == tag
    assert block.method("IsAuthentic", data, len(data), tag) is True
    for at in range(16):
        wrong = bytes(byte ^ (i == at) for i, byte in enumerate(tag))
        assert block.method("IsAuthentic", data, len(data), wrong) is False
    use_key(program, b"")


@pytest.mark.parametrize(
    ("bits", "finite"),
    [
        (0x0000_0000_0000_0000, True),
        (0x7FEF_FFFF_FFFF_FFFF, True),
        (0x7FF0_0000_0000_0000, False),
        (0xFFF0_0000_0000_0000, False),
        (0x7FF8_0000_0000_0000, False),
        (0x7FF0_0000_0000_0001, False),
        (0xFFFF_FFFF_FFFF_FFFF, False),
    ],
)
def test_numbers_are_told_by_their_exponent_bits(bits, finite):
    assert delivered_program().function("F_HmIsFinite")(bits) is finite


# --- golden bytes ----------------------------------------------------------------------------------------------------


def golden(name):
    """The bytes of a vector: `offset: bytes # meaning`; LAYOUT and CRC are put in, bytes not listed are 0."""
    lines = (VECTORS / name).read_text(encoding="utf-8").splitlines()
    body = bytearray(int(lines[0].split()[-1]))
    for line in lines[1:]:
        at, _, rest = line.split("#")[0].partition(":")
        if rest.strip() == "LAYOUT":
            body[int(at) : int(at) + 4] = layout.LAYOUT_ID.to_bytes(4, "little")
        elif rest.strip() == "CRC":
            body[-4:] = zlib.crc32(bytes(body[:-4])).to_bytes(4, "little")
        elif rest.strip():
            part = bytes.fromhex(rest)
            body[int(at) : int(at) + len(part)] = part
    return bytes(body)


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("hmlink1_command.txt", b""),
        ("hmlink1_hello.txt", b""),
        ("hmlink11_servo_signed.txt", b""),
        ("hmlink11_servo_signed.txt", bytes(range(32))),
    ],
)
def test_golden_commands_are_sound_to_the_delivered_link(name, key):
    program = delivered_program()
    use_key(program, key)
    link = program.new("FB_HmLink")
    payload = program.new_union("U_HmCmd", golden(name))
    assert link.method("Decode", payload, layout.COMMAND_SIZE) == RejectCode.NONE
    use_key(program, b"")


@pytest.mark.parametrize("name", ["hmlink1_state.txt", "hmlink11_state_signed.txt"])
def test_golden_states_have_their_fields_where_the_delivered_struct_has_them(name):
    found = delivered_program().new_union("U_HmState", golden(name))
    for field, value in state_fields(golden(name)).items():
        member, _, index = field.rstrip("]").partition("[")
        have = getattr(found.m, member)
        have = bytes(have) if isinstance(value, bytes) else have[int(index)] if index else have
        assert have == value, field


# --- self-check ------------------------------------------------------------------------------------------------------


def test_the_self_check_passes_and_finds_the_cfg_id_of_the_pc():
    block = delivered_program().new("FB_HmSelfCheck")
    assert block.method("Run") is True
    assert block.nCfgId == cfg_id(TABLE)
    assert all((block.bSizesOk, block.bCmdOk, block.bStateOk, block.bCrcOk, block.bCfgOk))


@pytest.mark.parametrize(
    ("file", "old", "new", "part"),
    [
        ("GVLs/GVL_HmMachine.TcGVL", f"16#{cfg_id(TABLE):X}", f"16#{cfg_id(TABLE) ^ 1:X}", "bCfgOk"),
        ("GVLs/GVL_HmLayout.TcGVL", "CMD_CRC : UDINT := 1300", "CMD_CRC : UDINT := 1296", "bCmdOk"),
        ("GVLs/GVL_HmLayout.TcGVL", "OFS_SEQ : UDINT := 20", "OFS_SEQ : UDINT := 24", "bCmdOk"),
        ("GVLs/GVL_HmLayout.TcGVL", "STATE_TAG : UDINT := 544", "STATE_TAG : UDINT := 540", "bStateOk"),
        ("GVLs/GVL_HmLayout.TcGVL", "STATE_SIZE : UDINT := 568", "STATE_SIZE : UDINT := 560", "bSizesOk"),
        ("POUs/F_HmCrc32.TcPOU", "16#EDB8_8320", "16#EDB8_8321", "bCrcOk"),
    ],
)
def test_a_wrong_program_latches_the_layout_fault_and_never_arms(file, old, new, part):
    files = {**delivered(), "GETCPUCOUNTER.st": CLOCK.encode()}
    text = files[file].decode()
    assert old in text
    files[file] = text.replace(old, new).encode()
    program = load_program(files, RECEIVERS)
    block = program.new("FB_HmPlc", bEnableAuto=True)
    readings = program.new_union("U_HmSample", sample_bytes(sample()))
    for tick in range(3):
        block.method("Cycle", readings, nNowNs=T0 + tick * TICK)
    assert block.bLayoutOk is False
    assert getattr(block.fbSelfCheck, part) is False
    assert block.ePlcState == PlcState.FAULT
    assert block.fbMonitor.nLatched == FaultBit.LAYOUT
    assert block.method("IsFaultPresent") is True  # so RESET is refused


# --- the link --------------------------------------------------------------------------------------------------------


def test_a_dry_run_plays_with_the_valves_closed_and_says_so():
    plc = DeliveredPlc(dry_run=True)
    plc.cycle(sample(), T0)
    plc.receive(hello(), 1, T0)
    state = state_of(plc, T0)
    assert state.flags & HeaderFlag.DRY_RUN
    assert state.session == 9
    assert plc.peer() == 1


def test_a_refused_sender_is_answered_unless_it_is_the_peer_or_no_pc_of_this_link():
    plc = DeliveredPlc()
    plc.cycle(sample(), T0)
    old = hello(session=8)
    old = old[:4] + bytes([old[4] + 1]) + old[5:]
    cases = (
        (old, 2, True),  # wrong version, while nobody is in session
        (hello(), 1, False),  # taken
        (hello(session=8), 2, True),  # refused: 1 has the session
        (hello(session=8), 1, False),  # the peer gets the state anyway
        (old[:567], 2, False),  # shorter than the answer
        (plc.build_state(T0) + bytes(layout.COMMAND_SIZE - layout.STATE_SIZE), 2, False),  # another PLC's
    )
    for payload, source, answered in cases:
        plc.receive(payload, source, T0)
        assert plc.answers() is answered
    plc.receive(hello(session=8), 2, T0)
    state = state_of(plc, T0)
    assert (state.session, state.reject_code) == (9, RejectCode.SESSION)


def test_without_a_key_tags_are_ignored_and_with_one_they_are_demanded():
    key = bytes(range(16))
    plc = DeliveredPlc()
    plc.cycle(sample(), T0)
    plc.receive(hello(key=key), 1, T0)
    assert state_of(plc, T0).session == 9
    plc = DeliveredPlc(key=key)
    plc.cycle(sample(), T0)
    plc.receive(hello(), 1, T0)
    state = state_of(plc, T0, key)
    assert (state.session, state.reject_code, state.reject_offset) == (0, RejectCode.AUTH, 1280)
    plc.receive(hello(key=key), 1, T0)
    assert state_of(plc, T0, key).session == 9
    use_key(delivered_program(), b"")


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_readings_that_are_no_numbers_never_reach_the_arithmetic(value):
    plc = DeliveredPlc()
    wrong = sample(
        q_rad=np.full(6, value), qd_rad_s=np.full(6, value), p_a_pa=np.full(6, value), p_b_pa=np.full(6, value),
        p_supply_pa=value, p_tank_pa=value, t_oil_c=value,
    )  # fmt: skip
    for tick in range(3):
        valves = plc.cycle(wrong, T0 + tick * TICK)
        assert valves == (0.0,) * 8
    state = state_of(plc, T0)  # decoding refuses what is not finite
    assert state.plc_state is PlcState.FAULT
    assert state.fault_bits == FaultBit.SENSOR
    assert state.warn_bits & WarnBit.PRESSURE
    assert (state.p_supply, state.p_tank, state.t_oil, state.q, state.p_a) == (0.0, 0.0, 0.0, (0.0,) * 8, (0.0,) * 8)


def test_the_arm_nonce_changes_on_every_disarming_even_when_the_entropy_does_not():
    link = delivered_program().new("FB_HmLink")
    seen = []
    for entropy in (0, 0, 0, 7, 7, 7, 0xFFFF_FFFF, 0xFFFF_FFFF, 0):
        link.nEntropy = entropy
        link.method("DrawNonce")
        seen.append(link.nNonce)
    assert 0 not in seen
    assert all(a != b for a, b in pairwise(seen))


@pytest.mark.parametrize(("share", "is_wrong"), [(1.0, False), (1.2, False), (2.0, True), (0.5, True)])
def test_a_task_of_another_cycle_is_a_fault_that_no_reset_clears(share, is_wrong):
    block = delivered_program().new("FB_HmPlc", bEnableAuto=True)
    readings = delivered_program().new_union("U_HmSample", sample_bytes(sample()))
    cycle_ns = round(share * delivered_program().globals("GVL_HmMachine").CYCLE_NS)
    for tick in range(102):
        block.method("Cycle", readings, nNowNs=T0 + tick * cycle_ns)
        assert block.bLayoutOk is (tick < 100 or not is_wrong)
    assert (block.ePlcState == PlcState.FAULT) is is_wrong
    assert block.method("IsFaultPresent") is is_wrong


def test_cycles_that_jitter_are_no_other_cycle():
    block = delivered_program().new("FB_HmPlc", bEnableAuto=True)
    readings = delivered_program().new_union("U_HmSample", sample_bytes(sample()))
    cycle_ns = delivered_program().globals("GVL_HmMachine").CYCLE_NS
    t_ns = T0
    for tick in range(400):
        t_ns += cycle_ns * (2 if tick % 50 else 1)
        block.method("Cycle", readings, nNowNs=t_ns)
    assert block.bLayoutOk is True


def test_a_key_counts_only_while_the_panel_is_read():
    """Inputs that come up late, or come back, show a key that was left on as one that was turned."""
    block = delivered_program().new("FB_HmPlc", bEnable=False)

    def may_arm(valid, enable):
        block.set(bPanelValid=valid, bEnable=enable)
        block.method("ReadPanel")
        return block.method("MayArm")

    for _ in range(3):
        assert not may_arm(False, False)
    assert not may_arm(True, True)  # left on
    assert not may_arm(True, False)
    assert may_arm(True, True)  # turned
    assert may_arm(True, True)
    assert not may_arm(False, False)
    assert not may_arm(True, True)


@pytest.mark.parametrize(("valid", "enable", "bits"), [(True, True, 0), (True, False, 2), (False, True, 2)])
def test_a_panel_that_is_no_longer_read_stops_what_is_armed(valid, enable, bits):
    block = delivered_program().new("FB_HmPlc", bPanelValid=valid, bEnable=enable)
    assert block.method("OwnFaults", nNowNs=T0) == 0
    block.fbLink.ePlcState = PlcState.HOLD
    assert block.method("OwnFaults", nNowNs=T0) == bits
    assert FaultBit.LOCAL_ENABLE_LOST == 2


# --- MAIN: process image in, process image out -----------------------------------------------------------------------


class Task:
    """MAIN with the EAP process image in the test's hands."""

    def __init__(self):
        files = {**delivered(), "GETCPUCOUNTER.st": CLOCK.encode()}
        self.program = load_program(files, RECEIVERS)
        self.main = self.program.new("MAIN")
        self.io = self.program.globals("GVL_HmIo")
        self.t_ns = T0
        self._rx = self.program.new_union("U_HmCmd")
        self._sample = self.program.new_union("U_HmSample", sample_bytes(sample()))
        self._out = self.program.new_union("U_HmState")
        self.io.stSample = self._sample.m
        self.run()  # out of BOOT: a HELLO is refused before

    def publish(self, payload, index):
        self._rx.bytes = payload
        self.io.stCmd = self._rx.m
        self.io.nCmdCycleIndex = index

    def run(self, ticks=1):
        for _ in range(ticks):
            self.t_ns += TICK
            counter = self.t_ns // 100
            self.main.fbClock.cpuCntLoDW = counter % 2**32
            self.main.fbClock.cpuCntHiDW = counter >> 32
            self.main.call()

    @property
    def payload(self):
        self._out.m.st_set(self.io.stState)
        return bytes(self._out.bytes)

    @property
    def state(self):
        return decode_state(self.payload)


def test_main_takes_a_datagram_once_and_a_frozen_process_image_feeds_nothing():
    task = Task()
    task.run(3)
    assert task.payload == bytes(layout.STATE_SIZE)  # nobody has said HELLO
    task.publish(hello(seq=40), 40)
    task.run()
    assert (task.state.session, task.state.plc_state, task.state.rx_ok) == (9, PlcState.LINKED, 1)
    task.run(10)
    assert (task.state.rx_ok, task.state.rx_dup, task.state.rx_age_us) == (1, 0, 100_000)
    task.publish(heartbeat(41), 41)
    task.run()
    assert (task.state.rx_ok, task.state.ack_seq) == (2, 41)
    task.publish(heartbeat(41), 42)  # the same telegram, published again
    task.run()
    assert (task.state.rx_ok, task.state.rx_dup) == (2, 1)
    task.run(110)
    assert (task.state.session, task.state.plc_state) == (0, PlcState.DISARMED)
    assert task.main.nTaken == 3


def test_main_boots_in_a_dry_run_and_wants_the_key():
    task = Task()
    task.publish(hello(), 1)
    task.run()
    assert task.state.flags == HeaderFlag.DRY_RUN
    task.io.bDryRun = False
    for seq in range(2, 30):
        task.publish(heartbeat(seq), seq)
        task.run()
    assert task.state.flags == HeaderFlag(0)

    def arm(seq):
        echo = {"arm_nonce": task.state.nonce, "t_plc_echo_ns": task.state.t_send_ns}
        task.publish(heartbeat(seq, mode=Mode.ARM, **echo), seq)
        task.run()

    arm(30)
    assert task.state.reject_code == RejectCode.ENABLE
    task.io.bEnable = True  # while nobody has told MAIN how it knows that the panel is read
    task.run()
    arm(31)
    assert (task.state.plc_state, task.state.reject_code) == (PlcState.LINKED, RejectCode.ENABLE)
    for task.io.bPanelValid, task.io.bEnable in ((True, False), (True, True)):
        task.run()
    arm(32)
    assert task.state.plc_state is PlcState.HOLD
    task.io.bEnable = False
    task.run()
    assert task.state.fault_bits == FaultBit.LOCAL_ENABLE_LOST


def test_main_tells_the_pc_of_a_telegram_that_twincat_has_refused():
    task = Task()
    task.publish(hello(), 1)
    task.run()
    task.io.nCmdVarState = 1
    task.publish(heartbeat(2), 2)
    task.run(3)
    assert (task.state.reject_code, task.state.reject_count, task.state.rx_ok) == (RejectCode.EAP_HEADER, 1, 1)
    task.io.nCmdVarState = 0
    task.run()
    assert task.state.rx_ok == 2


def test_main_counts_the_telegrams_it_never_saw():
    task = Task()
    task.publish(hello(seq=1), 1)
    task.run()
    task.publish(heartbeat(5), 5)
    task.run()
    assert (task.main.nTelegramsMissed, task.state.rx_lost) == (3, 3)


def test_nonces_come_from_a_clock_that_nobody_sets():
    task = Task()
    nonces = set()
    for session in range(5):
        task.publish(hello(session=session + 1, seq=session * 7 + 1), session * 7 + 1)
        task.run()
        nonces.add(task.state.nonce)
        task.run(105)
    assert len(nonces) == 5


def test_the_machine_of_the_tests_is_the_machine_of_the_program():
    machine = delivered_program().globals("GVL_HmMachine")
    assert round(MACHINE.plc_cycle_s * 1e9) == machine.CYCLE_NS
    assert tuple(machine.Q_MIN)[:6] == tuple(joint.q_min_rad for joint in MACHINE.joints)


def test_a_dry_run_ends_with_the_next_disarming_only():
    """After a dry motion the reference stands elsewhere: valves that open then would drive the joints there."""
    block = DeliveredPlc(dry_run=True).block
    free = block.fbMotion.eMotion
    told = []
    for dry, motion in ((True, free), (False, free), (True, free + 1), (False, free + 1), (False, free)):
        block.set(bDryRun=dry)
        block.fbMotion.eMotion = motion
        block.method("ReadPanel")
        told.append(bool(block.bDryActive))
        assert bool(block.fbLink.bDryRun) is told[-1]
    assert told == [True, False, True, True, False]
