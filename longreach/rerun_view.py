"""`longreach recording rerun`: a recording for Rerun, with a blueprint that shows machine, image and log together.

Needs Rerun itself (`pip install rerun-sdk`); it is in no extra, since nothing but looking needs it.
"""

import importlib
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from mcap.exceptions import McapError
from mcap.reader import make_reader
from rich.console import Console
from rich.markup import escape

from recording.writer import CALIBRATION_TOPIC, IMAGE_TOPIC, LOG_TOPIC, TRANSFORM_TOPIC

RERUN_APPLICATION_ID = "longreach"


class RerunError(Exception):
    """Rerun is not installed, or could not convert; the text says what to do."""


def rerun(
    recording: Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="an MCAP recording")],
    target: Annotated[Path, typer.Argument(help="a new .rrd file; the blueprint is written next to it as .rbl")],
) -> None:
    """Convert for Rerun, every channel, with a blueprint; open both with `rerun`."""
    try:
        convert(recording, target)
        write_blueprint(target.with_suffix(".rbl"))
    except RerunError as error:
        raise typer.BadParameter(str(error)) from error
    text = f"written; open with: rerun {target} {target.with_suffix('.rbl')}"
    Console().print(escape(text), soft_wrap=True)


def convert(recording: Path, target: Path) -> None:
    """Rerun's own conversion. Raises: RerunError: it is not there, or it failed."""
    installed = Path(sys.executable).with_name("rerun")
    program = str(installed) if installed.exists() else shutil.which("rerun")
    if program is None:
        raise RerunError(f"Rerun is not installed: {sys.executable} -m pip install rerun-sdk")
    command = [program, "mcap", "convert", str(recording), "-o", str(target), "--application-id", RERUN_APPLICATION_ID]
    _require_mcap(recording)  # of anything else Rerun makes an empty recording without a word
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RerunError(f"rerun could not convert {recording.name}: {done.stderr[-500:]}")


def _require_mcap(path: Path) -> None:
    try:
        with path.open("rb") as file:
            make_reader(file).get_header()
    except (McapError, OSError, struct.error) as error:
        raise RerunError(f"{path.name} is not an MCAP recording ({error})") from error


def import_rerun_module(name: str) -> Any:
    """A module of Rerun's. Raises: RerunError."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise RerunError(f"{name} is not installed ({error}): pip install rerun-sdk") from error


def write_blueprint(target: Path) -> None:
    """Machine with its camera in 3D, the left picture, the numbers of the PLC and of the looks, the log.

    Raises: RerunError.
    """
    rrb = import_rerun_module("rerun.blueprint")
    scene = rrb.Spatial3DView(name="machine", origin="/", contents=[TRANSFORM_TOPIC, IMAGE_TOPIC, CALIBRATION_TOPIC])
    picture = rrb.Spatial2DView(name="left eye", origin=IMAGE_TOPIC)
    numbers = rrb.Tabs(
        *(rrb.DataframeView(name=topic[1:], origin=topic) for topic in ("/plc", "/look", "/calibration"))
    )
    log = rrb.TextLogView(name="log", origin=LOG_TOPIC)
    views = rrb.Horizontal(rrb.Vertical(scene, log, row_shares=[3, 1]), rrb.Vertical(picture, numbers))
    rrb.Blueprint(views).save(RERUN_APPLICATION_ID, str(target))
