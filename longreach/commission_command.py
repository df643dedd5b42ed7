"""`longreach commission`: the check list for one machine, guided at the terminal, with a report."""

import asyncio
import contextlib
import hashlib
import time
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from longreach.commission_operator import TerminalOperator, read_answers
from longreach.processes import Address, require_bindable
from machine.chain import chain_of
from machine.description import Machine, parse_machine_toml
from protocol.layout import LAYOUT_ID, VERSION_MAJOR, VERSION_MINOR
from recording.files import read_text, write_durably
from server.camera.client import VisionClient
from server.commissioning.check_list import (
    CHECK_LIST_STEPS,
    ONE_CONTROLLER_REMEDY,
    PLC_WAIT_S,
    Step,
    StepRequirement,
    go_through,
)
from server.commissioning.contracts import StepResult, Verdict
from server.commissioning.report import Report, exit_code, from_json, to_json, to_markdown
from server.commissioning.site import CommissioningOptions, Site
from server.errors import SettingsError
from server.link.client import LinkClient
from server.link.errors import LinkSilentError
from server.settings import ServerSettings, read_machine_text, read_settings
from server.settings_camera import with_stream
from server.settings_source import source_and_machine
from server.shell_settings import link_settings, vision_settings
from server.version import __version__
from server.warm_up import warmed_up

_COLOURS = {Verdict.PASS: "green", Verdict.FAIL: "red", Verdict.SKIPPED: "yellow", Verdict.INCONCLUSIVE: "yellow"}
_PERSON_ARM_S = 45.0  # time to walk to the enable key
_NOBODY_ARM_S = 8.0
_LIST = ", ".join(f"{step.number} {step.name}" for step in CHECK_LIST_STEPS)


def commission(
    settings_file: Annotated[Path | None, typer.Option("--settings", help="the server's TOML settings file")] = None,
    plc_host: Annotated[str | None, typer.Option(help="the PLC's address")] = None,
    plc_port: Annotated[int | None, typer.Option(help="the PLC's UDP port")] = None,
    plc_local_port: Annotated[int | None, typer.Option(help="our UDP port")] = None,
    framing: Annotated[str | None, typer.Option(help="raw or eap")] = None,
    camera_url: Annotated[str | None, typer.Option(help="multipart stream of side-by-side JPEG")] = None,
    machine: Annotated[str | None, typer.Option(help="machine file, or the name of a shipped one")] = None,
    runs: Annotated[Path | None, typer.Option(help="folder for the report")] = None,
    steps: Annotated[str, typer.Option(help=f"which, by number: {_LIST}")] = "",
    move: Annotated[
        bool, typer.Option("--move", help="permission to move, instead of typing the machine's name")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="unattended: confirm everything, ask nothing")] = False,
    answers: Annotated[Path | None, typer.Option(help="TOML file of answers, by step and joint")] = None,
    resume: Annotated[Path | None, typer.Option(help="earlier report (.json) to continue")] = None,
    ends: Annotated[bool, typer.Option("--ends", help="drive every joint to its ends by lever (step 4)")] = False,
    each_joint: Annotated[bool, typer.Option("--each-joint", help="stop times of every joint too (step 8)")] = False,
    listen_s: Annotated[float, typer.Option(min=3.0, max=600.0, help="how long step 1 listens [s]")] = 10.0,
) -> None:
    """Go through the check list of a new machine.

    Exit code 0: all checks passed, 1: a check failed, 3: a check was inconclusive.
    """
    plc = {"host": plc_host, "port": plc_port, "local_port": plc_local_port, "framing": framing}
    settings = _with_options(read_settings(settings_file), plc, camera_url, machine, runs)
    console = Console()
    operator = TerminalOperator(console, read_answers(answers), assume_yes=yes, move=move)
    options = CommissioningOptions(
        listen_s=listen_s,
        ask_for_ends=ends,
        each_joint=each_joint,
        arm_timeout_s=_NOBODY_ARM_S if yes else _PERSON_ARM_S,
        settings_file=settings_file,
    )
    _require_free_port(settings)
    earlier = _load_earlier_report(resume)
    try:
        report = asyncio.run(_run_commissioning(settings, chosen_steps(steps), operator, options, earlier, console))
    except LinkSilentError as error:
        raise SettingsError(f"{error}; {ONE_CONTROLLER_REMEDY}") from error
    except KeyboardInterrupt:
        console.print("[bold]stopped; the machine is ramped down and disarmed; the report holds the finished steps[/]")
        raise typer.Exit(130) from None
    finally:
        operator.close()
    if report.open_answers:
        console.print(f"answers without a question: {', '.join(report.open_answers)}", style="yellow")
    raise typer.Exit(exit_code(report.all_results))


def chosen_steps(text: str) -> tuple[Step, ...]:
    """The steps of a list of numbers, in the list's own order; empty: all.

    Raises: SettingsError: a number that is not a step.
    """
    if not text.strip():
        return CHECK_LIST_STEPS
    wanted = {part.strip() for part in text.split(",") if part.strip()}
    unknown = sorted(wanted - {str(step.number) for step in CHECK_LIST_STEPS})
    if unknown:
        raise SettingsError(f"--steps: {', '.join(unknown)} is not a step; choose from {_LIST}")
    return tuple(step for step in CHECK_LIST_STEPS if str(step.number) in wanted)


async def _run_commissioning(
    settings: ServerSettings,
    steps: tuple[Step, ...],
    operator: TerminalOperator,
    options: CommissioningOptions,
    earlier: Report | None,
    console: Console,
) -> Report:
    """Go through the steps; the report is rewritten after each of them, so that no result is lost."""
    report = _empty_report(settings, earlier)
    machine = parse_machine_toml(read_machine_text(settings.machine_file))
    chain = chain_of(machine)

    def done(result: StepResult) -> None:
        nonlocal report
        report = _with_result(report, result, link, operator)
        _save(report, Path(settings.recording.folder))
        _show_step_result(console, operator, result)

    async with contextlib.AsyncExitStack() as stack:
        link = LinkClient(link_settings(settings), machine)
        await link.start()
        stack.push_async_callback(link.close)
        if earlier is not None:
            await _require_same_plc(earlier, settings, link)
        vision, machine = await _start_vision(settings, machine, steps, stack)
        operator.show("getting ready")
        await warmed_up(machine, chain)
        await go_through(Site(settings, machine, chain, link, vision, operator, options), steps, report.earlier, done)
    path = _save(replace(report, complete=True), Path(settings.recording.folder))
    console.print(f"report: {path}", highlight=False, soft_wrap=True)
    return report


def _empty_report(settings: ServerSettings, earlier: Report | None) -> Report:
    text = read_machine_text(settings.machine_file)
    digest = hashlib.sha256(text.encode()).hexdigest()
    machine = parse_machine_toml(text)
    return Report(
        machine=machine.name,
        started=datetime.now().astimezone().isoformat(timespec="seconds"),
        longreach=__version__,
        link=f"HMLINK {VERSION_MAJOR}.{VERSION_MINOR}, layout {LAYOUT_ID:#010x}, {settings.plc.framing}",
        cfg_id=0,
        machine_sha256=digest,
        simulation=False,
        results=(),
        earlier=_earlier_results(earlier, machine, digest),
        settings=settings.model_dump(mode="json"),
    )


def _with_result(report: Report, result: StepResult, link: LinkClient, operator: TerminalOperator) -> Report:
    latest = link.latest
    return replace(
        report,
        cfg_id=link.health.cfg_id or report.cfg_id,
        simulation=report.simulation or (latest is not None and latest.simulation),
        results=(*report.results, result),
        open_answers=operator.open_answers,
    )


async def _start_vision(
    settings: ServerSettings, machine: Machine, steps: tuple[Step, ...], stack: contextlib.AsyncExitStack
) -> tuple[VisionClient | None, Machine]:
    """The vision process, only where a step looks; the machine with the camera that its pictures are of."""
    if not any(StepRequirement.CAMERA in step.requirements for step in steps):
        return None, machine
    source, seen_by = source_and_machine(settings.camera, machine)
    vision = VisionClient(vision_settings(source, settings.camera, seen_by.camera), seen_by)
    await vision.start()
    stack.push_async_callback(vision.close)
    return vision, seen_by


async def _require_same_plc(earlier: Report, settings: ServerSettings, link: LinkClient) -> None:
    """What another PLC showed, or a simulated one, proves nothing of this one.

    Raises: SettingsError: it is another PLC, or the PLC does not answer.
    """
    deadline_s = time.monotonic() + PLC_WAIT_S
    while (link.latest is None or not link.health.cfg_id) and time.monotonic() < deadline_s:  # noqa: ASYNC110 no event
        await asyncio.sleep(0.05)
    latest, cfg_id, host = link.latest, link.health.cfg_id, settings.plc.host
    if latest is None or not cfg_id:
        raise SettingsError(f"--resume: the PLC at {host} does not answer, so it cannot be compared with the report")
    before = earlier.settings.get("plc", {}).get("host")
    differ = [
        f"{name} was {was}, is {now}"
        for name, was, now in (
            ("a simulation", earlier.simulation, latest.simulation),
            ("the PLC's cfg_id", f"{earlier.cfg_id:#010x}", f"{cfg_id:#010x}"),
            ("its address", before, host),
        )
        if was != now
    ]
    if differ:
        raise SettingsError(
            f"--resume: the report of {earlier.started} is of another PLC: {'; '.join(differ)}; start a new report"
        )


def _earlier_results(earlier: Report | None, machine: Machine, digest: str) -> tuple[StepResult, ...]:
    """What an earlier report found, if it was about this very machine file.

    Raises: SettingsError: it was about another one.
    """
    if earlier is None:
        return ()
    if earlier.machine_sha256 != digest:
        raise SettingsError(
            f"--resume: the report of {earlier.started} is of another machine file than the present one of "
            f"'{machine.name}'; start a new report"
        )
    return earlier.all_results


def _load_earlier_report(path: Path | None) -> Report | None:
    if path is None:
        return None
    try:
        return from_json(read_text(path), str(path))
    except OSError as error:
        raise SettingsError(f"--resume {path}: {error.strerror}; give the .json of an earlier report") from error


def _with_options(
    settings: ServerSettings, plc: dict[str, object], camera_url: str | None, machine: str | None, runs: Path | None
) -> ServerSettings:
    data = settings.model_dump()
    data["plc"] |= {name: value for name, value in plc.items() if value is not None}
    data["camera"] = with_stream(settings.camera, camera_url)
    data["machine_file"] = machine or data["machine_file"]
    data["recording"]["folder"] = str(runs) if runs is not None else data["recording"]["folder"]
    return ServerSettings.model_validate(data)


def _require_free_port(settings: ServerSettings) -> None:
    """Raises SettingsError when our port is taken: most likely by the server."""
    plc, taken_by = settings.plc, f"another program: {ONE_CONTROLLER_REMEDY}; stop it first, or give another port"
    require_bindable((Address.of_plc_link(plc.local_host, plc.local_port, taken_by),))


def _show_step_result(console: Console, operator: TerminalOperator, result: StepResult) -> None:
    operator.close()
    colour = _COLOURS[result.verdict]
    console.print(f"  [{colour}]{result.verdict.value}[/]: {escape(result.summary)}", highlight=False, soft_wrap=True)
    if result.remedy:
        console.print(f"  to do: {escape(result.remedy)}", highlight=False, soft_wrap=True)


def _save(report: Report, folder: Path) -> Path:
    """Both forms of the report; where the one for people is."""
    folder.mkdir(parents=True, exist_ok=True)
    name = f"commission-{report.started[:19].replace(':', '').replace('T', '-')}"
    write_durably(folder / f"{name}.json", to_json(report))
    path = folder / f"{name}.md"
    write_durably(path, to_markdown(report))
    return path
