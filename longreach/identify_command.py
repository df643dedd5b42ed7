"""`longreach identify`: plan and execute the test drive, wait for its budget, use its effects, over REST."""

import time
from pathlib import Path
from typing import Annotated, Any

import httpx
import typer
from rich.console import Console
from rich.table import Table

from longreach.fleet_client import JobClient, JobRefusedError, read_key
from recording.files import write_durably

JOB_POLL_PERIOD_S = 2.0


def identify(
    url: Annotated[str, typer.Option(help="the server")] = "http://127.0.0.1:8080",
    minutes: Annotated[
        float, typer.Option(help="approximate duration [min]; shorter drives identify less", min=1.5, max=6.0)
    ] = 6.0,
    wall_free: Annotated[
        bool, typer.Option(help="you confirm that no wall is within reach; required where none is measured")
    ] = False,
    resume: Annotated[bool, typer.Option(help="only the remaining parts of a paused drive")] = False,
    use: Annotated[bool, typer.Option("--use", help="use the effects found from now on")] = False,
    only_plan: Annotated[bool, typer.Option("--plan", help="show the plan without moving")] = False,
    machine_out: Annotated[Path | None, typer.Option(help="write the machine file with the effects here")] = None,
    owner: Annotated[str, typer.Option(help="who asks")] = "cli",
    kind: Annotated[
        str, typer.Option(help="control as operator, fleet (a fleet's key, or none) or engineer")
    ] = "operator",
    key_file: Annotated[
        Path | None, typer.Option(help="file with the API key", envvar="LONGREACH_KEY_FILE", exists=True)
    ] = None,
    wait_s: Annotated[float, typer.Option(help="how long to wait for the server to be ready")] = 30.0,
) -> None:
    """Identify this machine: one test drive, its error budget, and the effects to use."""
    console = Console()
    client = JobClient(url, owner=owner, kind=kind, key=read_key(key_file))
    try:
        client.wait_ready(wait_s)
        plan = _run(
            console, client, {"kind": "plan_identify", "minutes": minutes, "wall_free": wall_free, "resume": resume}
        )
        console.print(plan_table(plan))
        for line in plan["cannot"]:
            console.print(f"[yellow]cannot:[/] {line}", soft_wrap=True)
        if only_plan:
            return
        driven = _run(console, client, {"kind": "identify", "plan_hash": plan["plan_hash"]})
        if not driven["followed_by"]:
            raise JobRefusedError(driven["not_followed"] or "it was not diagnosed")
        answer = _wait_for_diagnosis(console, client, driven["followed_by"])
        console.print(budget_table(answer))
        console.print(answer["budget"]["sentence"], soft_wrap=True)
        _take_up(console, client, driven["followed_by"], use, machine_out)
    except JobRefusedError as error:
        console.print(f"[bold red]refused:[/] {error}", soft_wrap=True)
        raise typer.Exit(2) from error
    except httpx.HTTPError as error:
        console.print(f"[bold red]server:[/] {error}", soft_wrap=True)
        raise typer.Exit(2) from error
    except KeyboardInterrupt as ending:
        console.print(f"[bold]stopped[/] {' '.join(getattr(ending, '__notes__', ()))}; --resume continues")
        raise typer.Exit(130) from None
    finally:
        client.close()


def _run(console: Console, client: JobClient, body: dict[str, Any]) -> dict[str, Any]:
    with console.status(body["kind"].replace("_", " ")) as status:

        def show(event: dict[str, Any]) -> None:
            status.update(event["text"])
            if event["name"] != "ended":
                console.print(f"[dim]{event['elapsed_s']:6.1f} s[/]  {event['text']}", soft_wrap=True)

        finished = client.run(body, show)
    if finished.state != "done" or finished.result is None:
        raise JobRefusedError(f"{finished.state}: {finished.reason}")
    return finished.result


def _wait_for_diagnosis(console: Console, client: JobClient, diagnosis_id: str) -> dict[str, Any]:
    with console.status("diagnosing") as status:
        while True:
            one = client.get(f"/v1/diagnoses/{diagnosis_id}")
            if one["state"] not in ("waiting", "running"):
                break
            status.update(f"diagnosing, {one['elapsed_s']:.0f} s: {one['last_line']}")
            time.sleep(JOB_POLL_PERIOD_S)
    if one["state"] != "done":
        raise JobRefusedError(f"diagnosis {one['state']}: {one['reason']}")
    return client.get(f"/v1/diagnoses/{diagnosis_id}/result")


def _take_up(console: Console, client: JobClient, diagnosis_id: str, use: bool, machine_out: Path | None) -> None:
    if not use and machine_out is None:
        console.print("not in use yet: --use, or 'Use these effects' in the panel's Gap tab")
        return
    version = client.send("POST", "/v1/machine/versions", {"diagnosis_id": diagnosis_id})
    if use:
        client.send("PUT", "/v1/machine/in-use", {"version_id": version["version_id"]})
        console.print(f"in use: version {version['version_id']}, {len(version['effects'])} effects")
    if machine_out is not None:
        text = client.get_text(f"/v1/machine/versions/{version['version_id']}/file")
        try:
            write_durably(machine_out, text)
        except OSError as error:
            raise JobRefusedError(f"{machine_out} cannot be written: {error.strerror}") from error
        console.print(f"{machine_out}: the machine file with these effects")


def plan_table(plan: dict[str, Any]) -> Table:
    """What would be driven, part by part."""
    title = (
        f"{plan['duration_s'] / 60.0:.1f} min, {plan['looks']} looks, TCP at most {plan['tcp_speed_max_mm_s']:.0f} mm/s"
    )
    table = Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0))
    for heading in ("part", "s", "shows", "cannot"):
        table.add_column(heading, justify="right" if heading == "s" else "left")
    for part in plan["parts"]:
        table.add_row(part["name"], f"{part['duration_s']:.0f}", ", ".join(part["shows"]), part["cannot"])
    return table


def budget_table(answer: dict[str, Any]) -> Table:
    """The budget, the largest effect first."""
    table = Table(title=answer["verdict"], title_justify="left", box=None, padding=(0, 2, 0, 0))
    for heading in ("effect", "joint", "column", "mm at the tool", "90 %", "p", ""):
        table.add_column(heading, justify="left" if heading in ("effect", "column", "") else "right")
    for effect in answer["budget"]["effects"]:
        limits = f"{effect['tool_low_mm']:.2f} .. {effect['tool_high_mm']:.2f}"
        joint = "" if effect["joint"] is None else str(effect["joint"])
        size, chance = f"{effect['tool_mm']:.2f}", f"{effect['probability']:.2f}"
        table.add_row(effect["name"], joint, effect["column"], size, limits, chance, effect["status"])
    return table
