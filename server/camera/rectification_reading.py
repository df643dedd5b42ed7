"""Calibration files from disk: one, two, or a folder that holds them."""

from collections.abc import Sequence
from pathlib import Path

from recording.files import read_text
from server.camera.rectification_files import CalibrationFileError, CalibrationText, RigCalibration, parse_calibration

IN_FOLDER = (  # pairs looked for, in this order
    ("mav0/cam0/sensor.yaml", "mav0/cam1/sensor.yaml"),
    ("cam0/sensor.yaml", "cam1/sensor.yaml"),
    ("left.yaml", "right.yaml"),
    ("intrinsics.yml", "extrinsics.yml"),
    ("calib.txt",),
)


def read_calibration(paths: Sequence[str], size_px: tuple[int, int], off_centre: bool = False) -> RigCalibration:
    """The rig of one or two files, or of a folder with EuRoC's, ROS', OpenCV's or KITTI's files.

    Args:   off_centre: a principal point far from the middle is right.

    Raises: CalibrationFileError: file, field, remedy.
    """
    files = (
        _in_folder(Path(paths[0])) if len(paths) == 1 and Path(paths[0]).is_dir() else [Path(path) for path in paths]
    )
    return parse_calibration([CalibrationText(str(file), _text(file)) for file in files], size_px, off_centre)


def _in_folder(folder: Path) -> list[Path]:
    for names in IN_FOLDER:
        files = [folder / name for name in names]
        if all(file.is_file() for file in files):
            return files
    looked = ", ".join(" + ".join(names) for names in IN_FOLDER)
    raise CalibrationFileError(f"calibration folder {folder}: none of {looked}; give the files themselves")


def _text(file: Path) -> str:
    try:
        return read_text(file)
    except OSError as error:
        raise CalibrationFileError(
            f"calibration file {file}: {error.strerror}; give a calibration file that can be read"
        ) from error
