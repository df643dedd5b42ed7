"""`longreach bench link`: the PLC link in real time beside the vision load, minute by minute.

The real link process, or (for comparison) the same client in the server's own process; a simulated PLC in a process of
its own; stereo pictures rendered once and replayed through the real vision pipeline at the rate it holds alone.
"""

import asyncio
import json
import os
from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.table import Table

from benchmarks.kills.plc_process import PlcProcess, free_udp_port
from benchmarks.link.load.in_server import InServerLink, InServerVision
from benchmarks.link.load.minute import Minute, Total, as_data, minute_from, total_of
from benchmarks.link.load.rendered_pairs import render_pairs
from benchmarks.link.load.replay_camera import ReplayCamera
from benchmarks.link.load.session import Session, vision_alone
from benchmarks.link.load.tap import Tap
from machine.description import Machine, parse_machine_toml
from recording.files import write_durably
from server.camera.client import VisionClient
from server.camera.contracts import VisionSettings
from server.camera.sources.settings import HttpSource
from server.link.client import LinkClient
from server.link.settings import LinkSettings
from server.settings import read_machine_text
from sim_plc.process import SimSettings

Where = Literal["process", "server"]
OFFERED_HZ = 60.0  # while vision is measured alone: more than it can take
RATE_MIN_HZ = 15.0
ALONE_S = 20.0
MINUTE_S = 60.0
PAIRS = 100
_MANY = 10_000  # more minutes than anybody has saved


@dataclass(frozen=True, slots=True)
class VisionAlone:
    """What vision held with nothing beside it, and so what is replayed."""

    pairs_per_s: float
    process_ms: float
    replay_hz: float


@dataclass(frozen=True, slots=True)
class Plan:
    """What to run."""

    minutes: int = 10
    seed: int = 1
    where: Where = "process"
    minute_s: float = MINUTE_S
    alone_s: float = ALONE_S
    pairs: int = PAIRS
    preset: str = "realistic"


def command(minutes: int, seed: int, in_server: bool, folder: Path, console: Console) -> None:
    """Run or resume one kind, and show it beside what the folder holds of the other."""
    plan = Plan(minutes=minutes, seed=seed, where="server" if in_server else "process")
    runs = [bench(plan, folder, console)]
    other = replace(plan, where="process" if in_server else "server", minutes=_MANY)
    console.print(summary(sorted([*runs, _saved(other, folder)], key=lambda run: [m.where for m in run[:1]])))


def bench(plan: Plan, folder: Path, console: Console) -> list[Minute]:
    """Run or resume; every minute is saved as soon as it is over."""
    folder.mkdir(parents=True, exist_ok=True)
    machine_text = read_machine_text("hiab033")
    machine = parse_machine_toml(machine_text)
    minutes = _saved(plan, folder)
    if len(minutes) < plan.minutes:
        files = render_pairs(machine, folder / f"pairs-{plan.seed}", plan.pairs, plan.seed, plan.preset)
        alone = _alone(plan, folder, machine, files)
        console.print(
            f"vision alone: {alone.pairs_per_s:.1f} pairs/s, {alone.process_ms:.0f} ms a pair; "
            f"replayed at {alone.replay_hz:.1f} pairs/s",
            highlight=False,
        )
        asyncio.run(_run(plan, folder, machine, machine_text, files, alone, minutes, console))
    return minutes


def _saved(plan: Plan, folder: Path) -> list[Minute]:
    minutes = []
    for number in range(1, plan.minutes + 1):
        file = _file(plan, folder, number)
        if not file.exists():
            break
        minutes.append(minute_from(json.loads(file.read_text(encoding="utf-8"))))
    return minutes


def _file(plan: Plan, folder: Path, number: int) -> Path:
    return folder / f"{plan.where}-{plan.seed}-{number}.json"


def _alone(plan: Plan, folder: Path, machine: Machine, files: list[Path]) -> VisionAlone:
    """Measured once for a folder."""
    saved = folder / "vision-alone.json"
    if saved.exists():
        return VisionAlone(**json.loads(saved.read_text(encoding="utf-8")))
    with ReplayCamera(files, OFFERED_HZ) as camera:
        vision = VisionClient(VisionSettings(source=HttpSource(camera.url)), machine)
        pairs_per_s, process_ms = asyncio.run(vision_alone(vision, plan.alone_s))
    alone = VisionAlone(pairs_per_s, process_ms, max(RATE_MIN_HZ, round(pairs_per_s, 1)))
    write_durably(saved, json.dumps(asdict(alone), indent=1))
    return alone


async def _run(
    plan: Plan,
    folder: Path,
    machine: Machine,
    machine_text: str,
    files: list[Path],
    alone: VisionAlone,
    minutes: list[Minute],
    console: Console,
) -> None:
    settings = SimSettings(machine_text, plan.preset, plan.seed, plc_port=free_udp_port(), camera=False)
    plc = PlcProcess(settings)
    with ExitStack() as stack:
        stack.enter_context(plc)
        tap = stack.enter_context(Tap(settings.plc_port))
        camera = stack.enter_context(ReplayCamera(files, alone.replay_hz))
        others = {"plc": plc.pid, "tap": tap.pid, "camera": camera.pid}
        async with _session(plan.where, tap, camera.url, machine, others) as session:
            for number in range(len(minutes) + 1, plan.minutes + 1):
                minute = await session.minute(number, plan.minute_s)
                text = json.dumps(as_data(minute))
                _file(plan, folder, number).write_text(text, encoding="utf-8")
                minutes.append(minute)
                console.print(line(minute), highlight=False)
    if plc.health is not None:
        console.print(f"the PLC's own loop: {plc.health}", highlight=False)


@asynccontextmanager
async def _session(
    where: Where, tap: Tap, camera_url: str, machine: Machine, others: dict[str, int]
) -> AsyncIterator[Session]:
    """Link and vision of one kind, started; ended on leaving."""
    seen = VisionSettings(source=HttpSource(camera_url))
    if where == "process":
        link, vision = LinkClient(LinkSettings(plc_port=tap.port), machine), VisionClient(seen, machine)

        def pids() -> dict[str, int]:
            own = {"link": link.process_id, "vision": vision.process_id, "server": os.getpid()}
            return {name: pid for name, pid in own.items() if pid is not None} | others

        session = Session(where, link, vision, tap, machine, pids)
    else:
        session = Session(
            where,
            InServerLink(tap.port, machine),
            InServerVision(seen, machine),
            tap,
            machine,
            lambda: {"server": os.getpid()} | others,
        )
    try:
        await session.start()
        yield session
    finally:
        await session.close()


def line(minute: Minute) -> str:
    """One minute in one line."""
    late = total_of([minute]).lateness_in_run
    depth = "?" if minute.buffer_min_ms is None else f"{minute.buffer_min_ms:.0f}"
    ended = f"; ended early: {'; '.join(minute.interruptions)[:120]}" if minute.interruptions else ""
    return (
        f"{minute.where:7s} minute {minute.number}: {minute.underruns} underruns, sends late by {late.p50_us:.0f} / "
        f"{late.p99_us:.0f} / {late.max_us:.0f} us (p50/p99/max), longest gap {minute.gap_max_ms:.0f} ms, "
        f"buffer >= {depth} ms, lost {minute.lost_to_plc} + {minute.lost_to_pc}, {minute.pairs_per_s:.1f} pairs/s, "
        f"RUN {100 * minute.run_frac:.1f} %{ended}"
    )


def summary(runs: list[list[Minute]]) -> Table:
    """The figures of one or more runs beside each other."""
    totals = [total_of(minutes) for minutes in runs if minutes]
    table = Table(title="PLC link under vision load", title_justify="left")
    table.add_column("figure")
    for total in totals:
        table.add_column("link process" if total.where == "process" else "in the server's process")
    for name, *cells in zip(*([_NAMES] + [_cells(total) for total in totals]), strict=True):
        table.add_row(name, *cells)
    return table


_NAMES = [
    "N reached, minutes",
    "underruns (PLC's counter)",
    "watchdog trips; trajectories ended early",
    "PLC in RUN",
    "sends late while in RUN, seen from outside: p50 / p99 / max us",
    "all sends, those between trajectories too: p50 / p99 / max us",
    "by the client itself: median p50, worst p99 (of 1000), max us",
    "longest time between two commands ms",
    "smallest buffer: in a trajectory's first second, later ms",
    "datagrams lost",
    "stereo pairs/s; median ms a pair",
    "CPU, % of a core",
    "scheduling",
    "page faults from disk; load average",
]


def _cells(total: Total) -> list[str]:
    return [
        f"{total.minutes:.1f}",
        f"{total.underruns}",
        f"{total.watchdog_trips}; {total.interruptions}",
        f"{100 * total.run_frac:.2f} %",
        *(
            f"{late.p50_us:.0f} / {late.p99_us:.0f} / {late.max_us:.0f} (n = {late.n})"
            for late in (total.lateness_in_run, total.lateness)
        ),
        f"{total.own_p50_us:.0f}, {total.own_p99_us:.0f}, {total.own_max_us:.0f}",
        f"{total.gap_max_ms:.1f}",
        f"{total.buffer_start_min_ms:.0f}, {total.buffer_min_ms:.0f}",
        f"{total.lost}",
        f"{total.pairs_per_s:.1f}; {total.process_ms:.0f}",
        ", ".join(f"{name} {100 * share:.0f}" for name, share in total.cpu_frac.items()),
        ", ".join(f"{name} {text}" for name, text in total.policies.items()),
        f"{total.major_faults}; {total.load_average:.1f}",
    ]
