"""Machine parameters of the delivered PLC program, equal to those of the simulated PLC."""

from dataclasses import dataclass

from protocol.limits import LimitTable

RAW_PLC_PORT, RAW_PC_PORT = 50110, 50111  # UDP, raw framing


@dataclass(frozen=True, slots=True)
class PlcParameters:
    """Limits, gains and thresholds, one value per axis in use; SI units. NetIds and addresses are for the EAP sheet."""

    machine_name: str
    limit_table: LimitTable
    cycle_ns: int
    kp_frac_per_rad: tuple[float, ...]  # command fraction per rad
    pt1_tau_s: tuple[float, ...]  # 0: plain P
    pt1_share: tuple[float, ...]  # of the way to its input that the PT-1 goes in one cycle
    lag_warn: tuple[float, ...]  # rad
    lag_fault: tuple[float, ...]
    range_margin_rad: float
    encoder_jump_rad: float
    encoder_jump_factor: float  # of qd_max
    rest_speed_rad_s: float
    supply_warn_pa: float
    supply_fault_pa: float
    oil_warn_c: float
    oil_fault_c: float
    pc_net_id: str = "192.168.0.10.1.1"
    plc_net_id: str = "192.168.0.20.1.1"
    pc_address: str = "192.168.0.10"
    plc_address: str = "192.168.0.20"
