"""What a look and the odometry get wrong beyond what the world's own truth explains: a few numbers, fitted to images.

Lens, rig, printing and layout errors of a machine are part of its drawn truth and enter the fast world exactly. What is
left is the corner finder and the odometry; their numbers are here, with the file format that a fit writes.
"""

import json
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from recording.files import read_text

FORMAT = "longreach-noise/1"
FITTED_FILE = "noise_fitted.json"


class NoiseFileError(ValueError):
    """A file that is no noise model."""


@dataclass(frozen=True, slots=True)
class CornerNoise:
    """Errors of one object's marker corners, one eye, one coordinate [px].

    `frame_px` changes with every pair, `look_px` stays for a look (for the tool, which does not move in the image: for
    the machine); `outward_px` away from the marker's middle; `shift_x_px`, `shift_y_px` common to all corners.
    """

    frame_px: float
    look_px: float
    outward_px: float = 0.0
    shift_x_px: float = 0.0
    shift_y_px: float = 0.0


@dataclass(frozen=True, slots=True)
class LookNoise:
    """Both objects of one pose source."""

    tool: CornerNoise
    ooi: CornerNoise


@dataclass(frozen=True, slots=True)
class OdometryNoise:
    """Errors of the odometry's path, per axis: standard deviations.

    Model:   p = (1 + scale_frac) p_true + walk + bend + jitter; walk: sd `drift_m_sqrt_m` per root metre of path;
             bend: sd `bend_m`, correlated over `bend_length_m` of path; jitter: each pose by itself. Rotation: walk and
             jitter. `rate_hz`: poses a second.
    """

    scale_frac: float
    drift_m_sqrt_m: float
    bend_m: float
    bend_length_m: float
    jitter_m: float
    turn_drift_rad_sqrt_m: float
    turn_jitter_rad: float
    rate_hz: float = 30.0


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Everything a fast run needs, and where it comes from."""

    stereo: LookNoise
    mono: LookNoise
    odometry: OdometryNoise
    source: str

    def to_json(self) -> str:
        """As a file's text."""
        return json.dumps({"format": FORMAT, **asdict(self)}, indent=1)


def fitted_noise() -> NoiseModel:
    """The model that is shipped: fitted by `longreach reproduce noise`."""
    return _parsed(files("benchmarks.reproduce").joinpath(FITTED_FILE).read_text(encoding="utf-8"), FITTED_FILE)


def ship_fitted(model: NoiseModel) -> Path:
    """Put a fit in the place of the shipped one; for a source tree. Returns its path."""
    path = Path(__file__).with_name(FITTED_FILE)
    path.write_text(model.to_json() + "\n", encoding="utf-8")
    return path


def read_noise_model(path: Path) -> NoiseModel:
    """The model of a file.

    Raises: NoiseFileError: not readable, another format, fields missing or too many.
    """
    try:
        return _parsed(read_text(path), str(path))
    except OSError as error:
        raise NoiseFileError(f"noise model {path}: {error.strerror}; fit one again") from error


def _parsed(text: str, name: str) -> NoiseModel:
    try:
        return _model(json.loads(text))
    except (json.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
        raise NoiseFileError(f"noise model {name}: {error!r}; fit one again") from error


def _model(data: dict[str, Any]) -> NoiseModel:
    if data.pop("format") != FORMAT:
        raise KeyError(f"format is not {FORMAT}")
    looks = {name: LookNoise(**{on: CornerNoise(**data[name][on]) for on in data[name]}) for name in ("stereo", "mono")}
    return NoiseModel(**looks, odometry=OdometryNoise(**data["odometry"]), source=data["source"])
