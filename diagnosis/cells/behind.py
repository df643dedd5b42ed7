"""One cell for all that was measured behind the encoders: static points, tracked points and corners share the arm.

A long link moves tracked points and marker corners alike. Searched apart it would be named twice, or by two names.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.behind.chord_residual import ChordResidual
from diagnosis.behind.corner_residual import CornerResidual
from diagnosis.behind.link_angles import paths_of
from diagnosis.behind.point_residual import PointResidual
from diagnosis.cells.camera import camera_cells
from diagnosis.cells.dynamic import usual_of
from diagnosis.cells.odometry import odometry_cells
from diagnosis.cells.points import point_cells
from diagnosis.known.form import with_form
from diagnosis.log.nominal import Nominal
from diagnosis.reading.read import Read
from diagnosis.search.candidates import ENCODER_VISIBLE_EFFECTS, Candidate, on_an_arm
from diagnosis.search.cell import Cell, ResidualRows
from machine.effects.arm import gravity_torque_bound_nm
from machine.effects.kernel import PAYLOAD
from machine.effects.layout import (
    BASE_COMPLIANCE,
    BASE_TILT,
    CLOCK_OFFSET,
    CLOCK_RATE_PPM,
    CLOCK_ZERO,
    FOCAL,
    STEREO,
    TOOL_MARKER_ROTATION,
    TOOL_MARKER_TRANSLATION,
    ParameterSets,
)
from machine.rotations import Array

CACHED_RESIDUALS_MAX = 400  # residuals of one part
CLOCK_PARAMETER_COLUMNS = [CLOCK_OFFSET, CLOCK_RATE_PPM, CLOCK_ZERO]
ARM_PARAMETER_COLUMNS = [PAYLOAD, *range(BASE_TILT.start, BASE_TILT.stop), BASE_COMPLIANCE, *CLOCK_PARAMETER_COLUMNS]
TOOL_MARKER_PARAMETER_COLUMNS = [
    *range(FOCAL, STEREO.stop),
    *range(TOOL_MARKER_ROTATION.start, TOOL_MARKER_TRANSLATION.stop),
]
JOINED_CELL_UNIT = "floors"
REVOLUTE_ONLY_EFFECTS = ("encoder_eccentricity",)


def behind_cells(whole: Read, base: ParameterSets, with_odometry: bool = False) -> list[Cell]:
    """What was measured behind the encoders: one cell, or none.

    `with_odometry`: what it usually leaves is in no baseline, so it is left alone where there is one.
    """
    nominal = whole.nominal_machine
    paths = paths_of(whole.stretches)
    points = point_cells(whole, base, paths)
    parts = (with_form(points, nominal) if nominal is not None else points) + camera_cells(whole, base, paths)
    parts += odometry_cells(whole, base, paths) if with_odometry else []
    if not parts:
        return []
    cell = join_cells(parts) if len(parts) > 1 else parts[0]
    if nominal is None or not nominal.baseline_remainders:
        return [cell]
    return [replace(cell, baseline_gain_nats=usual_of([nominal.baseline_remainder(cell.stage)]) or ())]


def join_cells(parts: list[Cell]) -> Cell:
    """Several cells as one: candidates of all, residuals end to end.

    Folds keep their numbers (a quarter of every part is left out together), blocks and series do not.
    """
    candidates: dict[tuple[object, ...], Candidate] = {}
    for part in parts:
        for candidate in part.candidates:
            candidates.setdefault(
                (candidate.effect_and_joint, candidate.variant_option, candidate.fixed_parameters), candidate
            )
    pieces = [_CachedResidual(part.whitened, *_relevant_parameters(part)) for part in parts]

    def whitened(sets: ParameterSets) -> Array:
        return np.concatenate([piece(sets) for piece in pieces], axis=1)

    stages = {part.stage for part in parts}
    return Cell(
        stage="structure" if "structure" in stages else parts[0].stage,
        joint=parts[0].joint if len({part.joint for part in parts}) == 1 else None,
        unit=parts[0].unit if len({part.unit for part in parts}) == 1 else JOINED_CELL_UNIT,
        candidates=tuple(candidates.values()),
        baseline_parameters=parts[0].baseline_parameters,
        whitened=whitened,
        rows=_join_residual_rows([part.rows for part in parts]),
        scale=np.concatenate([part.scale for part in parts]),
        quiet=float(np.average([part.quiet for part in parts], weights=[part.rows.row_count for part in parts])),
        floor_known=2 * sum(part.rows.row_count for part in parts if part.floor_known)
        >= sum(p.rows.row_count for p in parts),
        regressors=(),
        t_s=np.concatenate([part.t_s for part in parts]),
        loose_target_text=next((part.loose_target_text for part in parts if part.loose_target_text), ""),
        joined_cells=tuple(parts),
    )


def _join_residual_rows(rows: list[ResidualRows]) -> ResidualRows:
    def joined_with_offsets(name: str) -> NDArray[np.int64]:
        out, first = [], 0
        for row in rows:
            numbers = getattr(row, name)
            out.append(numbers + first)
            first += int(numbers.max(initial=-1)) + 1
        return np.concatenate(out).astype(np.int64)

    fold = np.concatenate([row.fold for row in rows]).astype(np.int64)
    return ResidualRows(
        fold,
        joined_with_offsets("block"),
        joined_with_offsets("series"),
        joined_with_offsets("channel"),
        correlation_group=joined_with_offsets("dependent_rows"),
    )


def _relevant_parameters(part: Cell) -> tuple[bool, list[int] | None]:
    """Whether a part feels the joints' parameters, and which of the machine's; None: all."""
    if part.joined_cells or isinstance(part.whitened, ChordResidual):
        return True, None
    if not isinstance(part.whitened, CornerResidual):
        return True, ARM_PARAMETER_COLUMNS if part.stage == "structure" else None
    return (True, None) if part.whitened.marker_carrier == "ooi" else (False, TOOL_MARKER_PARAMETER_COLUMNS)


@dataclass(slots=True)
class _CachedResidual:
    """A part's residual, run only for sets that differ in what the part feels: a lens moves no tracked point."""

    whitened: Callable[[ParameterSets], Array]
    depends_on_joints: bool
    machine_parameter_columns: list[int] | None
    residual_cache: dict[bytes, Array] = field(default_factory=dict)

    def __call__(self, sets: ParameterSets) -> Array:
        keys = [self._cache_key(sets, k) for k in range(sets.set_count)]
        found = {key: self.residual_cache[key] for key in keys if key in self.residual_cache}
        fresh = {key: k for k, key in enumerate(keys) if key not in found}
        if fresh:
            chosen = np.array(list(fresh.values()))
            rows = self.whitened(
                ParameterSets(sets.joint_parameters[chosen].copy(), sets.machine_parameters[chosen].copy())
            )
            found.update(zip(fresh, rows, strict=True))
            self._cache_results(found, fresh)
        return np.stack([found[key] for key in keys])

    def _cache_results(self, found: dict[bytes, Array], fresh: dict[bytes, int]) -> None:
        for key in fresh:
            self.residual_cache[key] = found[key]
        while len(self.residual_cache) > CACHED_RESIDUALS_MAX:
            self.residual_cache.pop(next(iter(self.residual_cache)))

    def _cache_key(self, sets: ParameterSets, k: int) -> bytes:
        machine = (
            sets.machine_parameters[k]
            if self.machine_parameter_columns is None
            else sets.machine_parameters[k, self.machine_parameter_columns]
        )
        return machine.tobytes() + (sets.joint_parameters[k].tobytes() if self.depends_on_joints else b"")


def measurement_of(part: Cell) -> str:
    """Which measurement behind the encoders a part is: static, tracker, ooi, tool, odometry; empty for other stages."""
    if isinstance(part.whitened, ChordResidual):
        return "odometry"
    if isinstance(part.whitened, CornerResidual):
        return part.whitened.marker_carrier
    if isinstance(part.whitened, PointResidual):
        return "tracker" if part.whitened.encoder_paths else "static"
    return ""


def shown_behind(cells: list[Cell]) -> tuple[str, ...]:
    """The encoders' effects that these cells show: actuators leave them to what was measured behind."""
    seen = {candidate.name for cell in cells for candidate in cell.candidates}
    return tuple(name for name in ENCODER_VISIBLE_EFFECTS if name in seen)


def cells_without(cells: list[Cell], names: tuple[str, ...]) -> list[Cell]:
    """Cells whose library is without these effects."""
    return _filter_candidates(cells, lambda one: one.name not in names) if names else cells


def cells_fitting_joint(cells: list[Cell], nominal: Nominal) -> list[Cell]:
    """Cells without effects that such a joint cannot have (what slides has no turn that a wave could go with), and with
    sizes that such an arm can have.
    """
    if nominal.arm is not None:
        torque_nm = gravity_torque_bound_nm(nominal.arm)
        cells = [
            replace(cell, candidates=tuple(on_an_arm(candidate, torque_nm) for candidate in cell.candidates))
            for cell in cells
        ]
    if not any(nominal.joint_slides):
        return cells
    slides = [False, *nominal.joint_slides]  # by joint; the machine's own are at 0
    return _filter_candidates(cells, lambda one: one.name not in REVOLUTE_ONLY_EFFECTS or not slides[one.joint or 0])


def _filter_candidates(cells: list[Cell], wanted: Callable[[Candidate], bool]) -> list[Cell]:
    return [
        replace(cell, candidates=tuple(candidate for candidate in cell.candidates if wanted(candidate)))
        for cell in cells
    ]
