"""One recording of a fleet, diagnosed anywhere: in this process, in another, on another computer.

The result is a plain dictionary that depends on the recording, the machine file and this program's version only.
"""

import hashlib
import os
import tomllib
from pathlib import Path
from typing import Any

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.errors import DiagnosisError
from diagnosis.reading.read import Read, read_for_diagnosis

FORMAT_VERSION = 1


def diagnose_case(path: str, machine_file: str | None = None) -> dict[str, Any]:
    """The answer to one recording with what a fleet needs to know of it; a bad recording is an answer too.

    Returns: `status` "diagnosed", "unusable" (see `findings`) or "failed" (see `reason`); whose and when.
    """
    whole = read_for_diagnosis(Path(path), None if machine_file is None else Path(machine_file))
    out: dict[str, Any] = {"format_version": FORMAT_VERSION, "recording": Path(path).name, **_recording_identity(whole)}
    findings = [
        {"code": finding.code, "severity": finding.severity, "text": str(finding)} for finding in whole.findings
    ]
    if not whole.has_judgeable_stage:
        return {**out, "status": "unusable", "findings": findings}
    try:
        return {**out, "status": "diagnosed", "findings": findings, "answer": answer_json(budget_of(whole))}
    except DiagnosisError as error:
        return {**out, "status": "failed", "findings": findings, "reason": str(error)}


def fingerprint(path: Path, machine_file: Path | None, version: str) -> str:
    """SHA-256 over everything that an answer depends on, so that a saved one is taken only while it still holds."""
    digest = hashlib.sha256(version.encode())
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    for file in [*files, *([machine_file] if machine_file is not None else [])]:
        digest.update(os.fsencode(file.name) + b"\0")
        digest.update(_file_digest(file))
    return digest.hexdigest()


def _file_digest(file: Path) -> bytes:
    """Of its content; of a broken link or a file that cannot be read, that it cannot: its answer says why."""
    try:
        with file.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").digest()
    except OSError:
        return b"unreadable"


def _recording_identity(whole: Read) -> dict[str, Any]:
    """Machine, serial number, folder and time of a recording; empty texts where it does not say.

    Whose it is says its own machine file, whatever file it is judged by: one file for a whole fleet has one serial.
    """
    nominal, tables = whole.nominal_machine, whole.tables
    given = {"name": nominal.name, "serial": nominal.serial_number} if nominal is not None else {}
    own = _machine_table(whole.machine_toml) or given
    return {
        "machine": str(own.get("name") or given.get("name", "")),
        "serial": str(own.get("serial", "")),
        "folder": whole.recording_path.parent.name,
        "started_utc": tables.run_info.started_utc if tables is not None else "",
    }


def _machine_table(text: str) -> dict[str, Any]:
    """The [machine] table of a machine file's text; empty where the text is not TOML."""
    try:
        table = tomllib.loads(text.removeprefix("\ufeff")).get("machine", {})
    except tomllib.TOMLDecodeError:
        return {}
    return table if isinstance(table, dict) else {}
