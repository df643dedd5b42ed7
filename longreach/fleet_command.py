"""`longreach fleet ...`: many machines from one program. Short on purpose: an example to copy."""

import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import httpx
import typer
from rich.console import Console
from rich.table import Table

from longreach.fleet_client import Finished, JobClient, JobRefusedError, SteadyClient, by_proxy, read_key

app = typer.Typer(no_args_is_help=True)
console = Console()
Urls = Annotated[list[str], typer.Argument(help="the servers, one machine each")]
KeyFile = Annotated[Path | None, typer.Option(help="file with the API key", envvar="LONGREACH_KEY_FILE", exists=True)]


@app.command()
def position(urls: Urls, key_file: KeyFile = None, wait_s: float = 60.0) -> None:
    """Position all machines in parallel, each under its own lease, and report how each ended."""
    key = read_key(key_file)
    clients = [JobClient(url, owner="fleet example", kind="fleet", key=key) for url in urls]
    with ThreadPoolExecutor(len(urls)) as pool:
        try:
            ends = list(pool.map(lambda client: position_one(client, wait_s), clients))
        except KeyboardInterrupt:
            stop_all(clients)
            console.print("[bold]stopped[/]")
            raise typer.Exit(130) from None
    table = Table(title=f"machines: {len(urls)}", title_justify="left")
    for heading in ("machine", "state", "reason", "s"):
        table.add_column(heading)
    for url, end in zip(urls, ends, strict=True):
        table.add_row(url, end.state, end.reason, f"{end.elapsed_s:.0f}")
    console.print(table)
    if any(end.state != "done" or not end.result["reached"] for end in ends):
        raise typer.Exit(1)


def stop_all(clients: list[JobClient]) -> None:
    """Stop every machine that moves for this program, in parallel: one that does not answer delays no other."""
    with ThreadPoolExecutor(len(clients)) as pool:
        for client, stopping in [(client, pool.submit(client.stop_for_good)) for client in clients]:
            if error := stopping.exception():
                console.print(f"[bold red]STOP is not confirmed:[/] {client.url}: {error}")


def position_one(client: JobClient, wait_s: float = 60.0) -> Finished:
    """One machine: wait until it is ready, take control as a fleet does, position, give control back."""
    with client:
        try:
            client.wait_ready(wait_s)
            end = client.run({"kind": "position"})
        except JobRefusedError as error:
            return Finished("refused", str(error), None, 0.0)
    return Finished(end.state, end.reason or end.result["reason"], end.result, end.elapsed_s)


@app.command()
def scrape(
    urls: Urls,
    key_file: KeyFile = None,
    every_s: Annotated[float, typer.Option(help="pause between two rounds; 0 = one round")] = 0.0,
) -> None:
    """Fetch /metrics of all machines and print one line each."""
    key = read_key(key_file)
    while True:
        for url in urls:
            console.print(f"{url}: {metrics_line(url, key)}", highlight=False, soft_wrap=True)
        if every_s <= 0.0:
            return
        time.sleep(every_s)


SHOWN_METRICS = (
    "job_running",
    "faults",
    "store_ok",
    "camera_pairs_per_second",
    "plc_states_lost",
    "plc_underruns_total",
)


def metrics_line(url: str, key: str = "") -> str:
    """The figures of one machine in one line, or why they are missing."""
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    try:
        with SteadyClient(url, 5.0, headers) as client:
            text = client.get("/metrics").raise_for_status().text
    except httpx.HTTPError as error:
        return f"no metrics ({error}{by_proxy(url)})"
    rows = dict(line.rsplit(" ", 1) for line in text.splitlines() if line and not line.startswith("#"))
    return ", ".join(f"{name} {rows[f'longreach_{name}']}" for name in SHOWN_METRICS if f"longreach_{name}" in rows)
