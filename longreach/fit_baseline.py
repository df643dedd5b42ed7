"""`longreach diagnose --fit-baseline`: a machine file with the effects of the machine's baseline."""

from pathlib import Path

from rich.console import Console
from rich.markup import escape

from diagnosis.baseline.baseline import Baseline, fit_baseline
from diagnosis.errors import DiagnosisError
from diagnosis.known.days import BASELINE_RECORDINGS_TARGET, FITTED_RECORDINGS_MAX, JUDGING_RECORDINGS_TARGET
from diagnosis.machine_out import MachineOutError, machine_text
from diagnosis.reading.read import Read, read_for_diagnosis
from machine.effects.entries import entries_to_toml
from machine.effects.registry import effect_of
from machine.errors import MachineFileError
from machine.file_tables import with_tables, without_lists
from machine.remainder import remainders_to_toml
from recording.files import write_durably

EMPTY_BASELINE = Baseline((), (), ())
FITTED_RECORDINGS_FRAC = 1.0 / 3.0  # of the recordings; the others judge


class BaselineError(Exception):
    """Recordings from which no baseline can be made, or a file that cannot be written."""


def make_baseline(recordings: list[Path], machine_file: Path | None, out: Path, screen: Console) -> str:
    """Fit a baseline and write the machine file; what it says of itself, for the screen.

    Raises: BaselineError: an unusable recording, too few of them, or a file that cannot be written.
    """
    nominal = _nominal_machine_text(recordings[0], machine_file)
    with_baseline(nominal, EMPTY_BASELINE)  # whether it can be written, before minutes of fitting
    wholes = _read_usable_recordings(recordings, machine_file)
    count = min(FITTED_RECORDINGS_MAX, max(1, round(len(wholes) * FITTED_RECORDINGS_FRAC)))
    try:
        found = fit_baseline(wholes[:count], wholes[count:], lambda text: screen.print(f"[dim]{escape(text)}[/]"))
    except DiagnosisError as error:
        raise BaselineError(str(error)) from error
    try:
        write_durably(out, with_baseline(nominal, found))
    except OSError as error:
        raise BaselineError(f"{out} cannot be written: {error.strerror}") from error
    return report_of(found, count, len(wholes))


def _read_usable_recordings(recordings: list[Path], machine_file: Path | None) -> list[Read]:
    """All of them read, or one error that names every one that cannot be used."""
    wholes = [read_for_diagnosis(path, machine_file) for path in recordings]
    bad = [
        f"{recording.recording_path}: {'; '.join(map(str, recording.findings))}"
        for recording in wholes
        if not recording.has_judgeable_stage
    ]
    if bad:
        raise BaselineError("cannot be used, leave out or fix: " + "\n".join(bad))
    return wholes


def _nominal_machine_text(path: Path, machine_file: Path | None) -> str:
    try:
        text = machine_text(path, machine_file)
    except MachineOutError as error:
        raise BaselineError(str(error)) from error
    if not text:
        raise BaselineError(f"{path} holds no machine.toml; give one by --machine")
    return text


def with_baseline(text: str, found: Baseline) -> str:
    """A machine file's text with this baseline in place of any that it had.

    Raises: BaselineError: the text is not TOML, or its tables cannot be separated.
    """
    added = entries_to_toml(found.effects) + remainders_to_toml(found.remainders)
    try:
        return with_tables(without_lists(text, ("effect", "remainder")), added)
    except MachineFileError as error:
        raise BaselineError(str(error)) from error


def report_of(found: Baseline, fitted: int, count: int) -> str:
    """What was fitted and what is left, one line a cell."""
    counts = f"names from {fitted} recordings, sizes from {count}, judged on {count - fitted}"
    rows = [f"{counts}; RMS in noise floors before and after:"]
    if count - fitted < JUDGING_RECORDINGS_TARGET:
        rows.insert(0, f"few: {BASELINE_RECORDINGS_TARGET} recordings also say what each joint leaves from day to day")
    rows += [
        f"  {cell.cell_label}: {cell.rms_without_effects:.3g} -> {cell.rms_with_effects:.3g}"
        for cell in found.cell_baselines
    ]
    rows += [f"  {effect.name} {effect.joint or ''} {dict(effect.values)}" for effect in found.effects]
    rows += [
        f"  {remainder.stage} {remainder.joint}: {name} wanders by {size:.2g}{_unit_suffix(name)} from day to day"
        for remainder in found.remainders
        for name, size in remainder.wander
    ]
    return "\n".join(rows)


def _unit_suffix(name: str) -> str:
    """Of an effect's size, after a number; nothing for a plain share."""
    unit = effect_of(name).size.unit
    return f" {unit}" if unit != "1" else ""
