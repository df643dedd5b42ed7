"""`longreach bench scale`: what one machine makes, measured, and what a thousand would (docs/scale.md)."""

import json
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import httpx
import typer
from mcap.reader import make_reader
from rich.console import Console
from rich.table import Table

from longreach.diagnose_child import diagnosed_in_a_child
from longreach.fleet_client import read_key
from recording.writer import IMAGE_TOPIC

DAY_S = 86_400.0
SCRAPE_S = 15.0
FOLDER = Path("runs/bench-scale")


@dataclass(frozen=True, slots=True)
class Stream:
    """/v1/events and /metrics of one running server."""

    seconds: float
    events: int
    event_bytes: int
    quiet_events: int  # with ?state=false
    quiet_bytes: int
    scrape_bytes: int
    scrape_ms: float


@dataclass(frozen=True, slots=True)
class Weight:
    """One recording of a job, and what diagnosing it costs."""

    name: str
    job_s: float
    file_bytes: int
    image_bytes: int
    messages: int
    diagnosis_cpu_s: float | None
    diagnosis_wall_s: float | None


@dataclass(frozen=True, slots=True)
class Fleet:
    """What is assumed of the fleet; everything else is measured."""

    machines: int
    jobs_per_day: float
    diagnosed_frac: float


def scale(
    recording: Annotated[Path | None, typer.Option(exists=True, dir_okay=False, help="of a positioning job")] = None,
    url: Annotated[str, typer.Option(help="a running server, whose events and metrics are weighed")] = "",
    key_file: Annotated[Path | None, typer.Option(help="file with the API key", exists=True)] = None,
    seconds: Annotated[float, typer.Option(min=2.0, help="how long to listen")] = 30.0,
    diagnose: Annotated[bool, typer.Option(help="also measure the CPU time of its diagnosis")] = True,
    machines: Annotated[int, typer.Option(min=1)] = 1000,
    jobs_per_day: Annotated[float, typer.Option(min=0.0, help="positioning jobs of a machine")] = 200.0,
    diagnosed_pct: Annotated[float, typer.Option(min=0.0, max=100.0, help="of all jobs")] = 1.0,
    folder: Annotated[Path, typer.Option(help="where the figures are saved")] = FOLDER,
) -> None:
    """Events, bytes and diagnosis CPU of one machine; the same for many."""
    if recording is None and not url:
        raise typer.BadParameter("give --recording, --url, or both: there is nothing to measure")
    stream = listen(url, read_key(key_file), seconds) if url else None
    weight = weigh(recording, diagnose) if recording is not None else None
    fleet = Fleet(machines, jobs_per_day, diagnosed_pct / 100.0)
    folder.mkdir(parents=True, exist_ok=True)
    told = {name: asdict(one) if one else None for name, one in (("stream", stream), ("weight", weight))}
    (folder / "one-machine.json").write_text(json.dumps(told | {"fleet": asdict(fleet)}, indent=1), encoding="utf-8")
    Console(width=120).print(table_of(rows_of(stream, weight, fleet), fleet))


def listen(url: str, key: str, seconds: float) -> Stream:
    """Read events with and without the state for that long, and the metrics once.

    Raises: httpx.HTTPError: the server does not answer.
    """
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    with httpx.Client(base_url=url, headers=headers, timeout=30.0) as http:
        events, event_bytes = _events(http, "/v1/events", seconds)
        quiet_events, quiet_bytes = _events(http, "/v1/events?state=false", seconds)
        started_s = time.perf_counter()
        metrics = http.get("/metrics").raise_for_status()
        scrape_ms = (time.perf_counter() - started_s) * 1e3
    return Stream(seconds, events, event_bytes, quiet_events, quiet_bytes, len(metrics.content), scrape_ms)


def _events(http: httpx.Client, path: str, seconds: float) -> tuple[int, int]:
    """Events and bytes of one reader; the keep-alive comments, one in ten seconds, end the waiting."""
    until_s, events, size = time.monotonic() + seconds, 0, 0
    with http.stream("GET", path) as stream:
        for text in stream.iter_text():
            events += text.count("event: ")
            size += len(text.encode())
            if time.monotonic() > until_s:
                break
    return events, size


def weigh(recording: Path, diagnose: bool) -> Weight:
    """Sizes from the recording itself; CPU of `longreach diagnose` as the operating system counts it."""
    with recording.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        image_bytes = sum(len(message.data) for _, _, message in reader.iter_messages(topics=[IMAGE_TOPIC]))
    statistics = summary.statistics if summary is not None else None
    job_s = (statistics.message_end_time - statistics.message_start_time) * 1e-9 if statistics else 0.0
    cpu_s, wall_s = _diagnosed(recording) if diagnose else (None, None)
    messages = statistics.message_count if statistics else 0
    return Weight(recording.name, job_s, recording.stat().st_size, image_bytes, messages, cpu_s, wall_s)


def _diagnosed(recording: Path) -> tuple[float, float]:
    with tempfile.TemporaryDirectory() as scratch:
        used = diagnosed_in_a_child(recording, Path(scratch) / "answer.json", niceness=5)
    return used.cpu_s, used.wall_s


def rows_of(stream: Stream | None, weight: Weight | None, fleet: Fleet) -> Iterator[tuple[str, str, str]]:
    """(what, one machine, all machines)."""
    n = fleet.machines
    if stream is not None:
        rate, quiet = stream.event_bytes / stream.seconds, stream.quiet_bytes / stream.seconds
        events, calm = stream.events / stream.seconds, stream.quiet_events / stream.seconds
        yield "events/s, a reader with the state", f"{events:.2f}", f"{n * events:,.0f}"
        yield "events/s, without the state", f"{calm:.2f}", f"{n * calm:,.0f}"
        yield "bytes/s, a reader with the state", f"{rate:,.0f}", f"{n * rate:,.0f}"
        yield "bytes/s, without the state", f"{quiet:,.0f}", f"{n * quiet:,.0f}"
        scrapes = stream.scrape_bytes * DAY_S / SCRAPE_S
        yield f"metrics/day, a scrape in {SCRAPE_S:.0f} s", f"{scrapes / 1e6:,.1f} MB", f"{n * scrapes / 1e9:,.1f} GB"
    if weight is not None:
        day, bare = (size * fleet.jobs_per_day for size in (weight.file_bytes, weight.file_bytes - weight.image_bytes))
        yield "recordings/day, with pictures", f"{day / 1e9:,.1f} GB", f"{n * day / 1e12:,.1f} TB"
        yield "recordings/day, numbers alone", f"{bare / 1e9:,.2f} GB", f"{n * bare / 1e12:,.2f} TB"
        link = 8.0 * day / DAY_S
        yield "uplink for all of it, mean", f"{link / 1e6:,.1f} Mbit/s", f"{n * link / 1e9:,.1f} Gbit/s"
        if weight.diagnosis_cpu_s is not None:
            cores = weight.diagnosis_cpu_s * fleet.jobs_per_day * fleet.diagnosed_frac / DAY_S
            yield "CPU of one diagnosis", f"{weight.diagnosis_cpu_s:,.0f} s", ""
            yield "cores for diagnoses", f"{cores:.4f}", f"{n * cores:,.1f}"


def table_of(rows: Iterator[tuple[str, str, str]], fleet: Fleet) -> Table:
    """The table of docs/scale.md."""
    assumed = f"{fleet.jobs_per_day:g} jobs a day each, {100 * fleet.diagnosed_frac:g} % of them diagnosed"
    table = Table("what", "one machine, measured", f"{fleet.machines} machines", title=assumed, title_justify="left")
    for row in rows:
        table.add_row(*row)
    return table
