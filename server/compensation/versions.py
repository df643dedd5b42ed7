"""What identifications found of this machine, kept by version; one of them may be in use, effect by effect.

Each version is one JSON file. It holds for the machine file it was found with: geometry, gravity, mount, serial.
"""

import hashlib
import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np

from machine.description import Machine, parse_machine_toml
from machine.effects.entries import EffectEntry, entries_to_toml, make_entry
from machine.effects.registry import effect_named
from machine.errors import MachineError, MachineFileError
from machine.file_tables import with_room_for_effects, with_tables
from recording.files import write_durably
from server.compensation.compensation import Compensation, CompensationError, compensation_of
from server.compensation.effects import COMPENSATION_TEXT_BY_EFFECT, sort_effects

FORMAT_VERSION = 1
IN_USE_FILE_NAME = "in-use.json"


@dataclass(frozen=True, slots=True)
class FoundEffect:
    """One effect of a version. `does`: what the server changes by it, empty where only a simulation can use it."""

    entry: EffectEntry
    stage: str
    tool_mm: float
    probability: float
    does: str
    on: bool


@dataclass(frozen=True, slots=True)
class MachineVersion:
    """What one identification found. `base_id`: fingerprint of the machine file that its sizes count from."""

    version_id: str
    made_unix_s: float
    machine: str
    serial: str
    base_id: str
    recordings: tuple[str, ...]
    diagnosis_id: str
    sentence: str
    miss_mm: float | None
    left_mm: float | None
    effects: tuple[FoundEffect, ...]

    @property
    def entries_in_use(self) -> tuple[EffectEntry, ...]:
        """The effects that are switched on."""
        return tuple(effect.entry for effect in self.effects if effect.on)


class MachineVersions:
    """The versions of one machine, in a folder of their own."""

    def __init__(self, folder: Path, machine: Machine, machine_text: str) -> None:
        self._folder, self._machine, self._text = folder, machine, machine_text
        self._base_id = base_id_of(machine)
        self.problem = ""  # why a version that was in use is not

    def list_versions(self) -> tuple[MachineVersion, ...]:
        """All that can be read, newest first."""
        found = [self._read(path) for path in self._folder.glob("version-*.json")]
        return tuple(sorted((version for version in found if version), key=lambda version: -version.made_unix_s))

    def find_version(self, version_id: str) -> MachineVersion | None:
        """The one of that id."""
        return self._read(self._path(version_id))

    def make_version(self, answer: dict[str, Any], diagnosis_id: str) -> MachineVersion:
        """A version of the effects that a budget takes for a machine file, all switched on; it is kept, not used yet.

        Raises: CompensationError: the answer holds no confirmed effect, or was found with another machine file.
        """
        budget = answer.get("budget") or {}
        lines = budget.get("effects", [])
        effects = tuple(_effect_from_budget_line(line, used) for line in lines if (used := _used_parameters(line)))
        if not any(line.get("status") == "confirmed" for line in lines):
            raise CompensationError(
                f"diagnosis {diagnosis_id} confirms no effect: there is nothing to use; identify again, or do the "
                "experiment that it proposes"
            )
        version = MachineVersion(
            version_id=uuid4().hex[:12],
            made_unix_s=round(time.time(), 3),
            machine=self._machine.name,
            serial=self._machine.serial,
            base_id=self._base_id,
            recordings=tuple(answer.get("recordings", ())),
            diagnosis_id=diagnosis_id,
            sentence=str(budget.get("sentence", "")),
            miss_mm=budget.get("miss_mm"),
            left_mm=budget.get("left_mm"),
            effects=_largest_of_each_effect(effects),
        )
        self._write(version)
        return version

    def switch_effects(self, version_id: str, on: tuple[bool, ...]) -> MachineVersion:
        """The version with its effects switched on or off, in their order; kept.

        Raises: CompensationError: no such version, or another number of effects.
        """
        version = self.find_version(version_id)
        if version is None or len(on) != len(version.effects):
            count = 0 if version is None else len(version.effects)
            raise CompensationError(f"version {version_id} has {count} effects, {len(on)} switches were given")
        changed = replace(
            version, effects=tuple(replace(effect, on=is_on) for effect, is_on in zip(version.effects, on, strict=True))
        )
        self._write(changed)
        return changed

    def use_version(self, version_id: str) -> None:
        """Use this version from now on, also after a restart; empty: none.

        Raises: CompensationError: it is not of this machine.
        """
        if version_id:
            self.require_this_machine(version_id)
        self._folder.mkdir(parents=True, exist_ok=True)
        write_durably(self._folder / IN_USE_FILE_NAME, json.dumps({"version_id": version_id}))
        self.problem = ""

    @property
    def in_use(self) -> MachineVersion | None:
        """The version in use; None without one, and where it is not of this machine: `problem` says so."""
        try:
            version_id = json.loads((self._folder / IN_USE_FILE_NAME).read_text(encoding="utf-8"))["version_id"]
            return self.require_this_machine(version_id) if version_id else None
        except (OSError, ValueError, KeyError, TypeError):
            return None
        except CompensationError as error:
            self.problem = str(error)
            return None

    def require_this_machine(self, version_id: str) -> MachineVersion:
        """The version of that id, if it is of this machine.

        Raises: CompensationError: no such version, or found with another machine file.
        """
        version = self.find_version(version_id)
        if version is None:
            raise CompensationError(f"no version {version_id} of this machine; see GET /v1/machine/versions")
        if version.base_id != self._base_id:
            raise CompensationError(
                f"version {version_id} was found with another machine file ('{version.machine}', serial "
                f"'{version.serial}') than the server's ('{self._machine.name}', serial '{self._machine.serial}'): "
                "geometry, gravity, mount or serial differ; identify again"
            )
        return version

    def compensation(self) -> Compensation | None:
        """What the version in use changes; None where nothing of it is switched on that the server can use."""
        version = self.in_use
        if version is None or not sort_effects(version.entries_in_use).compensated:
            return None
        return compensation_of(self._machine, version.entries_in_use)

    def machine_file(self, version: MachineVersion) -> str:
        """The machine file with the version's effects that are switched on, for `longreach sim` and `compare`."""
        head = f"\n# longreach identify: version {version.version_id}, {version.sentence}\n"
        try:
            text = with_tables(with_room_for_effects(self._text), head + entries_to_toml(version.entries_in_use))
            parse_machine_toml(text)
        except (MachineFileError, MachineError) as error:
            text = f"version {version.version_id} cannot be written as a machine file: {error}"
            raise CompensationError(text) from error
        return text

    def _write(self, version: MachineVersion) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"format_version": FORMAT_VERSION, **asdict(version)}, indent=1)
        write_durably(self._path(version.version_id), text)

    def _path(self, version_id: str) -> Path:
        return self._folder / f"version-{version_id}.json"

    def _read(self, path: Path) -> MachineVersion | None:
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            data.pop("format_version")
            effects = tuple(_effect_again(row) for row in data.pop("effects"))
            return MachineVersion(**{**data, "recordings": tuple(data["recordings"]), "effects": effects})
        except (OSError, ValueError, KeyError, TypeError):
            return None


def base_id_of(machine: Machine) -> str:
    """A fingerprint of what found sizes count from: the machine file's content, whatever its comments are."""
    parts = asdict(machine)
    parts.pop("effects")
    return hashlib.sha256(json.dumps(parts, default=np.ndarray.tolist, sort_keys=True).encode()).hexdigest()[:16]


def _used_parameters(line: dict[str, Any]) -> dict[str, Any] | None:
    """The numbers of a budget's line for a machine file; of an answer from before these: those of confirmed effects."""
    return line["used"] if "used" in line else line["parameters"] if line.get("status") == "confirmed" else None


def _effect_from_budget_line(line: dict[str, Any], used: dict[str, Any]) -> FoundEffect:
    """A line of a budget as an effect. Raises: CompensationError: the catalogue does not know it."""
    effect = effect_named(str(line.get("name")))
    if effect is None:
        raise CompensationError(f"effect {line.get('name')!r} is not in this program's catalogue; update the program")
    values = {name: parameter["value"] for name, parameter in used.items()}
    try:
        entry = make_entry(effect, line.get("joint"), values)
    except MachineFileError as error:
        raise CompensationError(f"the answer's effect cannot be used: {error}") from error
    does = COMPENSATION_TEXT_BY_EFFECT[entry.name] if sort_effects((entry,)).compensated else ""
    mm, probability = float(line.get("tool_mm") or 0.0), float(line.get("probability") or 0.0)
    return FoundEffect(entry, str(line.get("stage", "")), mm, probability, does, True)


def _largest_of_each_effect(effects: tuple[FoundEffect, ...]) -> tuple[FoundEffect, ...]:
    """An effect that stands in several columns of a budget, once: where it does most."""
    kept: dict[EffectEntry, FoundEffect] = {}
    for effect in effects:
        known = kept.get(effect.entry)
        if known is None or effect.tool_mm > known.tool_mm:
            kept[effect.entry] = effect
    return tuple(sorted(kept.values(), key=lambda effect: -effect.tool_mm))


def _effect_again(data: dict[str, Any]) -> FoundEffect:
    entry = data.pop("entry")
    values = tuple((str(name), float(value)) for name, value in entry["values"])
    again = EffectEntry(entry["name"], entry["joint"], values, entry["option"], tuple(entry["direction"]))
    return FoundEffect(again, **data)
