"""What each effect does at the tool, in metres: where the tool stands, how it gets there, what the camera says of it.

Model:  v(S) is the tool's displacement over time if the machine has the effects S. An effect's own part is the mean of
        what it adds alone and what it takes away from all; what interactions leave is spread over the effects by size,
        so that the parts add up to v(all). The share of an effect in the mean square |v(all)|^2 is then its Shapley
        value, <v_i, v(all)> / |v(all)|^2: for a sum of parts it has this closed form.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.behind.corner_residual import CornerResidual, small_motion
from diagnosis.behind.link_angles import link_angles, path_index, paths_of, without_encoders
from diagnosis.behind.points import rigid_fit
from diagnosis.reading.read import Read
from diagnosis.replay.replayer import closed_loop, replayer_of
from diagnosis.search.candidates import parameter_sets_with
from diagnosis.search.cell import DYNAMIC_STAGES, Cell
from diagnosis.whole_model.linear import EffectTerm
from machine.effects.dynamics import DynamicStage, simulate
from machine.effects.encoders import true_angles
from machine.effects.entries import pack_under
from machine.effects.layout import ParameterSets, neutral_sets
from machine.effects.seen import seen_corners
from machine.effects.structure import tcp_poses
from machine.poses import transform_points
from machine.rotations import Array

# Postures and rows of motion at which the tool is looked at: the RMS is then known to a few percent
TOOL_SAMPLES_MAX = 400
CAMERA_FRAMES_MAX = 60
FINITE_DIFFERENCE_STEP = 1e-4
BUDGET_COLUMN_NAMES = ("stands", "gets_there", "sees")
ARM_STAGES = ("joint", "structure")
CAMERA_STAGES = ("camera", "time")


@dataclass(frozen=True, slots=True)
class ToolError:
    """One column of the budget. `by_effect`: (effects, m, 3) [m], in the order of `effect_terms`; `measured_error_m`:
    the nominal model's miss (m, 3), `remaining_error_m`: with the effects that are kept; None where only the model
    says it.
    """

    budget_column: str
    effect_terms: tuple[EffectTerm, ...]
    by_effect: Array
    measured_error_m: Array | None = None
    remaining_error_m: Array | None = None

    @property
    def total_error(self) -> Array:
        """What all effects do together (m, 3) [m]."""
        return np.asarray(self.by_effect.sum(axis=0), dtype=float)

    @property
    def rms_m(self) -> Array:
        """What each effect does by itself (effects,) [m]."""
        return np.sqrt((self.by_effect**2).sum(axis=2).mean(axis=1))

    @property
    def squares_m2(self) -> Array:
        """Shapley values of the mean squared displacement (effects,) [m^2]; they add up to that of all."""
        return np.asarray((self.by_effect * self.total_error).sum(axis=2).mean(axis=1), dtype=float)


def tool_errors(
    whole: Read, terms: Sequence[EffectTerm], cells: Sequence[Cell], kept: Sequence[EffectTerm] | None = None
) -> tuple[ToolError, ...]:
    """The columns that the recording and the machine file allow, for the present terms.

    `kept`: the terms with which a machine file is left, in place of all.
    """
    some = tuple(term for term in terms if term.is_present)
    found = (
        tool_position_error(whole, some),
        gets_there(whole, some, some if kept is None else kept),
        camera_error(cells, some),
    )
    return tuple(column for column in found if column is not None)


def tool_position_error(whole: Read, terms: tuple[EffectTerm, ...]) -> ToolError | None:
    """Where the tool is for its encoders, over the recorded postures; by the model.

    Where nothing outside the machine measured points on it, it is unknown where its base stands: a motion of the whole
    is then left out, and what counts is how the tool's places lie to each other.
    """
    nominal = whole.nominal_machine
    if nominal is None or nominal.arm is None:
        return None
    arm, own = nominal.arm, tuple(term for term in terms if term.effect.stage in ARM_STAGES)
    paths, tables = paths_of(whole.stretches), whole.tables
    times = np.concatenate([path.t_s for path in paths]) if paths else np.zeros(0)
    times = (
        times[np.unique(np.linspace(0, len(times) - 1, min(TOOL_SAMPLES_MAX, len(times))).astype(int))]
        if len(times)
        else times
    )
    at = path_index(paths, times)
    table = tables.static if tables is not None else None
    static = np.zeros((0, nominal.n)) if table is None or table.q is None else np.unique(table.q, axis=0)
    if not len(times) and not len(static):
        return None

    def tool(sets: ParameterSets, k: int) -> Array:
        plain = without_encoders(sets)
        rows = [true_angles(sets, static, k)] + ([link_angles(paths, sets, k, at, times)] if len(times) else [])
        return tcp_poses(arm, plain, np.concatenate(rows), k)[:, :3, 3]

    base = pack_under(nominal.baseline_effects, nominal.n)
    surveyed = tables is not None and (tables.static is not None or tables.tracker is not None)
    here = tool(base, 0)

    def tools(sets: ParameterSets) -> list[Array]:
        there = [tool(sets, k) for k in range(sets.set_count)]
        return there if surveyed else [transform_points(rigid_fit(points, here), points) for points in there]

    return ToolError("stands", own, split_among_effects(base, own, tools))


def gets_there(whole: Read, terms: tuple[EffectTerm, ...], kept: Sequence[EffectTerm]) -> ToolError | None:
    """How the tool follows what was sent, the loop closed: simulated, and against the encoders as recorded."""
    nominal = whole.nominal_machine
    replayer = replayer_of(nominal, whole.stretches) if nominal is not None and whole.stretches else None
    if nominal is None or nominal.arm is None or replayer is None or not nominal.has_controller:
        return None
    own = tuple(term for term in terms if term.effect.stage in DYNAMIC_STAGES)
    arm, base = nominal.arm, pack_under(nominal.baseline_effects, nominal.n)
    runs = [found for stretch in whole.stretches if (found := closed_loop(replayer, stretch)) is not None]
    if not runs:
        return None
    step = max(1, sum(len(encoders) for _, _, encoders in runs) // (2 * TOOL_SAMPLES_MAX))
    plain = neutral_sets(nominal.n)

    def tool(sets: ParameterSets) -> list[Array]:
        rows = [simulate(plant, sets, drive, DynamicStage.ACTUATOR).enc[:, ::step] for plant, drive, _ in runs]
        return [
            tcp_poses(arm, plain, np.concatenate([row[k] for row in rows]))[:, :3, 3] for k in range(sets.set_count)
        ]

    measured = tcp_poses(arm, plain, np.concatenate([encoders[::step] for _, _, encoders in runs]))[:, :3, 3]
    stays = [term for term in kept if term.effect.stage in DYNAMIC_STAGES]
    without, with_kept = tool(base)[0], tool(_parameters_with_terms(base, stays))[0]
    return ToolError("gets_there", own, split_among_effects(base, own, tool), measured - without, measured - with_kept)


def camera_error(cells: Sequence[Cell], terms: tuple[EffectTerm, ...]) -> ToolError | None:
    """By how much the camera misplaces what it looks at."""
    own = tuple(term for term in terms if term.effect.stage in CAMERA_STAGES)
    parts = [
        (part.baseline_parameters, part.whitened)
        for cell in cells
        for part in (cell.joined_cells or (cell,))
        if isinstance(part.whitened, CornerResidual)
    ]
    if not parts:
        return None
    base, corners = min(parts, key=lambda one: one[1].marker_carrier != "ooi")
    camera = corners.nominal_machine.camera
    if camera is None:
        return None
    few = np.unique(np.linspace(0, len(corners.camera_frames.t_s) - 1, CAMERA_FRAMES_MAX).astype(int))
    frames = replace(
        corners.camera_frames, t_s=corners.camera_frames.t_s[few], corners_px=corners.camera_frames.corners_px[few]
    )
    corners = replace(corners, camera_frames=frames, path_index=corners.path_index[few])

    def seen(sets: ParameterSets, k: int, moved: Array | None = None) -> Array:
        plain = without_encoders(sets)
        place = corners.T_base_ooi if moved is None else corners.T_base_ooi @ moved
        Ts, later = (corners.poses(sets, plain, k, late_s) @ place for late_s in (0.0, 0.01))
        found = seen_corners(sets, camera, frames.markers, Ts, later, 0.01, which=k)
        both = np.stack([found.left_px, found.right_px], axis=1)
        return np.where(np.isfinite(frames.corners_px), both, 0.0).reshape(len(few), -1)

    here = seen(base, 0)
    J = np.stack(
        [
            (seen(base, 0, small_motion(FINITE_DIFFERENCE_STEP * axis)) - here) / FINITE_DIFFERENCE_STEP
            for axis in np.eye(6)
        ],
        axis=2,
    )
    inverse = np.linalg.pinv(np.nan_to_num(J))

    def placed(sets: ParameterSets) -> list[Array]:
        moves = [np.nan_to_num(seen(sets, k) - here) for k in range(sets.set_count)]
        return [np.einsum("mij,mj->mi", inverse, move)[:, :3] for move in moves]

    return ToolError("sees", own, split_among_effects(base, own, placed))


def _parameters_with_terms(base: ParameterSets, terms: Sequence[EffectTerm]) -> ParameterSets:
    for term in terms:
        base = parameter_sets_with(base, (term.effect,), term.theta)
    return base


def split_among_effects(
    base: ParameterSets, terms: tuple[EffectTerm, ...], tool: Callable[[ParameterSets], list[Array]]
) -> Array:
    """Each effect's part (effects, m, 3) of what all do together; `tool` gives positions (m, 3) of every set."""
    alone = [_parameters_with_terms(base, (term,)) for term in terms]
    others = [_parameters_with_terms(base, terms[:k] + terms[k + 1 :]) for k in range(len(terms))]
    every = [base, _parameters_with_terms(base, terms), *alone, *others]
    sets = base.repeated_sets(len(every))
    for k, sets_of in enumerate(every):
        sets.joint_parameters[k], sets.machine_parameters[k] = (
            sets_of.joint_parameters[0],
            sets_of.machine_parameters[0],
        )
    at = tool(sets)
    none, everything = at[0], at[1]
    if not terms:
        return np.zeros((0, *none.shape))
    n = len(terms)
    parts = np.array([0.5 * ((at[2 + k] - none) + (everything - at[2 + n + k])) for k in range(n)])
    left = everything - none - parts.sum(axis=0)
    size = np.sqrt((parts**2).sum(axis=2).mean(axis=1))
    return np.asarray(parts + (size / max(float(size.sum()), 1e-12))[:, None, None] * left, dtype=float)
