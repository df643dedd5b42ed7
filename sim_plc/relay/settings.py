"""Settings of the relay: addresses and faults."""

from dataclasses import dataclass, field

from sim_plc.relay.faults import Faults, FaultSettingsError

DIRECTIONS = ("both", "to-plc", "to-pc")


@dataclass(frozen=True, slots=True)
class RelaySettings:
    """A relay between PCs and one PLC. Times of windows count from the first datagram that it takes."""

    plc_host: str = "127.0.0.1"
    plc_port: int = 50110
    listen_host: str = "127.0.0.1"
    listen_port: int = 50120  # 0: the system chooses
    seed: int = 1
    to_plc: Faults = field(default_factory=Faults)
    to_pc: Faults = field(default_factory=Faults)

    def __post_init__(self) -> None:
        for name, port, least in (("plc_port", self.plc_port, 1), ("listen_port", self.listen_port, 0)):
            if not least <= port <= 65535:
                raise FaultSettingsError(f"{name} = {port}: must be {least}..65535")
        if self.seed < 0:
            raise FaultSettingsError(f"seed = {self.seed}: must be 0 or more")


def by_direction(faults: Faults, direction: str) -> tuple[Faults, Faults]:
    """(to the PLC, to the PC): the faults where the direction names them, none on the other way.

    Raises: FaultSettingsError: no such direction.
    """
    if direction not in DIRECTIONS:
        raise FaultSettingsError(f"direction = '{direction}': must be one of {', '.join(DIRECTIONS)}")
    return (faults if direction != "to-pc" else Faults()), (faults if direction != "to-plc" else Faults())
