"""`longreach camera check`: check whether the camera is usable for measuring, with a remedy for each finding."""

import json
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table

from longreach.lens_calibrate_command import calibrate
from machine.description import Machine
from server.camera.check import CheckSampler, check_camera, progress_steps
from server.camera.check_findings import CheckFinding, Level, exit_code, worst_level
from server.camera.check_picture import edge_blur_px
from server.camera.check_scale import Tape
from server.camera.contracts import StereoSource
from server.camera.own_structure import Masks, mask_polygons
from server.camera.sources.opening import open_source
from server.camera.sources.settings import (
    DeviceSource,
    FileSource,
    HttpSource,
    RectifiedSource,
    RtspSource,
    SourceSettings,
)
from server.errors import SettingsError
from server.settings import read_machine, read_settings
from server.settings_camera import (
    CameraSettings,
    DeviceCameraSettings,
    EurocCameraSettings,
    FileCameraSettings,
    FolderCameraSettings,
    HttpCameraSettings,
    RecordingCameraSettings,
    RtspCameraSettings,
)
from server.settings_source import source_and_machine
from server.shown_address import without_password

app = typer.Typer(no_args_is_help=True, help="Check the stereo camera; calibrate its lens.")
app.command("calibrate")(calibrate)

READ_TIMEOUT_S = 0.1
DISPLAY_REFRESH_PERIOD_S = 0.5
FINDING_LEVEL_COLOURS = {Level.OK: "green", Level.WARN: "yellow", Level.FAIL: "red"}

SettingsFile = Annotated[Path | None, typer.Option("--settings", help="the server's TOML settings file")]
Source = Annotated[
    str | None,
    typer.Option(help="http://, rtsp://, /dev/video0, video file, .mcap, EuRoC folder, or 'LEFT*.png,RIGHT*.png'"),
]
Calibration = Annotated[
    list[str] | None, typer.Option(help="file of the rig's calibration; twice: left and right eye's")
]
EyeSize = Annotated[str | None, typer.Option(help="one eye's size, such as 1226x370, where the calibration needs it")]
MachineFile = Annotated[str | None, typer.Option("--machine", help="machine file, or the name of a shipped one")]
Seconds = Annotated[float, typer.Option(min=1.0, max=600.0, help="duration of the check [s]")]
Pairs = Annotated[int, typer.Option(min=1, max=200, help="number of pairs analysed in detail")]
INTER_CODED_WARNING_TEXT = (
    "accept_inter_coded: the decoder may hide damage until the next key frame, and looks then be wrong"
)
AsJson = Annotated[bool, typer.Option("--json", help="print the findings only, as JSON")]


@app.callback()
def camera() -> None:
    """Keep `check` a subcommand."""


@app.command()
def check(
    settings_file: SettingsFile = None,
    source: Source = None,
    calibration: Calibration = None,
    eye_size: EyeSize = None,
    machine: MachineFile = None,
    seconds: Seconds = 5.0,
    pairs: Pairs = 12,
    as_json: AsJson = False,
    tape_mm: Annotated[
        float | None, typer.Option("--tape", min=50.0, help="taped distance from tool marker to OOI's origin [mm]")
    ] = None,
    seed: Annotated[int, typer.Option(help="seed of the robust fit")] = 1,
) -> None:
    """Check rate, loss, latency, sharpness, exposure, rig and markers. Exit code 0: usable, 1: something failed."""
    console = Console(stderr=as_json)
    settings = read_settings(settings_file)
    chosen = settings.camera if source is None else camera_settings_of(source)
    chosen = _with_calibration(chosen, calibration, eye_size)
    opened, seen_machine = source_and_machine(chosen, read_machine(machine or settings.machine_file))
    gathering = CheckSampler(pairs_max=pairs, duration_s=seconds)
    stereo = open_source(opened)
    try:
        _gather_frames(stereo, gathering, seconds, console)
    except KeyboardInterrupt:
        console.print("stopped early; evaluating the pairs received so far")
    finally:
        stereo.close()
    masks = (
        mask_polygons(chosen.mask_left, seen_machine.camera, "mask_left"),
        mask_polygons(chosen.mask_right, seen_machine.camera, "mask_right"),
    )
    findings = _camera_check_findings(gathering, stereo, opened, seen_machine, seed, console, tape_mm, masks)
    if as_json:
        typer.echo(json.dumps(as_document(findings, without_password(source or chosen.kind)), indent=2))
    else:
        console.print(report(findings))
    raise typer.Exit(exit_code(findings))


def _with_calibration(camera: CameraSettings, calibration: list[str] | None, eye_size: str | None) -> CameraSettings:
    update: dict[str, object] = {"calibration": list(calibration)} if calibration else {}
    if eye_size is not None:
        width, _, height = eye_size.partition("x")
        if not (width.isdigit() and height.isdigit()):
            raise SettingsError(f"--eye-size '{eye_size}' is not WIDTHxHEIGHT [px], such as 1280x720")
        update |= {"eye_width_px": int(width), "eye_height_px": int(height)}
    return type(camera).model_validate(dict(camera) | update)


def camera_settings_of(text: str) -> CameraSettings:
    """The source that a word on the command line means. Raises: SettingsError: nothing that it could mean is there."""
    path = Path(text)
    if text.startswith("http://"):
        return HttpCameraSettings(url=text)
    if text.startswith(("rtsp://", "rtsps://")):
        return RtspCameraSettings(kind="rtsp", url=text)
    if text.isdigit():
        return DeviceCameraSettings(kind="device", index=int(text))
    if text.startswith("/dev/"):
        return DeviceCameraSettings(kind="device", path=text)
    if "," in text:
        left, _, right = text.partition(",")
        return FolderCameraSettings(kind="folder", left_glob=left.strip(), right_glob=right.strip())
    if path.suffix == ".mcap" and path.is_file():
        return RecordingCameraSettings(kind="recording", path=text)
    if path.is_dir():
        return EurocCameraSettings(kind="euroc", path=text)
    if path.is_file():
        return FileCameraSettings(kind="file", path=text)
    raise SettingsError(f"--source '{without_password(text)}' is not an address, device, file or folder; see --help")


def _gather_frames(stereo: StereoSource, gathering: CheckSampler, seconds: float, console: Console) -> None:
    """Read for some seconds from the first pair on, or until a stored source ends; a live table meanwhile."""
    end_s = time.monotonic() + seconds
    shown_s, measured, blur = 0.0, 0, ""
    with Live(_live_table(gathering, blur, ""), console=console, refresh_per_second=4, transient=True) as live:
        while time.monotonic() < end_s:
            frame = stereo.read(READ_TIMEOUT_S)
            if frame is not None:
                if not gathering.n:
                    end_s = time.monotonic() + seconds
                gathering.add(frame)
            elif stereo.ended:
                return
            if time.monotonic() - shown_s > DISPLAY_REFRESH_PERIOD_S:
                if len(gathering.image_pairs) > measured:  # once per kept pair: reading must not wait for it
                    measured, blur = len(gathering.image_pairs), _blur_text(gathering)
                shown_s = time.monotonic()
                live.update(_live_table(gathering, blur, stereo.state))


def _blur_text(gathering: CheckSampler) -> str:
    left, right, _ = gathering.image_pairs[-1]
    return f"{edge_blur_px(left):.1f} px left, {edge_blur_px(right):.1f} px right"


def _live_table(gathering: CheckSampler, blur: str, state: str) -> Table:
    table = Table(show_header=False, box=None)
    table.add_row("pairs", str(gathering.n))
    table.add_row("rate", f"{gathering.rate_hz:.1f} pairs/s")
    table.add_row("missing", str(gathering.missing_count))
    table.add_row("kept to look into", f"{len(gathering.image_pairs)} of {gathering.pairs_max}")
    if gathering.image_pairs:
        left, right, _ = gathering.image_pairs[-1]
        table.add_row("mean grey", f"{left[::8, ::8].mean():.0f} left, {right[::8, ::8].mean():.0f} right")
        table.add_row("blur", blur)
    table.add_row("state", escape(state) or "pictures arrive")
    return table


def _camera_check_findings(
    gathering: CheckSampler,
    stereo: StereoSource,
    opened: SourceSettings,
    machine: Machine,
    seed: int,
    console: Console,
    tape_mm: float | None,
    masks: Masks,
) -> list[CheckFinding]:
    """All findings; a source that gave nothing adds its own words."""
    from server.vision.aruco_source import ArucoPoseSource  # compiles; not for --help

    plain = opened.source if isinstance(opened, RectifiedSource) else opened
    device = isinstance(plain, DeviceSource)
    wanted_hz = plain.rate_hz if isinstance(plain, DeviceSource) else None
    stored = not isinstance(plain, DeviceSource | HttpSource | RtspSource)
    gathered = gathering.sample(stereo.skipped, own_clock=device, wanted_hz=wanted_hz, stored=stored)
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("analysing the pairs", total=progress_steps(gathered))
        findings = check_camera(
            gathered,
            machine,
            ArucoPoseSource(machine).observe,
            np.random.default_rng(seed),
            lambda: progress.advance(task),
            None if tape_mm is None else Tape(1e-3 * tape_mm),
            masks,
        )
    if isinstance(plain, FileSource | RtspSource) and plain.accept_inter_coded:
        findings.append(CheckFinding("coding", Level.WARN, INTER_CODED_WARNING_TEXT, "use a camera with Motion JPEG"))
    if stereo.state and not gathering.n:
        findings.insert(0, CheckFinding("source", Level.FAIL, stereo.state, "fix what this line states"))
    return findings


def report(findings: list[CheckFinding]) -> Table:
    """A table for people."""
    table = Table(title="camera check", title_justify="left", caption=f"camera: {worst_level(findings).value}")
    for heading in ("", "what", "how it is", "to do"):
        table.add_column(heading, overflow="fold")
    for finding in findings:
        level = f"[bold {FINDING_LEVEL_COLOURS[finding.level]}]{finding.level.value}[/]"
        table.add_row(level, finding.name, escape(finding.text), escape(finding.remedy))
    return table


def as_document(findings: list[CheckFinding], source: str) -> dict[str, object]:
    """The findings for machines; figures that are not finite are left out."""
    return {
        "source": source,
        "level": worst_level(findings).value,
        "findings": [
            {
                "name": finding.name,
                "level": finding.level.value,
                "text": finding.text,
                "remedy": finding.remedy,
                "figures": {name: value for name, value in finding.figures.items() if np.isfinite(value)},
            }
            for finding in findings
        ],
    }
