"""How the link reaches the PLC. Crosses the process boundary, so plain frozen data."""

from dataclasses import dataclass
from typing import Literal

from protocol.framing import EapFraming, Framing, RawFraming


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """Addresses and framing. `local_port` 0: any; a real TwinCAT wants a fixed one (50111, EAP 34980)."""

    plc_host: str = "127.0.0.1"
    plc_port: int = 50110
    local_host: str = "0.0.0.0"
    local_port: int = 0
    framing: Literal["raw", "eap"] = "raw"
    pc_net_id: str = "192.168.0.10.1.1"
    plc_net_id: str = "192.168.0.20.1.1"
    command_hz: float = 50.0
    speed_override: float = 1.0
    key: bytes = b""  # 16..64 bytes: sign commands and take only signed states


def framing_of(settings: LinkSettings) -> Framing:
    """The framing the settings ask for; raises LocalProtocolError for a bad NetId."""
    if settings.framing == "eap":
        return EapFraming.for_client(settings.pc_net_id, settings.plc_net_id)
    return RawFraming()
