"""`longreach bench load`: REST under load while vision works and the machine moves; block by block, each one saved."""

import asyncio
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from benchmarks.link.load.lateness import percentiles
from benchmarks.link.load.rendered_pairs import render_pairs
from benchmarks.link.load.replay_camera import ReplayCamera
from benchmarks.link.load.session import vision_alone
from benchmarks.server.load.block import LOST_MAX_FRAC, P99_MAX_MS, Block, Verdict, block_from, verdict_of
from benchmarks.server.load.clients import Demand
from benchmarks.server.load.stage import stage
from machine.description import Machine, parse_machine_toml
from server.camera.client import VisionClient
from server.camera.contracts import VisionSettings
from server.camera.sources.settings import HttpSource
from server.settings import read_machine_text

FOLDER = Path("runs/bench-load")
OFFERED_HZ = 60.0  # while vision is measured alone: more than it can take
CAMERA_RATES_HZ = (15.0, 30.0, 60.0)  # of a ZED2 at 720p: a camera gives one of these and nothing between
ALONE_S = 20.0
PAIRS = 100
PRESET = "realistic"


@dataclass(frozen=True, slots=True)
class Plan:
    """What to run. A block is `seconds` without clients and as long with them."""

    n: int
    seconds: float
    readers: int
    rate_hz: float
    seed: int
    replay_hz: float = 0.0  # 0: the camera's fastest that vision holds alone
    alone_s: float = ALONE_S
    pairs: int = PAIRS


def load(
    n: Annotated[int, typer.Option(min=1, help="blocks, each once without and once with clients")] = 5,
    seconds: Annotated[float, typer.Option(min=1.0, help="of each half of a block")] = 60.0,
    readers: Annotated[int, typer.Option(min=0, max=190, help="readers of /v1/events")] = 50,
    rate: Annotated[float, typer.Option(min=0.1, help="GET /v1/state a second")] = 200.0,
    seed: Annotated[int, typer.Option(help="of the simulated machine")] = 1,
    replay_hz: Annotated[
        float, typer.Option(min=0.0, help="pairs a second; 0: the camera's fastest rate that vision holds alone")
    ] = 0.0,
    folder: Annotated[Path, typer.Option(help="where every block is saved; a second run resumes")] = FOLDER,
) -> None:
    """REST answers, PLC underruns and vision's rate: 50 readers and 200 questions a second, a move on."""
    console, plan = Console(width=200), Plan(n, seconds, readers, rate, seed, replay_hz)
    verdict = verdict_of(bench(plan, folder, console), readers)
    (folder / f"result-{seed}.json").write_text(json.dumps(asdict(verdict), indent=1), encoding="utf-8")
    console.print(summary(verdict), highlight=False)
    if not verdict.holds:
        raise typer.Exit(1)


def bench(plan: Plan, folder: Path, console: Console) -> list[Block]:
    """Run or resume; every half block is saved as soon as it is over."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(1, plan.n + 1):
        missing = [clients for clients in (False, True) if not _file(plan, folder, number, clients).exists()]
        for block in _blocks(plan, folder, number, missing, console) if missing else ():
            text = json.dumps(asdict(block))
            _file(plan, folder, number, block.clients).write_text(text, encoding="utf-8")
            console.print(line(block), highlight=False)
    files = [_file(plan, folder, number, clients) for number in range(1, plan.n + 1) for clients in (False, True)]
    return [block_from(json.loads(file.read_text(encoding="utf-8"))) for file in files]


def _blocks(plan: Plan, folder: Path, number: int, halves: list[bool], console: Console) -> Iterator[Block]:
    """Vision alone, then everything: a shared computer's speed is another one some minutes later."""
    machine_text = read_machine_text("hiab033")
    machine = parse_machine_toml(machine_text)
    files = render_pairs(machine, folder / f"pairs-{plan.seed}", plan.pairs, plan.seed)
    replay_hz = plan.replay_hz or _held_hz(plan, machine, files, console)
    with stage(machine_text, PRESET, plan.seed, files, replay_hz, folder) as at_work:
        asked = Demand(at_work.stack.ports.http, plan.readers, plan.rate_hz, plan.seconds)
        for clients in halves:
            yield at_work.block(number, asked, clients)


def _file(plan: Plan, folder: Path, number: int, clients: bool) -> Path:
    kind = f"{plan.readers}x{plan.rate_hz:g}" if clients else "quiet"
    fed = f"-{plan.replay_hz:g}hz" if plan.replay_hz else ""
    return folder / f"{plan.seed}-{plan.seconds:g}s{fed}-{number}-{kind}.json"


def _held_hz(plan: Plan, machine: Machine, files: list[Path], console: Console) -> float:
    """The rate that vision holds with nothing beside it, measured now."""
    with ReplayCamera(files, OFFERED_HZ) as camera:
        vision = VisionClient(VisionSettings(source=HttpSource(camera.url)), machine)
        pairs_per_s, process_ms = asyncio.run(vision_alone(vision, plan.alone_s))
    text = f"vision alone: {pairs_per_s:.1f} pairs/s of {OFFERED_HZ:.0f}, {process_ms:.0f} ms a pair"
    console.print(f"{text}; replayed at {held(pairs_per_s):.0f} pairs/s", highlight=False)
    return held(pairs_per_s)


def held(pairs_per_s: float) -> float:
    """The fastest of the camera's rates that vision keeps up with; the slowest if it keeps up with none."""
    return max((rate_hz for rate_hz in CAMERA_RATES_HZ if rate_hz <= pairs_per_s), default=CAMERA_RATES_HZ[0])


def line(block: Block) -> str:
    """Half a block in one line."""
    late = percentiles([float(us) for us in block.latencies_us if us >= 0])
    asked = f"{late.n} answers {late.p50_us / 1e3:.1f} / {late.p99_us / 1e3:.1f} / {late.max_us / 1e3:.1f} ms"
    told = f"{asked} (p50/p99/max), {block.events} events to {block.readers_at_end} readers, " if block.clients else ""
    cpu = ", ".join(f"{name} {100 * share:.0f}" for name, share in block.cpu_frac.items())
    jobs = ", ".join(f"{count} {name}" for name, count in block.jobs.items()) or "no job ended"
    return (
        f"block {block.number} {'with clients' if block.clients else 'quiet'}: {told}{block.pairs_per_s:.1f} pairs/s, "
        f"{block.underruns} underruns, RUN {100 * block.run_frac:.0f} %, {jobs}; CPU {cpu} %; "
        f"clients late by {block.late_start_max_us / 1e3:.0f} ms at most"
    )


def summary(verdict: Verdict) -> str:
    """All blocks, against the limits."""
    return (
        f"N reached {verdict.blocks} blocks, {verdict.questions} questions: GET /v1/state p50 {verdict.p50_ms:.1f}, "
        f"p99 {verdict.p99_ms:.1f}, max {verdict.max_ms:.1f} ms (limit of p99 {P99_MAX_MS:.0f}); "
        f"{verdict.unanswered} unanswered, {verdict.not_200} not 200; underruns {verdict.underruns}; "
        f"vision {verdict.pairs_per_s:.1f} pairs/s, quiet {verdict.pairs_per_s_quiet:.1f}: "
        f"{100 * verdict.lost_frac:.1f} % below the rate replayed, {100 * verdict.lost_by_clients_frac:.1f} % by "
        f"the clients (limit {100 * LOST_MAX_FRAC:.0f}); PLC in RUN {100 * verdict.run_frac:.0f} % of the time; "
        f"{verdict.readers_lost} readers lost, {verdict.events} events: {'holds' if verdict.holds else 'DOES NOT HOLD'}"
    )
