"""The cell of visual odometry: how long the camera's own paths are against the encoders'.

Lengths, not places: odometry starts in a frame of its own and wanders off, but over a second it knows how far it came.
"""

from dataclasses import replace

import numpy as np

from diagnosis.behind.chord_residual import ChordResidual
from diagnosis.behind.link_angles import Path, is_logged_densely, path_index
from diagnosis.behind.saturated import saturated_noise
from diagnosis.cells.points import rows_of
from diagnosis.datagrams.clocks import camera_to_plc_s
from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import OdometryTable
from diagnosis.reading.read import Read
from diagnosis.search.candidates import Candidate, arm_candidates, candidates_of, candidates_of_effects
from diagnosis.search.cell import Cell
from machine.effects.layout import ParameterSets

CHORDS_MAX = 200
CHORDS_MIN = 20
CHORD_DURATION_S = 1.0
CHORD_LENGTH_MIN_M = 0.05  # a chord far longer than odometry's noise has a length without bias
SIGMA_MIN_M = 2e-5
PATH_LENGTH_EFFECTS = (
    "hand_eye_translation",
    "odometry_scale",
)  # of the camera's effects, those that change a path's length


def odometry_cells(whole: Read, base: ParameterSets, paths: tuple[Path, ...]) -> list[Cell]:
    """A cell where odometry, the arm and the camera's mount are known and the camera went far enough; else none.

    `paths`: the encoders' courses.
    """
    nominal, tables = whole.nominal_machine, whole.tables
    if nominal is None or tables is None or tables.odometry is None or nominal.arm is None:
        return []
    if nominal.T_tcp_cam_left is None or not paths:
        return []
    rough = _odometry_chords(nominal, tables.odometry, camera_to_plc_s(tables), paths)
    long = rough.length_m > CHORD_LENGTH_MIN_M
    if int(long.sum()) < CHORDS_MIN:
        return []
    cut = {name: getattr(rough, name)[long] for name in ("at", "start_s", "end_s", "length_m")}
    rough = replace(rough, **cut)
    candidates = _odometry_candidates(tuple(range(1, nominal.n + 1)), is_logged_densely(paths))
    count = len(rough.at)
    # the noise across a chord makes it longer by sigma^2 / length on the average: taken off below
    sigma = max(saturated_noise(rough, base, candidates, np.arange(count))[0], SIGMA_MIN_M)
    return [
        Cell(
            stage="camera",
            joint=None,
            unit="m",
            candidates=candidates,
            baseline_parameters=base,
            whitened=replace(rough, sigma_m=sigma, length_m=rough.length_m - sigma**2 / rough.length_m),
            rows=rows_of(count, 1),
            scale=np.full(count, sigma),
            quiet=1.0,
            floor_known=False,
            regressors=(),
            t_s=rough.start_s,
        )
    ]


def _odometry_chords(nominal: Nominal, table: OdometryTable, to_plc_s: float, paths: tuple[Path, ...]) -> ChordResidual:
    """At most 200 chords of a second, evenly spread over what lies within stretches."""
    good = np.isfinite(table.t_s) & np.isfinite(table.position_m).all(axis=1)
    order = np.argsort(table.t_s[good], kind="stable")
    t, places = table.t_s[good][order] + to_plc_s, table.position_m[good][order]
    end = np.minimum(np.searchsorted(t, t + CHORD_DURATION_S), len(t) - 1)
    start_in, end_in = path_index(paths, t), path_index(paths, t[end])
    lasted = t[end] - t
    usable = np.nonzero(
        (start_in >= 0) & (start_in == end_in) & (lasted > 0.8 * CHORD_DURATION_S) & (lasted < 1.2 * CHORD_DURATION_S)
    )[0]
    some = usable[np.unique(np.linspace(0, len(usable) - 1, CHORDS_MAX).astype(int))] if len(usable) else usable
    length = np.linalg.norm(places[end[some]] - places[some], axis=1)
    return ChordResidual(nominal, paths, start_in[some], t[some], t[end[some]], length, float(paths[0].t_s[0]))


def _odometry_candidates(joints: tuple[int, ...], moving: bool) -> tuple[Candidate, ...]:
    return (
        arm_candidates(joints, moving)
        + candidates_of_effects(PATH_LENGTH_EFFECTS, joints)
        + candidates_of("time", joints, True)
    )
