"""`longreach calibration ...`: show the local calibration, and export it for other programs."""

from pathlib import Path
from typing import Annotated, Any, NoReturn

import httpx
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from longreach.fleet_client import SteadyClient, by_proxy, reason_in
from recording.files import read_text, write_durably
from server.calibration.calibration_export import as_ros, as_yaml
from server.calibration.calibration_file import CalibrationFileError, SavedCalibration, parse_calibration
from server.calibration.calibration_life import observability_text

app = typer.Typer(no_args_is_help=True)
Url = Annotated[str, typer.Option(help="the server")]
File = Annotated[Path | None, typer.Option("--file", help="a saved calibration.json instead of a server")]
DEFAULT_URL = "http://127.0.0.1:8080"


@app.command()
def show(url: Url = DEFAULT_URL, file: File = None) -> None:
    """Show the camera mount and the local map: age, sigma, residual, range of validity."""
    rows = _rows_of_file(_load_calibration(file)) if file else _rows_of_server(_get_from_server(url, "").json())
    table = Table(title="local calibration", title_justify="left", show_header=False)
    for name, value in rows:
        table.add_row(name, escape(value))
    Console().print(table)


@app.command()
def export(
    url: Url = DEFAULT_URL,
    file: File = None,
    form: Annotated[str, typer.Option("--format", help="yaml, or ros (static transform)")] = "yaml",
    out: Annotated[Path | None, typer.Option("--out", help="file to write; standard output when absent")] = None,
) -> None:
    """Write the calibration as YAML or as ROS's static transform."""
    if form not in ("yaml", "ros"):
        raise typer.BadParameter(f"format is {form!r}; give yaml or ros")
    text = (
        _export_of_file(_load_calibration(file), form) if file else _get_from_server(url, f"/export?format={form}").text
    )
    if out is None:
        print(text, end="")
        return
    try:
        write_durably(out, text)
    except OSError as error:
        _exit_with_error(f"{out}: {error.strerror}; give a writable file")


def _load_calibration(file: Path) -> SavedCalibration:
    try:
        return parse_calibration(read_text(file))
    except OSError as error:
        _exit_with_error(f"{file}: {error.strerror}; give a calibration.json of longreach")
    except (CalibrationFileError, UnicodeDecodeError) as error:
        _exit_with_error(f"{file}: {error}")


def _get_from_server(url: str, path: str) -> httpx.Response:
    try:
        with SteadyClient(url, 10.0) as client:
            answer = client.get(f"/v1/calibration{path}")
    except (httpx.TransportError, httpx.InvalidURL) as error:
        _exit_with_error(
            f"server {url} does not answer ({error}){by_proxy(url)}; start it with 'longreach serve', or give --file"
        )
    if answer.status_code != 200:
        _exit_with_error(reason_in(answer))
    return answer


def _exit_with_error(text: str) -> NoReturn:
    Console(stderr=True).print(f"[bold red]longreach:[/] {escape(text)}", soft_wrap=True)
    raise typer.Exit(2)


def _rows_of_server(view: dict[str, Any]) -> list[tuple[str, str]]:
    valid = "valid" if view["valid"] else "EXPIRED"
    far = "" if view["distance_mm"] is None else f", the tool is {view['distance_mm']:.0f} mm away"
    return [
        ("state", f"{valid} {view['expiry_reason']}".strip()),
        ("age", f"{(view['age_s'] or 0.0) / 60.0:.1f} min (limit {view['age_max_h']:g} h)"),
        ("valid within", f"{view['radius_mm']:.0f} mm of where it was made{far}"),
        *_accuracy_rows(view["sigma_deg"], view["from_nominal_deg"], view["residual_rms_mm"], view["n_used"]),
        ("observability", view["observability_text"]),
        ("camera time offset", f"{view['time_offset_ms']:.0f} ms"),
    ]


def _rows_of_file(saved: SavedCalibration) -> list[tuple[str, str]]:
    one = saved.calibration
    sigma_deg = float(one.sigmas_rad[-1]) * 57.29577951
    return [
        ("state", one.slip or "as saved; the server decides whether it is valid"),
        ("valid within", f"{1e3 * one.expiry.radius_m:.0f} mm of where it was made"),
        *_accuracy_rows(sigma_deg, one.from_nominal_deg, one.residual_rms_mm, one.n_used),
        ("observability", observability_text(one)),
        ("clock offset", f"{1e3 * one.time_offset_s:.0f} ms"),
        ("paths", str(len(saved.odometry_runs))),
    ]


def _accuracy_rows(sigma_deg: float, from_nominal_deg: float, rms_mm: float, n_used: int) -> list[tuple[str, str]]:
    return [
        (
            "camera rotation",
            f"known to {sigma_deg:.2f} deg (one sigma), {from_nominal_deg:.1f} deg off the machine file",
        ),
        ("residual", f"{rms_mm:.2f} mm rms over {n_used} samples"),
    ]


def _export_of_file(saved: SavedCalibration, form: str) -> str:
    one = saved.calibration
    found = one.valid_at(one.made_at.t_unix_s, one.made_at.q, one.made_at.T_base_tcp)
    return as_ros(one, found) if form == "ros" else as_yaml(one, found)
