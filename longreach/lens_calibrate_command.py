"""`longreach camera calibrate`: the lens of one eye or a stereo rig from pictures of a ChArUco board."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import track
from rich.table import Column, Table

from longreach.board_pictures import board_of, corners_of, grey_picture
from longreach.lens_files import write_lens
from longreach.target_sources import SUFFIXES, TargetError, read_pair, stored_pairs
from recording.files import write_durably
from server.calibration.lens_fit import BoardView, Coverage, LensFit, LensFitError, coverage_of, fit_lens

SHADES = " .:*#"


def calibrate(
    folder: Annotated[Path, typer.Argument(help="pictures of the board: stereo pairs, or with --mono of one eye")],
    squares: Annotated[str, typer.Option(help="the board's squares across and down, such as 11x8")],
    square_mm: Annotated[float, typer.Option(min=1.0, max=2000.0, help="side of a square [mm], measured on the print")],
    marker_mm: Annotated[float, typer.Option(min=1.0, max=2000.0, help="side of a marker [mm]")],
    dictionary: Annotated[str, typer.Option(help="the markers' dictionary")] = "DICT_5X5_100",
    legacy_pattern: Annotated[bool, typer.Option(help="a board printed with OpenCV before 4.6")] = False,
    mono: Annotated[bool, typer.Option("--mono", help="one eye")] = False,
    out: Annotated[Path | None, typer.Option("--out", help="folder for ROS, OpenCV, Kalibr and ZED files")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="write the full result here (JSON)")] = None,
) -> None:
    """Calibrate lens and stereo rig: intrinsics with sigmas, coverage, what to photograph next. Exit code 1: failed."""
    screen = Console()
    views, size = board_views(
        _pictures(folder, mono), mono, board_of(squares, square_mm, marker_mm, dictionary, legacy_pattern)
    )
    try:
        fit = fit_lens(views, size)
    except LensFitError as error:
        screen.print(f"[bold red]not calibrated[/]: {escape(str(error))}", soft_wrap=True)
        raise typer.Exit(1) from error
    covered = coverage_of(views, fit)
    _show(fit, covered, screen)
    try:
        if json_file is not None:
            write_durably(json_file, json.dumps(_answer(fit, covered), indent=1) + "\n")
        if out is not None:
            written, notes = write_lens(fit, out)
            screen.print("written: " + escape(", ".join(str(path) for path in written)), soft_wrap=True)
            for note in notes:
                screen.print(escape(note), soft_wrap=True)
    except OSError as error:
        raise TargetError(f"{error.filename} cannot be written: {error.strerror}") from error


def _pictures(folder: Path, mono: bool) -> list[tuple[Path, Path | None]]:
    if not mono:
        return stored_pairs(folder)
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES) if folder.is_dir() else []
    if not files:
        raise TargetError(f"{folder}: no pictures; give a folder of PNG or JPEG")
    return [(path, None) for path in files]


def board_views(
    files: Sequence[tuple[Path, Path | None]], mono: bool, board: "cv2.aruco.CharucoBoard"
) -> tuple[list[BoardView], tuple[int, int]]:
    """The corners in every picture, and the size of one eye's [px].

    Raises: TargetError: no picture, or pictures of several sizes.
    """
    detector = cv2.aruco.CharucoDetector(board)
    points = np.asarray(board.getChessboardCorners(), dtype=float)
    views, sizes = [], set[tuple[int, int]]()
    for left, right in track(files, "looking for the board", console=Console(stderr=True), transient=True):
        images = (grey_picture(left),) if mono else read_pair(left, right)
        sizes |= {(image.shape[1], image.shape[0]) for image in images}
        eyes = [corners_of(detector, points, image) for image in images]
        views.append(BoardView(left.stem, tuple(eyes)))
    if len(sizes) != 1:
        raise TargetError(f"pictures of several sizes {sorted(sizes)}; give those of one setting of the camera")
    return views, sizes.pop()


def _show(fit: LensFit, covered: Coverage, screen: Console) -> None:
    sigmas = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    table = Table("what", Column("value", justify="right"), Column("sigma", justify="right"))
    for name, value, sigma in zip(fit.names, fit.values, sigmas, strict=True):
        table.add_row(name, f"{value:.6g}", f"{sigma:.2g}")
    screen.print(table)
    screen.print(f"{len(fit.used)} views, rms {fit.rms_px:.3f} px a coordinate")
    for name, why in fit.dropped:
        screen.print(f"[yellow]left out[/] {escape(name)}: {escape(why)}", soft_wrap=True)
    most = max(int(covered.corners.max()), 1)
    for eye, counts in enumerate(covered.corners):
        screen.print(f"corners in the picture of eye {eye + 1} (blank: none)")
        for row in counts:
            screen.print(escape("|" + "".join(3 * SHADES[min(4, -(-4 * int(n) // most))] for n in row) + "|"))
    for text in covered.advice:
        screen.print(f"[yellow]next[/] {escape(text)}", soft_wrap=True)


def _answer(fit: LensFit, covered: Coverage) -> dict[str, object]:
    sigmas = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    return {
        "size_px": list(fit.size_px),
        "values": dict(zip(fit.names, fit.values.tolist(), strict=True)),
        "sigmas": dict(zip(fit.names, sigmas.tolist(), strict=True)),
        "covariance": fit.covariance.tolist(),
        "rms_px": fit.rms_px,
        "used": list(fit.used),
        "dropped": [list(pair) for pair in fit.dropped],
        "coverage": covered.corners.tolist(),
        "next": list(covered.advice),
    }
