"""`longreach position`: the whole look-then-move loop over REST, with progress and the table of errors."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from longreach.fleet_client import JobClient, JobRefusedError, read_key


def position(
    url: Annotated[str, typer.Option(help="the server")] = "http://127.0.0.1:8080",
    method: Annotated[str, typer.Option(help="ours or paper")] = "ours",
    owner: Annotated[str, typer.Option(help="who asks")] = "cli",
    keep_calibration: Annotated[bool, typer.Option(help="use the present calibration, if any")] = False,
    key_file: Annotated[
        Path | None, typer.Option(help="file with the API key", envvar="LONGREACH_KEY_FILE", exists=True)
    ] = None,
    kind: Annotated[
        str, typer.Option(help="control as operator, fleet (a fleet's key, or none) or engineer")
    ] = "operator",
    wait_s: Annotated[float, typer.Option(help="how long to wait for the server to be ready")] = 30.0,
) -> None:
    """Position the tool on its target: look, orient, calibrate, then look and move until inside tolerance."""
    console = Console()
    client = JobClient(url, owner=owner, kind=kind, key=read_key(key_file))
    body = {"kind": "position", "method": method, "recalibrate": not keep_calibration}
    try:
        client.wait_ready(wait_s)
        with console.status("positioning") as status:
            finished = client.run(body, lambda event: _show_event(console, status, event))
        run_id = client.run_id_of(finished.job_id)
    except JobRefusedError as error:
        console.print(f"[bold red]refused:[/] {error}")
        raise typer.Exit(2) from error
    except KeyboardInterrupt as ending:
        console.print(f"[bold]stopped[/] {' '.join(getattr(ending, '__notes__', ()))}")
        raise typer.Exit(130) from None
    finally:
        client.close()
    if run_id:
        console.print(
            f"recorded: {run_id}.mcap in the server's runs folder (a demo's is runs/PRESET-SEED/)",
            highlight=False,
            soft_wrap=True,
        )
    if finished.state != "done":
        console.print(f"[bold red]{finished.state}:[/] {finished.reason}")
        raise typer.Exit(1)
    console.print(error_table(finished.result))
    steps = ", ".join(f"{name} {seconds:.0f} s" for name, seconds in finished.result["seconds_by_step"])
    console.print(f"{finished.result['reason']}; {finished.elapsed_s:.0f} s in all ({steps})")
    if not finished.result["reached"]:
        raise typer.Exit(1)


def _show_event(console: Console, status: Any, event: dict[str, Any]) -> None:
    status.update(event["text"])
    if event["name"] == "ended":
        return  # reported below, with the outcome
    console.print(f"[dim]{event['elapsed_s']:6.1f} s[/]  {event['text']}")


def error_table(result: dict[str, Any]) -> Table:
    """Errors before and after each step, image-based."""
    title = "error of the tool against its goal, by the camera, ± one sigma"
    table = Table(title=title, title_justify="left", box=None, padding=(0, 1, 0, 0))  # whole in 80 columns
    for heading in ("step", "x mm", "y mm", "z mm", "turned deg", "path mm", "s", "trims"):
        table.add_column(heading, justify="right" if heading != "step" else "left", no_wrap=True)
    _add_error_row(table, "start", result["start"], "", "", "")
    for move in result["moves"]:
        name = f"move {move['number']}" if move["kind"] == "move" else move["kind"].removesuffix("ation")
        _add_error_row(
            table, name, move["after"], f"{move['length_mm']:.0f}", f"{move['duration_s']:.1f}", str(move["trims"])
        )
    return table


def _add_error_row(table: Table, name: str, error: dict[str, float], path: str, seconds: str, trims: str) -> None:
    axes = [f"{error[f'{axis}_mm']:+.1f} ± {error[f'sigma_{axis}_mm']:.1f}" for axis in "xyz"]
    table.add_row(name, *axes, f"{error['rotation_deg']:.2f} ± {error['sigma_rotation_deg']:.2f}", path, seconds, trims)
