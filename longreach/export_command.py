"""`longreach export-plc DIR`: everything a PLC engineer needs to build the other end of the link."""

from collections.abc import Mapping
from importlib.resources import files
from ipaddress import AddressValueError, IPv4Address
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from machine.description import Machine
from protocol.errors import LocalProtocolError
from protocol.framing import parse_net_id
from protocol.twincat.bundle import build_bundle_files
from protocol.twincat.parameters import PlcParameters
from server.settings import read_machine
from sim_plc.plc import settings

console = Console()


# The delivered PLC program's numbers, taken from the simulated PLC's settings so that both run with the same.


def plc_parameters(
    machine: Machine, pc_net_id: str, plc_net_id: str, pc_address: str = "", plc_address: str = ""
) -> PlcParameters:
    """The parameters of one machine file; an address that is not given is the NetId's first four numbers."""
    own = settings.plc_settings(machine)
    return PlcParameters(
        machine_name=machine.name,
        limit_table=own.limit_table,
        cycle_ns=own.cycle_ns,
        kp_frac_per_rad=tuple(own.kp_frac_per_rad.tolist()),
        pt1_tau_s=tuple(joint.pt1_tau_s for joint in machine.joints),
        pt1_share=tuple(own.pt1_share.tolist()),
        lag_warn=tuple(own.lag_warn.tolist()),
        lag_fault=tuple(own.lag_fault.tolist()),
        range_margin_rad=settings.RANGE_MARGIN_RAD,
        encoder_jump_rad=settings.ENCODER_JUMP_RAD,
        encoder_jump_factor=settings.ENCODER_JUMP_FACTOR,
        rest_speed_rad_s=settings.ARMING_SPEED_MAX_RAD_S,
        supply_warn_pa=settings.SUPPLY_WARN_PA,
        supply_fault_pa=settings.SUPPLY_FAULT_PA,
        oil_warn_c=settings.OIL_WARN_C,
        oil_fault_c=settings.OIL_FAULT_C,
        pc_net_id=pc_net_id,
        plc_net_id=plc_net_id,
        pc_address=pc_address or ".".join(pc_net_id.split(".")[:4]),  # Beckhoff's habit: the address, then .1.1
        plc_address=plc_address or ".".join(plc_net_id.split(".")[:4]),
    )


def st_sources() -> dict[str, str]:
    """The hand-written blocks, file name to text."""
    folder = files("protocol.twincat") / "pou"
    return {entry.name: entry.read_text(encoding="utf-8") for entry in folder.iterdir() if entry.name.endswith(".st")}


def export_plc(
    folder: Annotated[Path, typer.Argument(help="where to write; must be empty or not there")],
    machine: Annotated[str, typer.Option(help="machine file, or the name of a shipped one")] = "hiab033",
    pc_net_id: Annotated[str, typer.Option(help="AMS NetId of the PC")] = "192.168.0.10.1.1",
    plc_net_id: Annotated[str, typer.Option(help="AMS NetId of the PLC")] = "192.168.0.20.1.1",
    pc_address: Annotated[str, typer.Option(help="IPv4 address of the PC; else the first four of its NetId")] = "",
    plc_address: Annotated[str, typer.Option(help="IPv4 address of the PLC; else the first four of its NetId")] = "",
    force: Annotated[bool, typer.Option("--force", help="write into a folder that is not empty")] = False,
) -> None:
    """Write the TwinCAT program, EAP sheet, Wireshark dissector, C header, golden vectors and guides."""
    _require_empty(folder, force)
    _require_valid_net_ids({"--pc-net-id": pc_net_id, "--plc-net-id": plc_net_id})
    _require_addresses({"--pc-address": pc_address, "--plc-address": plc_address})
    ends = (pc_net_id, plc_net_id, pc_address, plc_address)
    written = build_bundle_files(plc_parameters(read_machine(machine), *ends), st_sources())
    try:
        _write(folder, written)
    except OSError as error:
        raise typer.BadParameter(f"{folder} cannot be written: {error.strerror}") from error
    console.print(
        f"{len(written)} files in {folder}; begin with {folder / 'README.md'}", highlight=False, soft_wrap=True
    )
    left = _files_not_exported(folder, written)
    if left:
        console.print(
            f"{len(left)} older files are still there; do not import them: {', '.join(left[:5])}", highlight=False
        )


def _require_empty(folder: Path, force: bool) -> None:
    if folder.exists() and not folder.is_dir():
        raise typer.BadParameter(f"{folder} is a file: give a folder")
    if folder.is_dir() and any(folder.iterdir()) and not force:
        raise typer.BadParameter(f"{folder} is not empty: give another folder, or --force")


def _require_valid_net_ids(options: Mapping[str, str]) -> None:
    for name, net_id in options.items():
        try:
            parse_net_id(net_id)
        except LocalProtocolError as error:
            raise typer.BadParameter(f"{name}: {error}") from error


def _require_addresses(options: Mapping[str, str]) -> None:
    for name, address in options.items():
        try:
            IPv4Address(address or "0.0.0.0")  # not given: nothing to check
        except AddressValueError as error:
            raise typer.BadParameter(f"{name}: {error}; give four numbers such as 192.168.0.10") from error


def _write(folder: Path, written: Mapping[str, bytes]) -> None:
    for path, data in written.items():
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(data)


def _files_not_exported(folder: Path, written: Mapping[str, bytes]) -> list[str]:
    """Files in the folder that are not of this export: a block of an older one must not be imported by mistake."""
    found = (path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    return sorted(path for path in found if path not in written)
