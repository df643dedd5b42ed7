"""What to simulate and where it listens."""

from dataclasses import dataclass
from pathlib import Path

from protocol.errors import LocalProtocolError
from protocol.framing import parse_net_id

FRAMINGS = ("raw", "eap")
ENABLES = ("auto", "panel")
STRUCTURE_FRAC_MAX = 0.4  # so high are the beams that a camera near the tip sees


class SimSettingsError(ValueError):
    """A setting is out of its bounds; the text names it, its value and the bound."""


@dataclass(frozen=True, slots=True)
class SimSettings:
    """One simulated machine: PLC and stereo camera. `machine_text` is the text of a machine file."""

    machine_text: str
    preset: str = "realistic"
    seed: int = 1
    plc_host: str = "127.0.0.1"
    plc_port: int = 50110  # 0: the system chooses
    framing: str = "raw"
    pc_net_id: str = "192.168.0.10.1.1"  # EAP only
    plc_net_id: str = "192.168.0.20.1.1"
    camera: bool = True
    camera_host: str = "127.0.0.1"
    camera_port: int = 8090
    camera_rate_hz: float = 15.0
    camera_faults: bool = False  # POST /fault at the camera's address is obeyed
    camera_time_code: bool = False  # the exposure's time painted into the left picture, for latency measurements
    structure_frac: float | None = None  # of the picture, covered by the crane itself; None: as the preset draws it
    structure_contrast_frac: float | None = None  # of its texture, 0: plain paint; None: as the preset draws it
    bare_rock: bool = False  # the wall without the object's markers and boards
    dry_run: bool = False  # everything is played, but the valves stay neutral
    key: bytes = b""  # 16..64 bytes: take only signed commands, and sign states
    enable: str = "auto"  # or "panel": SIGUSR1 presses and releases the enable, SIGUSR2 the lever, SIGRTMIN the E-stop
    truth_log: Path | None = None
    stand_off_m: float = 0.1  # of the goal that the truth log measures against

    def __post_init__(self) -> None:
        for name, value, choices in (("framing", self.framing, FRAMINGS), ("enable", self.enable, ENABLES)):
            if value not in choices:
                raise SimSettingsError(f"{name} = '{value}': must be one of {', '.join(choices)}")
        for name, port in (("plc_port", self.plc_port), ("camera_port", self.camera_port)):
            if not 0 <= port <= 65535:
                raise SimSettingsError(f"{name} = {port}: must be 0..65535")
        if not 0.1 <= self.camera_rate_hz <= 120.0:
            raise SimSettingsError(f"camera_rate_hz = {self.camera_rate_hz}: must be 0.1..120 Hz")
        for name, share, limit in (
            ("structure_frac", self.structure_frac, STRUCTURE_FRAC_MAX),
            ("structure_contrast_frac", self.structure_contrast_frac, 1.0),
        ):
            if share is not None and not 0.0 <= share <= limit:
                raise SimSettingsError(f"{name} = {share}: must be 0..{limit:g}")
        if self.seed < 0:
            raise SimSettingsError(f"seed = {self.seed}: must be 0 or more")
        for name, net_id in (("pc_net_id", self.pc_net_id), ("plc_net_id", self.plc_net_id)):
            try:
                parse_net_id(net_id)
            except LocalProtocolError as error:
                raise SimSettingsError(f"{name}: {error}") from error
