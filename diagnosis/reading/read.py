"""A recording as the diagnosis takes it: arrays by stage, the nominal machine, and all that is wrong with either."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from diagnosis.behind.lost_points import without_spikes, without_zeros
from diagnosis.behind.misplaced_markers import misplaced_markers
from diagnosis.behind.misplaced_points import misplaced_points
from diagnosis.behind.outlying import without_outlying
from diagnosis.datagrams.clocks import is_offset_guessed, plc_to_pc_s
from diagnosis.datagrams.ref_by_number import with_reference
from diagnosis.errors import DiagnosisError
from diagnosis.log.exchanged import exchanged_loops
from diagnosis.log.findings import Finding, by_channel, fatal_findings
from diagnosis.log.fitting_file import corner_findings, machine_findings
from diagnosis.log.headers import header_findings, metre_findings
from diagnosis.log.missing import missing_columns
from diagnosis.log.nominal import Nominal, nominal_of
from diagnosis.log.pairing import pairing_findings
from diagnosis.log.quality import plc_findings, time_findings
from diagnosis.log.tables import Tables, tables_of
from diagnosis.log.units import unit_findings
from diagnosis.log.urdf_files import UrdfFiles
from diagnosis.reading.usable import enough_corners, enough_points, odometry_usable, why_unused
from diagnosis.replay.merge import merge_of
from diagnosis.replay.repeats import repeat_findings
from diagnosis.replay.stretches import Stretch, stretches_of
from recording.content import Recording
from recording.errors import RecordingError
from recording.files import read_text
from recording.opening import read_run
from recording.rows import PlcState
from recording.run import FORMAT_VERSION

Stage = str


@dataclass(frozen=True, slots=True)
class Read:
    """What could be read; where no stage can be judged, `findings` say why not.

    `machine_toml`: the recording's own machine file, whatever file it is judged by.
    """

    recording_path: Path
    tables: Tables | None
    nominal_machine: Nominal | None
    stretches: tuple[Stretch, ...]
    findings: tuple[Finding, ...]
    machine_toml: str = ""

    @property
    def has_judgeable_stage(self) -> bool:
        """Whether there is a stage that can be judged."""
        return self.nominal_machine is not None and not fatal_findings(self.findings) and bool(stages_present(self))

    @property
    def missing_parts(self) -> tuple[tuple[str, str], ...]:
        """What is missing in the machine file, by part, of what was recorded: of a camera only where there was one."""
        absent = () if self.nominal_machine is None else self.nominal_machine.missing_part_reasons
        seen = self.tables is not None and (self.tables.markers is not None or self.tables.odometry is not None)
        return tuple((part, why) for part, why in absent if seen or part != "camera")

    @property
    def log_unused(self) -> bool:
        """Whether there is a PLC's log of the encoders, empty, too broken or segmented too wrongly to be replayed."""
        if self.tables is None or self.stretches:
            return False
        written = self.tables.plc is not None and self.tables.plc.enc is not None
        named = (PlcState.file, PlcState.topic)
        return written or any(finding.code == "no_rows" and finding.subject in named for finding in self.findings)


def read_for_diagnosis(path: Path, machine_file: Path | None = None) -> Read:
    """Read a recording for diagnosis. What is wrong with it is a finding, never an exception.

    Args: machine_file: used in place of the recording's own machine.toml.
    """
    findings = column_findings(path)
    try:
        recording = read_run(path)
    except RecordingError as error:
        return Read(path, None, None, (), (*findings, _unreadable_finding(path, error)))
    whole = examine_recording(recording, path, machine_file, findings)
    return (
        whole if is_folder(path) else replace(whole, findings=tuple(by_channel(finding) for finding in whole.findings))
    )


def column_findings(path: Path) -> list[Finding]:
    """What the names of a folder's columns and files show before they are read; nothing of an MCAP file."""
    return _run_guarded_check(lambda: header_findings(path), path.name) if is_folder(path) else []


def examine_recording(
    recording: Recording,
    path: Path,
    machine_file: Path | None = None,
    before: Sequence[Finding] = (),
    others: Sequence[Path] = (),
) -> Read:
    """What a recording in memory gives. `path`: what it is called; `before`: what its form already showed; `others`:
    where the rest of it was read, if it is laid together of several.
    """
    folders = [folder for folder in (path, *others) if is_folder(folder)]
    findings = [*before, *_form_findings(recording, path, others)]
    tables, by_number = with_reference(tables_of(recording))
    findings += by_number
    nominal = _load_nominal_model(path, recording, tables, machine_file, findings)
    findings += _table_findings(tables, nominal)
    if nominal is not None:
        for folder in folders:
            found = _run_guarded_check(partial(metre_findings, folder, nominal.joint_slides), folder.name)
            findings += in_recording(found, folder) if others else found
    stretches: tuple[Stretch, ...] = ()
    if not fatal_findings(findings):
        stretches, left_out = stretches_of(tables, None if nominal is None else nominal.actuators)
        findings += left_out + repeat_findings(stretches)
        if nominal is not None:
            findings += misplaced_points(tables, nominal, stretches) + misplaced_markers(tables, nominal)
        if not fatal_findings(findings):
            tables, outside = _without_wild_points(tables, nominal, stretches)
            findings += outside
    whole = Read(path, tables, nominal, stretches, tuple(findings), recording.machine_toml)
    if fatal_findings(findings) or stages_present(whole):
        return whole
    return replace(whole, findings=(*findings, _nothing_judged_finding(whole)))


def _without_wild_points(
    tables: Tables, nominal: Nominal | None, stretches: tuple[Stretch, ...]
) -> tuple[Tables, list[Finding]]:
    """Impossible points are named and left out, so that they do not widen the noise of the others."""
    static, tracker, findings = tables.static, tables.tracker, list[Finding]()
    if static is not None:
        static, zeros = without_zeros(static, "static.csv")
        static, outside = without_outlying(nominal, static) if nominal is not None else (static, [])
        findings += zeros + outside
    if tracker is not None:
        tracker, zeros = without_zeros(tracker, "tracker.csv")
        spikes: list[Finding] = []
        if nominal is not None and nominal.arm is not None:
            tracker, spikes = without_spikes(nominal, tracker, stretches)
        findings += zeros + spikes
    return replace(tables, static=static, tracker=tracker), findings


def in_recording(findings: Sequence[Finding], path: Path) -> list[Finding]:
    """The same, saying of which of several recordings."""
    return [replace(finding, text=f"of {path.name}: {finding.text}") for finding in findings]


def is_folder(path: Path) -> bool:
    """Whether a recording has the form of a folder."""
    try:
        return path.is_dir()
    except OSError:  # a name that nothing can have: opening it says so
        return False


def _unreadable_finding(path: Path, error: RecordingError) -> Finding:
    text = str(error)
    code = "format_version" if "format_version" in text else "unreadable"
    code = "missing_column" if "count from 1 without gaps" in text or "is missing;" in text else code
    return Finding(code, "fatal", path.name[:60], text)


def _run_guarded_check(check: Callable[[], list[Finding]], subject: str) -> list[Finding]:
    try:
        return check()
    except OSError as error:
        return [Finding("unreadable", "fatal", subject, f"cannot be read: {error.strerror}")]


def _form_findings(recording: Recording, path: Path, others: Sequence[Path]) -> list[Finding]:
    findings: list[Finding] = []
    for place in (path, *others):
        if is_folder(place) and not (place / "run.toml").is_file():
            text = "is not there: no segments, no repeats, no clocks are known"
            found = [Finding("no_run_file", "note", "run.toml", text)]
            findings += in_recording(found, place) if others else found
    if not recording.complete:
        text = "the file was cut; what could be read is used, `longreach recording recover` writes a whole one"
        findings.append(Finding("cut_file", "problem", "recording", text))
    findings += [
        Finding("unknown_column", "note", path.name, f"channel {channel}: it is not of the format")
        for channel in recording.foreign_channels
    ]
    if recording.run_info.format_version < FORMAT_VERSION:
        text = (
            f"format_version {recording.run_info.format_version} is older than {FORMAT_VERSION}; read as its own "
            "version"
        )
        findings.append(Finding("format_version", "note", "run.toml", text))
    return findings


def _load_nominal_model(
    path: Path, recording: Recording, tables: Tables, machine_file: Path | None, findings: list[Finding]
) -> Nominal | None:
    text, name = recording.machine_toml, "machine.toml"
    if machine_file is not None:
        name = machine_file.name
        try:
            text = read_text(machine_file) if machine_file.is_file() else ""
        except OSError as error:
            findings.append(Finding("machine_file", "fatal", name, f"cannot be read: {error.strerror}"))
            return None
        if not text:
            findings.append(Finding("machine_file", "fatal", name, "is empty or no file; give a machine.toml"))
            return None
    if not text:
        reason = "there is no machine.toml; give one by --machine, or put it into the recording"
        findings.append(Finding("no_machine_file", "fatal", path.name, reason))
        return None
    urdfs = UrdfFiles(recording.attachments, None if machine_file is None else machine_file.parent)
    try:
        nominal = nominal_of(text, urdfs, tables.joint_count or None)
    except DiagnosisError as error:
        reason = str(error).removeprefix("machine.toml").removeprefix(":").strip()
        findings.append(Finding("machine_file", "fatal", name, reason))
        return None
    findings += [replace(finding, subject=name) for finding in nominal.findings]
    return nominal


def _table_findings(tables: Tables, nominal: Nominal | None) -> list[Finding]:
    findings = plc_findings(tables, nominal) + unit_findings(tables, nominal)
    to_plc_s = plc_to_pc_s(tables)
    offsets = (
        ("sent.csv", tables.sent, 0.0),
        ("odometry.csv", tables.odometry, tables.run_info.camera_to_pc_offset_s or 0.0),
    )
    for subject, table, to_pc_s in offsets:
        if table is not None:
            findings += time_findings(subject, table.t_s + to_pc_s - to_plc_s, None, tables.run_info.segments)
    findings += missing_columns(tables) + corner_findings(tables)
    if not any(
        finding.code == "degrees" or (finding.code, finding.severity) == ("time_backwards", "fatal")
        for finding in findings
    ):
        findings += pairing_findings(tables)
        findings += machine_findings(tables, nominal) if nominal is not None else []
        if nominal is not None and tables.plc is not None and not fatal_findings(findings):
            findings += exchanged_loops(tables.plc, nominal)
    clocks = tables.run_info
    if tables.markers is not None and tables.plc is not None and clocks.camera_to_pc_offset_s is None:
        text = "no clocks.camera_to_pc_offset_s: the camera's offset is unknown and must be fitted with every effect"
        findings.append(Finding("clock_offset_unknown", "note", "run.toml", text))
    if tables.markers is not None and is_offset_guessed(tables):
        text = "no clocks.plc_to_pc_offset_s: pictures are placed by how they move with the joints, and a camera that "
        text += "stamps late cannot be found; give the offset"
        findings.append(Finding("clock_offset_unknown", "note", "run.toml", text))
    return findings


def stages_present(whole: Read) -> tuple[Stage, ...]:
    """The stages that this recording and machine file allow to be judged, in the chain's order."""
    nominal, tables, some = whole.nominal_machine, whole.tables, whole.stretches
    if nominal is None or tables is None:
        return ()
    driven, moved = nominal.actuators is not None, any(stretch.enc is not None for stretch in some)
    mounted = nominal.arm is not None and nominal.T_tcp_cam_left is not None
    tests = (
        ("link", any(stretch.sent_reference is not None and stretch.ref is not None for stretch in some) and driven),
        (
            "controller",
            moved
            and nominal.has_controller
            and any(stretch.ref is not None and stretch.u is not None for stretch in some),
        ),
        ("actuator", moved and driven and any(stretch.u is not None for stretch in some)),
        ("actuator", moved and nominal.has_controller and merge_of(some) is not None),
        ("structure", nominal.arm is not None and enough_points(nominal, tables, some)),
        ("camera", mounted and nominal.camera is not None and enough_corners(nominal, tables, some)),
    )
    found = tuple(name for name, there in tests if there)
    return (*found, "camera") if mounted and odometry_usable(tables, some) and "camera" not in found else found


def _nothing_judged_finding(whole: Read) -> Finding:
    text = "no stage can be judged: record valve commands and encoders, or points measured by a tracker or camera"
    tables = whole.tables
    unused = [] if tables is None else why_unused(whole.nominal_machine, tables, whole.stretches)
    if unused:
        text = f"no stage can be judged: {'; '.join(unused)}"
    if tables is not None and tables.plc is not None and tables.plc.enc is None:
        text = f"the PLC's log holds no number of any encoder (q_<j>_rad), and {text}"
    elif tables is not None and tables.plc is not None and tables.plc.ref is None and tables.plc.u is None:
        text = f"the PLC's log says where the joints were, not what they were asked (q_ref_<j>_rad, u_<j>_frac); {text}"
    missing = "; ".join(f"{part}: {why}" for part, why in whole.missing_parts)
    if missing:
        text += f"; missing in the machine file: {missing}"
    if any(finding.code == "cut_file" for finding in whole.findings):
        text += f"; what could be read of the damaged file: {_what_was_read(tables)}"
    return Finding("no_data", "fatal", whole.recording_path.name, text)


def _what_was_read(tables: Tables | None) -> str:
    """Rows of each kind, as far as a damaged file gave them."""
    kinds = ("sent", "plc", "markers", "odometry", "tracker", "static")
    found = {kind: getattr(tables, kind) for kind in kinds}
    rows = [f"{len(table.xyz if kind == 'static' else table.t_s)} of {kind}" for kind, table in found.items() if table]
    return ", ".join(rows) or "no row"
