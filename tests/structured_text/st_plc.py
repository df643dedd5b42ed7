"""The delivered PLC program in the runner: the files as exported, and FB_HmPlc for the harness."""

import struct
from functools import cache
from importlib.resources import files

from st_harness import MACHINE
from st_program import Program, load_program

from longreach.export_command import plc_parameters
from machine.description import Machine
from protocol.layout import COMMAND_SIZE
from protocol.twincat.bundle import project
from sim_plc.plc.sample import PlantSample

RECEIVERS = ("FB_HmUdpTf6310", "FB_HmUdpTf6311")  # they use libraries of TwinCAT's: parsed, not run
CLOCK = """
FUNCTION_BLOCK GETCPUCOUNTER
VAR_OUTPUT
    cpuCntLoDW : UDINT;
    cpuCntHiDW : UDINT;
END_VAR
END_FUNCTION_BLOCK
"""  # stands in for Tc2_System's: the test sets the counter
_SAMPLE = struct.Struct("<16d20f")


def delivered(machine: Machine = MACHINE) -> dict[str, bytes]:
    """Every file of the export for a machine, by its path."""
    folder = files("protocol") / "twincat" / "pou"
    sources = {p.name: p.read_text(encoding="utf-8") for p in folder.iterdir() if p.name.endswith(".st")}
    return project(plc_parameters(machine, "192.168.0.1.1.1", "192.168.0.2.1.1"), sources)


@cache
def delivered_program() -> Program:
    """The program of the test's machine, translated once; its global variables are shared."""
    return load_program({**delivered(), "GETCPUCOUNTER.st": CLOCK}, RECEIVERS)


def use_key(program: Program, key: bytes) -> None:
    """Fill GVL_HmAuth as an engineer would; no bytes: no authentication."""
    auth = program.globals("GVL_HmAuth")
    auth.aKey = [*key, *(64 - len(key)) * (0,)]
    auth.nKeyLength = len(key)


def sample_bytes(sample: PlantSample) -> bytes:
    """Readings as ST_HmSample holds them: whatever the encoders' bits are, they go in as bits."""
    arrays = (sample.q_rad, sample.qd_rad_s, sample.p_a_pa, sample.p_b_pa)
    flat = [x for a in arrays for x in (*a.tolist(), *(8 - len(a)) * (0.0,))]
    return _SAMPLE.pack(*flat, sample.p_supply_pa, sample.p_tank_pa, sample.t_oil_c, 0.0)


class DeliveredPlc:
    """One FB_HmPlc, as the harness wants it (StructuredTextPlc)."""

    def __init__(self, key: bytes = b"", auto: bool = True, dry_run: bool = False) -> None:
        program = delivered_program()
        use_key(program, key)
        self.block = program.new("FB_HmPlc", bEnableAuto=auto, bDryRun=dry_run, bSimulation=True, bPanelValid=True)
        self._rx, self._tx = program.new_union("U_HmCmd"), program.new_union("U_HmState")
        self._sample = program.new_union("U_HmSample")

    def set_inputs(self, entropy: int, enable: bool, lever: bool, estop: bool) -> None:
        """The inputs of this cycle."""
        self.block.set(nEntropy=entropy, bEnable=enable, bLeverTaken=lever, bEstop=estop)

    def receive(self, payload: bytes, source: int, t_ns: int) -> None:
        """One datagram's payload; the transport's buffer holds what fits, and tells the true length."""
        self._rx.bytes = payload[:COMMAND_SIZE].ljust(COMMAND_SIZE, b"\0")
        self.block.method("Receive", self._rx, nLength=len(payload), nSource=source, nNowNs=t_ns)

    def refuse_frame(self) -> None:
        """What TwinCAT tells of a frame that is not the subscriber's."""
        self.block.method("RefuseFrame")

    def cycle(self, sample: PlantSample, t_ns: int) -> tuple[float, ...]:
        """One cycle; valve commands of 8 axes."""
        self._sample.bytes = sample_bytes(sample)
        self.block.method("Cycle", self._sample, nNowNs=t_ns)
        return tuple(self.block.aValves)

    def build_state(self, t_ns: int) -> bytes:
        """The state datagram's payload."""
        self.block.method("BuildState", self._tx, nNowNs=t_ns)
        return bytes(self._tx.bytes)

    def peer(self) -> int | None:
        """Where states go."""
        return self.block.nPeer if self.block.bHasPeer else None

    def answers(self) -> bool:
        """Whether the last datagram's sender is answered, because it was refused."""
        return bool(self.block.bAnswer)

    def illegal_events(self) -> int:
        """Events that the transition table did not know."""
        return self.block.fbLink.nIllegalEvents
