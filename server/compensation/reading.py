"""A compensation from files: the diagnosed machine file, and the diagnosis that stands for it."""

import json
import re
from pathlib import Path

import numpy as np

from machine.description import Machine, parse_machine_toml
from machine.errors import MachineError
from recording.files import read_text
from server.compensation.compensation import Compensation, CompensationError, compensation_of
from server.settings import ServerSettings

VERDICT_LINE = re.compile(r"^# longreach diagnose: verdict (\w+)", re.MULTILINE)  # as `--machine-out` writes it
USABLE_VERDICTS = ("effects", "none", "partly")  # of a budget the confirmed effects stand by themselves
COMPARED_JOINT_FIELDS = (
    "a_m",
    "d_m",
    "alpha_rad",
    "theta_offset_rad",
    "mass_kg",
    "com_m",
)  # what diagnosed sizes count from

FRAMES, MOUNT = ("T_flange_tcp", "gravity_base_m_s2"), "T_tcp_cam_left"


def read_compensation(machine: Machine, machine_file: Path, diagnosis_file: Path | None = None) -> Compensation:
    """The compensation that a diagnosed machine file asks for.

    Raises: CompensationError: a file that cannot be read, another machine, no effect, or a diagnosis that is undecided
            or outside the catalogue.
    """
    text = _read_file_text(machine_file)
    found = VERDICT_LINE.search(text)
    if found is not None:
        _require_usable(found.group(1), machine_file)
    if diagnosis_file is not None:
        _require_usable(_diagnosis_verdict(diagnosis_file), diagnosis_file)
    try:
        diagnosed = parse_machine_toml(text)
    except MachineError as error:
        raise CompensationError(f"[compensation] machine_file {machine_file}: {error}") from error
    if diagnosed.name != machine.name or len(diagnosed.joints) != len(machine.joints):
        raise CompensationError(
            f"[compensation] machine_file {machine_file} is of '{diagnosed.name}' with {len(diagnosed.joints)} joints; "
            f"the server drives '{machine.name}' with {len(machine.joints)}"
        )
    _require_same(machine, diagnosed, machine_file)
    if not diagnosed.effects:
        raise CompensationError(
            f"[compensation] machine_file {machine_file} has no [[effect]]: nothing to compensate; "
            "make one by `longreach diagnose RECORDING --machine-out FILE`"
        )
    return compensation_of(machine, diagnosed.effects)


def compensation_from(settings: ServerSettings, machine: Machine) -> Compensation | None:
    """The compensation that the settings ask for; None where they name no file.

    Raises: CompensationError: as `read_compensation`.
    """
    named = settings.compensation
    if named.machine_file is None:
        return None
    diagnosis = None if named.diagnosis_file is None else Path(named.diagnosis_file)
    return read_compensation(machine, Path(named.machine_file), diagnosis)


def _require_same(machine: Machine, diagnosed: Machine, machine_file: Path) -> None:
    """Sizes count from the geometry that they were diagnosed with, and belong to one crane of a kind."""
    if machine.serial and diagnosed.serial and machine.serial != diagnosed.serial:
        raise CompensationError(
            f"[compensation] machine_file {machine_file} is of serial '{diagnosed.serial}'; the server drives "
            f"'{machine.serial}'; give the file that was diagnosed on this machine"
        )
    for mine, other in zip(machine.joints, diagnosed.joints, strict=True):
        for name in COMPARED_JOINT_FIELDS:
            here, there = getattr(mine, name), getattr(other, name)
            if not np.allclose(here, there, rtol=0.0, atol=1e-9):
                raise CompensationError(
                    f"[compensation] machine_file {machine_file}: {name} of joint '{mine.name}' is {there}, in the "
                    f"server's machine file {here}; diagnose with the machine file that the server uses"
                )
    mounted = any(effect.name.startswith("hand_eye_") for effect in diagnosed.effects)
    for name in (*FRAMES, MOUNT) if mounted else FRAMES:
        here, there = getattr(machine, name), getattr(diagnosed, name)
        if not np.allclose(here, there, rtol=0.0, atol=1e-9):
            raise CompensationError(
                f"[compensation] machine_file {machine_file}: {name} is not that of the server's machine file, from "
                "which diagnosed sizes count; diagnose with the machine file that the server uses"
            )


def _require_usable(verdict: str, path: Path) -> None:
    if verdict not in USABLE_VERDICTS:
        raise CompensationError(
            f"[compensation] {path}: the diagnosis is '{verdict}' and must not be compensated; "
            "do the experiment that it proposes, and diagnose both recordings together"
        )


def _diagnosis_verdict(path: Path) -> str:
    try:
        return str(json.loads(_read_file_text(path))["verdict"])
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise CompensationError(
            f"[compensation] diagnosis_file {path} is not a result of `longreach diagnose`"
        ) from error


def _read_file_text(path: Path) -> str:
    try:
        return read_text(path)
    except OSError as error:
        raise CompensationError(f"[compensation] {path} cannot be read: {error.strerror}") from error
