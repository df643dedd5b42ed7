"""The presets: every number of a simulated machine that is drawn, with unit and source, in one table."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from machine.rotations import Array

PresetName = Literal["ideal", "realistic", "paper", "nominal"]
PRESET_NAMES: tuple[str, ...] = get_args(PresetName)


class PresetError(Exception):
    """A preset that does not exist, or one from which no usable scene could be drawn."""


@dataclass(frozen=True, slots=True)
class Exact:
    """Always this value."""

    value: float

    def draw(self, rng: np.random.Generator, n: int = 1) -> Array:
        """The value, n times."""
        del rng
        return np.full(n, self.value)


@dataclass(frozen=True, slots=True)
class Normal:
    """Zero mean, `standard_deviation`."""

    standard_deviation: float

    def draw(self, rng: np.random.Generator, n: int = 1) -> Array:
        """n independent samples."""
        return self.standard_deviation * rng.standard_normal(n)


@dataclass(frozen=True, slots=True)
class Uniform:
    """Evenly between `low` and `high`."""

    low: float
    high: float

    def draw(self, rng: np.random.Generator, n: int = 1) -> Array:
        """n independent samples."""
        return rng.uniform(self.low, self.high, n)


Spread = Exact | Normal | Uniform


@dataclass(frozen=True, slots=True)
class Row:
    """One number: its name, unit, what each preset draws, and its source. `paper_spread` None: as realistic."""

    name: str
    unit: str
    ideal_spread: Spread
    realistic_spread: Spread
    paper_spread: Spread | None
    source: str


# E: read in a source or measured, K: general knowledge, A: assumption of this project (docs/plant.md).
_TABLE_7 = "preset table"
# fmt: off
PRESET_TABLE: tuple[Row, ...] = (
    Row("rigid", "flag", Exact(1.0), Exact(0.0), None,
        f"{_TABLE_7}; ideal is the nominal model, without structure or oil"),
    Row("dh_length", "m", Exact(0.0), Normal(3.5e-3), None, f"{_TABLE_7}, A; a1 d1 a2 a3 d3 d4 d6"),
    Row("joint_zero", "deg", Exact(0.0), Normal(0.25), None, f"{_TABLE_7}, A"),
    Row("spring_lift", "N m/rad", Exact(1.5e6), Uniform(0.6e6, 1.5e6), None, f"{_TABLE_7}, A, bounded by E (boom FEM)"),
    Row("spring_tilt", "N m/rad", Exact(1.0e6), Uniform(0.4e6, 1.0e6), None, f"{_TABLE_7}, A"),
    Row("spring_lateral", "N m/rad", Exact(5e5), Uniform(2.5e5, 6e5), None, f"{_TABLE_7}, A; lift and tilt boom each"),
    Row("spring_wrist_mount", "N m/rad", Exact(3e5), Exact(3e5), None, "default plant, A"),
    Row("spring_damping", "ratio", Exact(0.04), Uniform(0.03, 0.05), None, f"{_TABLE_7}, A"),
    Row("backlash_slew", "mrad peak to peak", Exact(0.0), Uniform(0.5, 2.0), None, f"{_TABLE_7}, A"),
    Row("backlash_wrist", "deg peak to peak", Exact(0.0), Uniform(0.05, 0.3), None, f"{_TABLE_7}, A"),
    Row("dead_band", "% of full command, half width", Exact(0.0), Uniform(1.0, 3.0), Exact(3.0), f"{_TABLE_7}, A"),
    Row("hysteresis", "% of full command, half width", Exact(0.0), Exact(0.5), Exact(0.5), f"{_TABLE_7}, A"),
    Row("friction_scale", "factor on the default", Exact(0.0), Uniform(0.5, 1.5), None,
        f"{_TABLE_7}; ideal: viscous only"),
    Row("supply_ripple", "Pa", Exact(0.0), Exact(0.5e6), None, "default plant, K/A"),
    Row("encoder", "bit", Exact(18.0), Exact(18.0), Exact(18.0), f"{_TABLE_7}; must equal the machine file"),
    Row("mount_angle", "deg", Exact(0.0), Uniform(0.0, 5.0), Exact(5.0), f"{_TABLE_7}; paper: about camera x"),
    Row("mount_translation", "m per axis", Exact(0.0), Normal(0.010), None, f"{_TABLE_7}, A"),
    Row("tool_marker_angle", "deg, random axis", Exact(0.0), Normal(1.0), Normal(3.0), _TABLE_7),
    Row("focal_length", "% left after calibration", Exact(0.0), Normal(0.15), None, _TABLE_7),
    Row("principal_point", "px per axis", Exact(0.0), Normal(1.0), None, _TABLE_7),
    Row("k1", "1 left after calibration", Exact(0.0), Normal(0.002), None, _TABLE_7),
    Row("disparity_bias", "px", Exact(0.0), Normal(0.1), None, _TABLE_7),
    Row("marker_size", "mm of 150", Exact(0.0), Normal(0.1), None, _TABLE_7),
    Row("layout_position", "mm per axis", Exact(0.0), Normal(0.3), None, _TABLE_7),
    Row("layout_rotation", "deg per axis", Exact(0.0), Normal(0.1), None, _TABLE_7),
    Row("clock_offset", "s", Exact(0.0), Uniform(0.0, 0.150), Exact(0.150), f"{_TABLE_7}, A"),
    Row("latency", "s", Exact(0.040), Uniform(0.040, 0.080), Exact(0.060), f"{_TABLE_7}, A"),
    Row("jitter", "s standard deviation", Exact(0.0), Exact(0.002), Exact(0.002), f"{_TABLE_7}, A"),
    Row("image_noise", "grey levels", Exact(2.0), Uniform(2.0, 4.0), None, _TABLE_7),
    Row("psf", "px standard deviation", Exact(0.6), Uniform(0.6, 0.9), None, _TABLE_7),
    Row("exposure", "s", Exact(0.0), Exact(0.004), None, _TABLE_7),
    Row("readout", "s", Exact(0.0), Exact(0.011), None, f"{_TABLE_7}, K"),
    Row("wall_relief", "m peak to peak", Exact(0.0), Exact(0.050), None, _TABLE_7),
    Row("texture_contrast", "fraction", Exact(1.0), Uniform(0.5, 1.0), None, _TABLE_7),
    Row("structure_cover", "fraction of the picture", Exact(0.0), Uniform(0.12, 0.20), None, "A; tool included"),
    Row("structure_contrast", "fraction", Exact(0.0), Uniform(0.0, 1.0), None, "A; 0 is plain paint"),
    Row("hoses_move", "flag", Exact(0.0), Exact(1.0), None, "A; with the wrist and with gravity"),
    Row("start_distance", "m, tool to OOI along its normal", Uniform(0.6, 0.9), Uniform(0.6, 0.9), None, _TABLE_7),
    Row("start_lateral", "m, radius", Uniform(0.0, 0.15), Uniform(0.0, 0.15), None, _TABLE_7),
    Row("start_rotation", "deg, each axis", Uniform(-8.0, 8.0), Uniform(-8.0, 8.0), None, _TABLE_7),
    Row("slew", "deg", Uniform(-40.0, 40.0), Uniform(-40.0, 40.0), None, _TABLE_7),
    Row("reach", "m, tcp to the slew axis, horizontal", Uniform(2.5, 4.3), Uniform(2.5, 4.3), None, _TABLE_7),
    Row("theta5", "deg", Uniform(-90.0, -20.0), Uniform(-90.0, -20.0), None,
        f"{_TABLE_7}: |theta5|; negative looks level"),
    Row("tool_pitch", "deg", Uniform(-20.0, 20.0), Uniform(-20.0, 20.0), None,
        "A: the tool looks roughly level at a wall"),
    Row("theta4", "deg", Uniform(-20.0, 20.0), Uniform(-20.0, 20.0), None, "A"),
    Row("theta6", "deg", Uniform(-10.0, 10.0), Uniform(-10.0, 10.0), None, "A: small"),
)
# fmt: on

NEAR_RIGID_SPRING_NM_RAD = Exact(3e7)  # N m/rad: 1 mm of the tip, where real booms give 30
#: Where the nominal model with oil and structure differs from `ideal`: the plant for a machine file's own effects.
NOMINAL: dict[str, Spread] = {
    "rigid": Exact(0.0),
    "spring_lift": NEAR_RIGID_SPRING_NM_RAD,
    "spring_tilt": NEAR_RIGID_SPRING_NM_RAD,
    "spring_lateral": NEAR_RIGID_SPRING_NM_RAD,
    "spring_wrist_mount": NEAR_RIGID_SPRING_NM_RAD,
    "friction_scale": Exact(0.2),  # without any the oil sets the slew swinging, and nothing comes to rest
}

_ROWS = {row.name: row for row in PRESET_TABLE}


def spread_of(preset: str, name: str) -> Spread:
    """What a preset draws for one number. Raises: PresetError: no such preset. KeyError: no such number."""
    row, checked = _ROWS[name], checked_preset(preset)
    if checked == "nominal":
        return NOMINAL.get(name, row.ideal_spread)
    if checked == "ideal":
        return row.ideal_spread
    return row.realistic_spread if checked == "realistic" or row.paper_spread is None else row.paper_spread


def checked_preset(preset: str) -> str:
    """The preset itself. Raises: PresetError: no such preset."""
    if preset not in PRESET_NAMES:
        raise PresetError(f"preset '{preset}' does not exist; choose one of {', '.join(PRESET_NAMES)}")
    return preset
