"""What the marker bench counts: the server's own setting beside one that is told the noise."""

import numpy as np

from benchmarks.vision.markers.cells import Cell
from benchmarks.vision.markers.exact import run_cell
from benchmarks.vision.markers.judged import Looks, counts
from benchmarks.vision.markers.tables import exact_lines
from machine.poses import pose
from server.settings import read_machine
from server.vision.object_pose import PoseSettings

CELL = Cell(side_m=0.15, distance_m=0.8, tilt_deg=30.0, sigma_px=0.1)
EYES = np.zeros(3)


def test_the_shipped_setting_is_judged_as_it_is_shipped():
    found = run_cell(CELL, read_machine("hiab033").camera, n=60, seed=1)
    known, shipped = (100.0 * one["inside_position"] / one["n"] for one in (found.known, found.shipped))
    assert known > 88.0
    assert shipped < known - 3.0  # corners of 0.1 px are worse than what the server takes them for
    told = "\n".join(exact_lines([found]))
    assert "pooled, noise known: position" in told
    assert f"pooled, shipped setting, {PoseSettings().sigma_px:g} px: position" in told


def test_a_look_without_a_pose_is_flagged_and_counts_no_further():
    T = np.array([pose(np.eye(3), np.array([0.0, 0.0, 1.0])), np.full((4, 4), np.nan)])
    looks = Looks(T, np.array([np.eye(6) * 1e-6, np.full((6, 6), np.nan)]), np.array([False, True]))
    found = counts(looks, np.array([T[0], T[0]]), 30.0, EYES)
    assert (found["n"], found["flagged"], found["inside_position"], found["n_tilt"]) == (1, 1, 1, 1)
