"""What a fleet's answers say together: which machines share an effect, and which sizes drift."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

# Effects that a recording cannot distinguish count as one for the reader of the answer.
Key = tuple[str, int | None]


def equals_of(result: dict[str, Any], effect: dict[str, Any]) -> list[dict[str, Any]]:
    """What this recording cannot distinguish from an effect."""
    own = _effect_key(effect)
    classes = [members for members in result["indistinguishable"] if own in {_effect_key(member) for member in members}]
    return [member for members in classes for member in members if _effect_key(member) != own]


def _effect_key(effect: dict[str, Any]) -> Key:
    return effect["name"], effect["joint"]


NORMAL_QUANTILE_95 = 1.645
DRIFT_RECORDINGS_MIN = 3  # recordings of one effect on one machine, for a drift
SECONDS_PER_DAY = 86400.0


@dataclass(frozen=True, slots=True)
class EffectOnMachine:
    """A named effect's size in one recording, with 90 % limits; `t_days` since 1970, None where no time was given."""

    machine: str
    recording: str
    name: str
    joint: int | None
    parameter: str
    unit: str
    value: float
    lower_90: float
    upper_90: float
    t_days: float | None


@dataclass(frozen=True, slots=True)
class SharedEffect:
    """An effect with the machines that have it, and those on which it was looked for well enough and not found."""

    name: str
    joint: int | None
    machines_with: tuple[str, ...]
    machines_without: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class EffectDrift:
    """Change of an effect's size on one machine: slope per day with 90 % limits. `is_drifting`: zero lies outside."""

    machine: str
    name: str
    joint: int | None
    unit: str
    per_day: float
    lower_90: float
    upper_90: float
    recording_count: int

    @property
    def is_drifting(self) -> bool:
        """Whether the slope is significant."""
        return self.lower_90 > 0.0 or self.upper_90 < 0.0


@dataclass(frozen=True, slots=True)
class Fleet:
    """The whole: verdicts by machine in the order of time, what is shared, what drifts, what could not be used; for how
    many recordings no serial shows whose they are.
    """

    machines: tuple[str, ...]
    verdicts_by_machine: dict[str, tuple[tuple[str, str], ...]]
    found_effects: tuple[EffectOnMachine, ...]
    shared_effects: tuple[SharedEffect, ...]
    effect_drifts: tuple[EffectDrift, ...]
    unusable_recordings: tuple[tuple[str, str], ...]
    no_serial: int = 0


def summary_of(results: Sequence[dict[str, Any]]) -> Fleet:
    """Of the dictionaries that `diagnose_case` gives."""
    good = [result for result in results if result["status"] == "diagnosed"]
    good.sort(key=lambda result: (machine_of(result), result["started_utc"], result["recording"]))
    found = tuple(item for result in good for item in _confirmed_effect_sizes(result))
    machines = tuple(dict.fromkeys(machine_of(result) for result in good))
    verdicts = {
        machine: tuple(
            (result["recording"], result["answer"]["verdict"]) for result in good if machine_of(result) == machine
        )
        for machine in machines
    }
    bad = tuple(
        (result.get("recording", "?"), _failure_reason(result)) for result in results if result["status"] != "diagnosed"
    )
    nameless = sum(not result["serial"] for result in good)
    return Fleet(machines, verdicts, found, _shared_effects(good, found), _effect_drifts(found), bad, nameless)


def machine_of(result: dict[str, Any]) -> str:
    """Name and serial number; without a serial, name and folder: cranes of one kind are not one machine, and the
    recordings of one folder are taken as one's. The recording's own name where the machine file has none.
    """
    if result["serial"]:
        return f"{result['machine']} {result['serial']}".strip()
    return f"{result['machine']} in {result['folder']}" if result["machine"] else result["recording"]


def _failure_reason(result: dict[str, Any]) -> str:
    fatal = [finding["text"] for finding in result.get("findings", []) if finding["severity"] == "fatal"]
    return result.get("reason") or "; ".join(fatal) or result["status"]


def _confirmed_effect_sizes(result: dict[str, Any]) -> list[EffectOnMachine]:
    """Confirmed effects of a recording."""
    out = []
    for effect in _confirmed_effects(result["answer"]):
        sized = [
            (name, x) for name, x in effect["parameters"].items() if x["low"] is not None and x["high"] is not None
        ]
        if sized:
            name, x = sized[0]
            size = (name, x["unit"], float(x["value"]), float(x["low"]), float(x["high"]))
            when = _days_since_epoch(result["started_utc"])
            out.append(
                EffectOnMachine(machine_of(result), result["recording"], effect["name"], effect["joint"], *size, when)
            )
    return out


def _confirmed_effects(answer: dict[str, Any]) -> list[dict[str, Any]]:
    return [effect for effect in answer["budget"]["effects"] if effect["status"] == "confirmed"]


def _days_since_epoch(text: str) -> float | None:
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        return None
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp() / SECONDS_PER_DAY


def _shared_effects(good: list[dict[str, Any]], found: tuple[EffectOnMachine, ...]) -> tuple[SharedEffect, ...]:
    """Effects by how many machines have them; a machine is without one only if its size there would have been seen."""
    out = []
    for key in dict.fromkeys((finding.name, finding.joint) for finding in found):
        mine = [finding for finding in found if (finding.name, finding.joint) == key]
        having = tuple(dict.fromkeys(finding.machine for finding in mine))
        size = float(np.median([abs(finding.value) for finding in mine]))
        able = [machine_of(result) for result in good if _could_see(result, key, size)]
        out.append(SharedEffect(*key, having, tuple(name for name in dict.fromkeys(able) if name not in having)))
    return tuple(sorted(out, key=lambda shared: (-len(shared.machines_with), shared.name, shared.joint or 0)))


def _could_see(result: dict[str, Any], key: tuple[str, int | None], size: float) -> bool:
    answer = result["answer"]
    if answer["verdict"] not in ("none", "effects", "partly"):
        return False
    named = _confirmed_effects(answer)
    if key in {(other["name"], other["joint"]) for effect in named for other in equals_of(answer, effect)}:
        return False  # it may be what was named there: that recording cannot distinguish the two
    limit = {(x["name"], x["joint"]): x["size"] for x in answer["detection_limits"]}.get(key)
    return limit is not None and limit <= size


def _effect_drifts(found: tuple[EffectOnMachine, ...]) -> tuple[EffectDrift, ...]:
    out = []
    for key in dict.fromkeys((finding.machine, finding.name, finding.joint) for finding in found):
        mine = [
            finding
            for finding in found
            if (finding.machine, finding.name, finding.joint) == key and finding.t_days is not None
        ]
        if len({finding.t_days for finding in mine}) >= DRIFT_RECORDINGS_MIN:
            out.append(_fit_drift_line(mine))
    return tuple(out)


def _fit_drift_line(mine: list[EffectOnMachine]) -> EffectDrift:
    """Weighted straight line over time.

    Model: value = a + b t, weights 1 / sigma^2 with sigma = (high - low) / (2 * 1.645); where the line fits worse than
           these sigmas say, its own scatter widens the limits (Birge), by Student's t for so few points.
    """
    from scipy.stats import t as student

    t = np.array([finding.t_days or 0.0 for finding in mine])
    y = np.array([finding.value for finding in mine])
    width = np.array([max(finding.upper_90 - finding.lower_90, 1e-12) for finding in mine])
    w = 1.0 / (width / (2.0 * NORMAL_QUANTILE_95)) ** 2
    A = np.stack([np.ones_like(t), t - t.mean()], axis=1)
    covariance = np.linalg.inv(A.T @ (w[:, None] * A))
    a_b = covariance @ (A.T @ (w * y))
    dof = len(mine) - 2
    chi2 = float((w * (y - A @ a_b) ** 2).sum()) / dof
    sd = float(np.sqrt(covariance[1, 1] * max(1.0, chi2)))
    half = float(student.ppf(0.95, dof)) * sd
    first, slope = mine[0], float(a_b[1])
    return EffectDrift(first.machine, first.name, first.joint, first.unit, slope, slope - half, slope + half, len(mine))
