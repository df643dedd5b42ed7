"""The delivered PLC program's numbers, taken from the simulated PLC's settings so that both run with the same."""

from machine.description import Machine
from protocol.twincat.parameters import PlcParameters
from sim_plc.plc import settings


def plc_parameters(
    machine: Machine, pc_net_id: str, plc_net_id: str, pc_address: str = "", plc_address: str = ""
) -> PlcParameters:
    """The parameters of one machine file; an address that is not given is the NetId's first four numbers."""
    own = settings.plc_settings(machine)
    return PlcParameters(
        machine=machine.name,
        table=own.table,
        cycle_ns=own.cycle_ns,
        kp=tuple(own.kp.tolist()),
        pt1_tau_s=tuple(joint.pt1_tau_s for joint in machine.joints),
        pt1_share=tuple(own.pt1_share.tolist()),
        lag_warn=tuple(own.lag_warn.tolist()),
        lag_fault=tuple(own.lag_fault.tolist()),
        range_margin_rad=settings.RANGE_MARGIN_RAD,
        encoder_jump_rad=settings.ENCODER_JUMP_RAD,
        encoder_jump_factor=settings.ENCODER_JUMP_FACTOR,
        rest_speed_rad_s=settings.REST_SPEED_RAD_S,
        supply_warn_pa=settings.SUPPLY_WARN_PA,
        supply_fault_pa=settings.SUPPLY_FAULT_PA,
        oil_warn_c=settings.OIL_WARN_C,
        oil_fault_c=settings.OIL_FAULT_C,
        pc_net_id=pc_net_id,
        plc_net_id=plc_net_id,
        pc_address=pc_address or ".".join(pc_net_id.split(".")[:4]),  # Beckhoff's habit: the address, then .1.1
        plc_address=plc_address or ".".join(plc_net_id.split(".")[:4]),
    )
