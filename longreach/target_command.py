"""`longreach target ...`: print markers at true size, and measure their poses on tool or OOI."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, cast

import cv2
import typer
from rich.console import Console, RenderableType
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.status import Status

from longreach.target_report import layout_json, layout_table, layout_toml, sides_table, verdict_text
from machine.boards import board_marker_ids
from machine.description import Machine, StereoCamera
from machine.marker_sections import dictionary_size
from recording.files import write_durably
from server.camera.target_pictures import MarkerSearch, TargetError, live_views, stored_pairs, stored_views
from server.settings import read_machine, read_settings
from server.vision.errors import VisionError
from server.vision.marker_search import dictionary_by_name
from server.vision.target_page import PAPER_SIZES_MM, Page, board_page, marker_page, pdf_of, png_of, svg_of
from server.vision.teach import FrameName, LayoutFrame, TeachTask, teach_layout
from server.vision.teach_contracts import TaughtLayout, TeachSettings, TeachStatus, TeachView
from server.vision.teach_views import OfferedView

if TYPE_CHECKING:
    from server.camera.sources.settings import SourceSettings

app = typer.Typer(no_args_is_help=True)
MachineFile = Annotated[str, typer.Option(help="machine file, or the name of a shipped one")]
On = Annotated[str, typer.Option("--on", help="tool or ooi")]
STORED_VIEWS_MAX = 60


@app.command()
def teach(
    machine: MachineFile = "hiab033",
    on: On = "ooi",
    folder: Annotated[Path | None, typer.Option(help="stored stereo pairs, taken at rest")] = None,
    camera_url: Annotated[str | None, typer.Option(help="multipart stream of side-by-side JPEG")] = None,
    settings_file: Annotated[Path | None, typer.Option("--settings", help="the server's settings: its camera")] = None,
    ids: Annotated[str, typer.Option(help="which markers, the reference first; else those of the machine file")] = "",
    side_mm: Annotated[
        str, typer.Option(help="printed sides: 150, or 1=150,2=149.8, or none; else the machine's")
    ] = "",
    frame: Annotated[
        str, typer.Option(help="origin: present (fit to the present layout), reference, or middle")
    ] = "present",
    views: Annotated[int, typer.Option(min=4, max=200, help="live camera: how many different views")] = 12,
    timeout_s: Annotated[float, typer.Option(min=1.0, max=7200.0, help="live camera: at most this long [s]")] = 600.0,
    out: Annotated[Path | None, typer.Option(help="where to write NAME.toml and NAME.json")] = None,
) -> None:
    """Measure the marker layout of tool or OOI from stereo views. Exit code 0: found, 1: not found."""
    console = Console()
    nominal = read_machine(machine)
    task = _teach_task(nominal, _parse_target_object(on), ids, side_mm, frame)
    dictionary = _marker_dictionary(nominal)
    if folder is not None:
        camera = nominal.camera
        seen = _from_folder(folder, MarkerSearch(camera, dictionary, task.marker_ids), console)
    else:
        source, camera = live_camera(camera_url, settings_file, nominal)
        seen = _from_camera(source, MarkerSearch(camera, dictionary, task.marker_ids), task, views, timeout_s, console)
    layout = teach_layout(seen, task, camera, TeachSettings())
    _finish(layout, nominal, on, out, console)


@app.command("print")
def print_markers(
    folder: Annotated[Path, typer.Argument(help="where to write the pages")],
    machine: MachineFile = "hiab033",
    on: Annotated[str, typer.Option("--on", help="tool, ooi or both")] = "both",
    form: Annotated[str, typer.Option("--format", help="pdf, svg or png")] = "pdf",
    paper: Annotated[str | None, typer.Option(help=f"{', '.join(PAPER_SIZES_MM)}; else the smallest that fits")] = None,
    dpi: Annotated[int, typer.Option(min=100, max=1200, help="of PNG")] = 300,
) -> None:
    """Write every marker and board of the machine file in its true size, with a ruler to check the print's scale."""
    console = Console()
    if paper is not None and paper not in PAPER_SIZES_MM:
        raise TargetError(f"--paper = {paper}: give one of {', '.join(PAPER_SIZES_MM)}")
    nominal = read_machine(machine)
    try:
        pages = _target_pages(nominal, ("tool", "ooi") if on == "both" else (_parse_target_object(on),), paper)
    except ValueError as error:
        raise TargetError(str(error)) from error
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in _files_by_format(pages, form, dpi).items():
        (folder / name).write_bytes(content)
        console.print(f"written: {folder / name}", highlight=False, soft_wrap=True)
    console.print("print at 100 %, then hold a steel ruler against the printed one: it must measure 100 mm")


def _target_pages(nominal: Machine, sides: Sequence[str], paper: str | None) -> list[Page]:
    dictionary, name = _marker_dictionary(nominal), nominal.dictionary
    in_grids = {marker_id for board in nominal.boards if board.kind == "grid" for marker_id in board_marker_ids(board)}
    pages = [
        marker_page(name, dictionary, marker, paper)
        for marker in nominal.markers
        if marker.on in sides and marker.marker_id not in in_grids
    ]
    return pages + [board_page(name, dictionary, board, paper) for board in nominal.boards if board.on in sides]


def _files_by_format(pages: list[Page], form: str, dpi: int) -> dict[str, bytes]:
    if form == "pdf":
        return {"targets.pdf": pdf_of(pages)}
    if form == "svg":
        return {f"{page.name}.svg": svg_of(page) for page in pages}
    if form == "png":
        return {f"{page.name}.png": png_of(page, dpi) for page in pages}
    raise TargetError(f"--format = {form}: give pdf, svg or png")


def _parse_target_object(text: str) -> Literal["tool", "ooi"]:
    if text not in ("tool", "ooi"):
        raise TargetError(f"--on = {text}: give tool or ooi")
    return cast("Literal['tool', 'ooi']", text)


def _marker_dictionary(nominal: Machine) -> "cv2.aruco.Dictionary":
    try:
        return dictionary_by_name(nominal.dictionary)
    except VisionError as error:
        raise TargetError(str(error)) from error


def _teach_task(nominal: Machine, on: Literal["tool", "ooi"], ids: str, side_mm: str, frame: str) -> TeachTask:
    """What is to be taught, from the options and the machine file."""
    present = {marker.marker_id: marker for marker in nominal.markers_on(on)}
    wanted = _whole_numbers(ids) if ids.strip() else tuple(present)
    size = dictionary_size(nominal.dictionary)
    beyond = [marker_id for marker_id in wanted if marker_id < 0 or (size is not None and marker_id >= size)]
    if beyond:
        raise TargetError(f"--ids: {beyond[0]} is not in {nominal.dictionary}, whose last id is {(size or 0) - 1}")
    if frame not in ("present", "reference", "middle"):
        raise TargetError(f"--frame = {frame}: give present, reference or middle")
    sides = {marker_id: present[marker_id].side_m for marker_id in wanted if marker_id in present}
    places = {
        marker_id: (present[marker_id].T_on_marker, present[marker_id].side_m)
        for marker_id in wanted
        if marker_id in present
    }
    return TeachTask(wanted, _printed_sides_m(side_mm, wanted, sides), LayoutFrame(cast("FrameName", frame), places))


def _whole_numbers(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in text.split(",") if part.strip())
    except ValueError as error:
        raise TargetError(f"--ids = {text}: give whole numbers such as 1,2,3") from error


def _printed_sides_m(text: str, ids: Sequence[int], present_m: Mapping[int, float]) -> dict[int, float]:
    """Printed sides [m] as far as they are known."""
    text = text.strip()
    if not text:
        return dict(present_m)
    if text == "none":
        return {}
    try:
        if "=" not in text:
            sides = dict.fromkeys(ids, 1e-3 * float(text))
        else:
            pairs = [part.split("=") for part in text.split(",") if part.strip()]
            sides = {int(marker_id): 1e-3 * float(side) for marker_id, side in pairs}
    except ValueError as error:
        raise TargetError(f"--side-mm = {text}: give 150, or 1=150,2=149.8, or none") from error
    for marker_id, side in sides.items():
        if marker_id not in ids or not 0.005 <= side <= 2.0:
            raise TargetError(f"--side-mm: {marker_id}={1e3 * side:g} must be of --ids, and between 5 and 2000 [mm]")
    return sides


def _from_folder(folder: Path, search: MarkerSearch, console: Console) -> list[TeachView]:
    pairs = stored_pairs(folder)
    found: list[TeachView] = []
    columns = (TextColumn("views"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=console) as progress:
        bar = progress.add_task("", total=min(len(pairs), STORED_VIEWS_MAX))
        for name, view in stored_views(pairs, search, STORED_VIEWS_MAX):
            found.append(view)
            progress.update(
                bar, advance=1, description=f"{escape(name)}: markers {_seen_marker_ids_text(view) or 'none'}"
            )
    return found


def live_camera(url: str | None, settings_file: Path | None, nominal: Machine) -> "tuple[SourceSettings, StereoCamera]":
    """What to open, and what its pictures are: as in the server, a calibration in the settings rectifies them.

    Raises: SettingsError, CalibrationFileError: file, field, remedy.
    """
    from server.camera.sources.settings import HttpSource
    from server.settings_source import source_and_machine

    if url:
        return HttpSource(url), nominal.camera
    source, machine = source_and_machine(read_settings(settings_file).camera, nominal)
    return source, machine.camera


def _from_camera(
    camera: "SourceSettings", search: MarkerSearch, task: TeachTask, n_views: int, timeout_s: float, console: Console
) -> list[TeachView]:
    """Guided: the operator moves the camera, rests, and hears what is still missing. Ctrl-C ends the collection."""
    from server.camera.sources.opening import open_source

    source = open_source(camera)
    settings = TeachSettings()
    console.print(
        f"markers {', '.join(map(str, task.marker_ids))}: hold the camera still, then move it to the side, up or down "
        f"by a third of its distance, and hold it still again; {n_views} views; Ctrl-C when you have enough"
    )
    with console.status("waiting for images") as status:

        def report(offer: OfferedView, view: TeachView, kept: list[TeachView]) -> None:
            _show_view_advice(offer, view, kept, n_views, status, console)
            if offer is OfferedView.TAKEN and len(kept) >= settings.views_min:
                console.print(
                    f"  so far: {_so_far(teach_layout(kept, task, search.camera, settings))}", highlight=False
                )

        try:
            return live_views(source, search, settings, n_views, timeout_s, report)
        finally:
            source.close()


def _show_view_advice(
    offer: OfferedView, view: TeachView, kept: list[TeachView], n_views: int, status: Status, console: Console
) -> None:
    advice = {
        OfferedView.TOO_FEW_MARKERS: "show at least two complete markers",
        OfferedView.MOVING: "hold still",
        OfferedView.ALIKE: "move to the side, up or down, closer or away",
        OfferedView.TAKEN: "taken",
    }[offer]
    if offer is OfferedView.TAKEN:
        console.print(f"view {len(kept)} of {n_views}: markers {_seen_marker_ids_text(view)}", highlight=False)
    status.update(f"{len(kept)} of {n_views} views; sees {_seen_marker_ids_text(view) or 'none'}; {advice}")


def _so_far(layout: TaughtLayout) -> str:
    return f"+-{layout.sigma_mm:.2f} mm" if layout.status is TeachStatus.OK else layout.reason


def _seen_marker_ids_text(view: TeachView) -> str:
    return ", ".join(str(marker_id) for marker_id in sorted(view.left_corners_px.keys() | view.right_corners_px.keys()))


def _finish(layout: TaughtLayout, nominal: Machine, on: str, out: Path | None, console: Console) -> None:
    """Show and write what was found; exit with 1 where there is no layout."""
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_durably(out.with_suffix(".json"), layout_json(layout, on))
    if layout.status is not TeachStatus.OK:
        console.print(f"[bold red]no layout ({layout.status.value}):[/] {escape(layout.reason)}", soft_wrap=True)
        raise typer.Exit(1)
    _print_message(console, layout_table(layout, {marker.marker_id: marker for marker in nominal.markers}))
    _print_message(console, sides_table(layout))
    _print_message(console, verdict_text(layout))
    for note in layout.notes:
        console.print(f"note: {escape(note)}", style="yellow")
    text = layout_toml(layout, on)
    if out is None:
        console.print("\nfor the machine file:\n")
        console.print(escape(text), highlight=False, soft_wrap=True)
        return
    write_durably(out.with_suffix(".toml"), text)
    console.print(f"for the machine file: {out.with_suffix('.toml')}; with covariance: {out.with_suffix('.json')}")


def _print_message(console: Console, what: RenderableType) -> None:
    console.print(what, highlight=False, soft_wrap=isinstance(what, str))
