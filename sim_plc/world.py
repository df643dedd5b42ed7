"""One simulated machine in front of one wall: everything that is true and that the server must never see."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from machine.description import Board, Machine, Marker, StereoCamera
from machine.rotations import Array
from sim_plc.plant.truth import PlantTruth


@dataclass(frozen=True, slots=True)
class CameraTruth:
    """The true camera. `left` and `right` carry the true intrinsics (the disparity bias sits in the right eye's cx)."""

    left: StereoCamera
    right: StereoCamera
    T_tcp_cam_left: Array
    clock_offset_s: float  # t_camera = t_true + offset
    latency_s: float  # from mid-exposure to the first byte on the wire
    jitter_s: float  # standard deviation of the latency
    noise_grey: float  # standard deviation at mid grey, 8-bit levels
    psf_px: float  # standard deviation of the point spread
    exposure_s: float
    readout_s: float  # rolling shutter, first to last row


@dataclass(frozen=True, slots=True)
class StructureTruth:
    """The crane's own structure in the picture: housing and beams at the tool, and two hoses."""

    cover_frac: float  # of the picture, both eyes' mean, tool included and hoses at rest; 0: no structure
    contrast_frac: float  # of its texture; 0: plain paint
    hoses_move: bool  # with the wrist and with gravity; else they rest in the picture
    elbow_base_m: Array  # from there comes the boom that carries the hoses' rear ends; counts as fixed
    down_base: Array  # unit vector of gravity


@dataclass(frozen=True, slots=True)
class RoundMark:
    """A borehole or a painted ring on the rock. T_ooi_mark: centre and plane of its rim, z out of the rock.

    `line_m` is the width of a ring's paint inside its diameter, `light_ooi` points to the lamp; a wet hole has a dark
    streak below it.
    """

    kind: Literal["hole", "ring"]
    T_ooi_mark: Array
    diameter_m: float
    depth_m: float
    line_m: float
    grey: int
    dust_frac: float
    wet: bool
    light_ooi: Array
    seed: int


@dataclass(frozen=True, slots=True)
class FixtureTruth:
    """A bolt plate that can be taught, or a look-alike of it; `seed` draws its bolts, blocks and rust."""

    seed: int
    T_ooi_fixture: Array  # origin in the plate's middle, x right, y up, z out of it
    variant: Literal["taught", "other", "scaled", "row"] = "taught"
    cover_frac: float = 0.0  # of the plate, by a sheet that hangs before it from one side


@dataclass(frozen=True, slots=True)
class SceneTruth:
    """The wall, the OOI on it and the tool marker, as they truly are (printed sizes and places included)."""

    T_base_ooi: Array
    ooi_markers: tuple[Marker, ...]  # T_on_marker = true T_ooi_marker, side_m = true printed side
    tool_markers: tuple[Marker, ...]  # T_on_marker = true T_tool_marker
    T_tcp_tool: Array
    wall_offset_m: float  # the wall's mean plane is z_ooi = -wall_offset_m
    wall_relief_m: float  # peak to peak
    texture_contrast_frac: float
    texture_seed: int
    ooi_boards: tuple[Board, ...] = ()  # chess boards with markers, T_on_board = true T_ooi_board
    structure: StructureTruth | None = None
    round_marks: tuple[RoundMark, ...] = ()
    fixtures: tuple[FixtureTruth, ...] = ()


@dataclass(frozen=True, slots=True)
class World:
    """A machine drawn from a preset and a seed. `q_start_rad` are encoder readings at the start, at rest."""

    nominal: Machine
    preset: str
    seed: int
    plant: PlantTruth
    camera: CameraTruth
    scene: SceneTruth
    q_start_rad: Array


def rng_for(seed: int, stream: str) -> np.random.Generator:
    """One independent random stream per purpose, keyed by its name."""
    return np.random.default_rng([seed, *stream.encode()])
