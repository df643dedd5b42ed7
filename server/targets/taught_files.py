"""Taught objects as files: one .npz a name, images as PNG, no pickled code."""

import io
import zipfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from recording.files import write_durably
from server.targets.contracts import Landmarks
from server.targets.taught import TaughtObject, TaughtView
from server.vision.contracts import Image

FILE_FORMAT_VERSION = 1
SUFFIX = ".npz"
_MARKS = ("left_px", "right_px", "points_target", "covariances_target", "support_target")


class TaughtFileError(Exception):
    """A file that holds no taught object of this version."""


def save_taught(folder: Path, taught: TaughtObject) -> Path:
    """Write an object; a former one of that name is replaced."""
    arrays: dict[str, NDArray[np.generic]] = {
        "version": np.array(FILE_FORMAT_VERSION),
        "size_m": taught.size_m,
        "covariance_target": taught.covariance_target,
        "figures": np.array([taught.sigma_scale_frac, taught.agree_frac]),
        "views": np.array(len(taught.views)),
    }
    for k, view in enumerate(taught.views):
        arrays |= {
            f"left_{k}": _encode_png(view.reference_left),
            f"right_{k}": _encode_png(view.reference_right),
            f"T_cam_object_{k}": view.T_cam_object,
            f"covariance_{k}": view.covariance,
            f"descriptors_{k}": view.descriptors,
            **{f"{name}_{k}": getattr(view.landmarks, name) for name in _MARKS},
        }
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # pyright: ignore[reportArgumentType]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{taught.name}{SUFFIX}"
    write_durably(path, buffer.getvalue())
    return path


def load_taught(path: Path) -> TaughtObject:
    """Read an object; its name is the file's.

    Raises: TaughtFileError: not such a file, or of another version.
    """
    try:
        with np.load(path, allow_pickle=False) as data:
            if int(data["version"]) != FILE_FORMAT_VERSION:
                raise TaughtFileError(
                    f"{path.name} has version {int(data['version'])} (known: {FILE_FORMAT_VERSION}); teach again"
                )
            scale, agree = (float(value) for value in data["figures"])
            views = tuple(_read_taught_view(data, k) for k in range(int(data["views"])))
            return TaughtObject(path.stem, data["size_m"], views, data["covariance_target"], scale, agree)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile, cv2.error) as error:
        raise TaughtFileError(f"{path.name} cannot be read as a taught object: {error}; teach it again") from error


def _read_taught_view(data: "np.lib.npyio.NpzFile", k: int) -> TaughtView:
    marks = Landmarks(**{name: data[f"{name}_{k}"] for name in _MARKS})
    if not all(len(getattr(marks, name)) == len(marks) for name in _MARKS) or len(data[f"descriptors_{k}"]) != len(
        marks
    ):
        raise ValueError(f"view {k + 1} has landmarks of unequal number")
    return TaughtView(
        _decode_image(data[f"left_{k}"]),
        _decode_image(data[f"right_{k}"]),
        data[f"T_cam_object_{k}"],
        data[f"covariance_{k}"],
        marks,
        data[f"descriptors_{k}"],
        ((), ()),
    )


def _encode_png(image: Image) -> NDArray[np.uint8]:
    good, code = cv2.imencode(".png", image)
    if not good:
        raise TaughtFileError("an image could not be packed")
    return np.asarray(code, dtype=np.uint8).ravel()


def _decode_image(code: NDArray[np.uint8]) -> Image:
    image = cv2.imdecode(code, cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ValueError("an image cannot be unpacked")
    return np.asarray(image, dtype=np.uint8)
