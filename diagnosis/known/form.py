"""What the model of a machine without a fault is wrong by, as a function of what drives it: the baseline's form.

A velocity actuator stands for oil, friction and bending booms. What that leaves is mostly the same every day: fitted
on some recordings, functions of the command, its change, the angle and the load, and the responses that come later
(`known/courses.py`), predict most of what they explain of another one. Taken as known, it hides no fault and
looks like none. It is fixed by the baseline recordings: a diagnosis fits nothing of it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.behind.link_angles import Path
from diagnosis.behind.point_residual import PointResidual
from diagnosis.errors import DiagnosisError
from diagnosis.known.courses import (
    RESPONSE_FAMILY_NAMES,
    Course,
    actuator_responses,
    courses_of,
    hat_functions,
    modelled_of,
    moving_families,
    white_columns,
)
from diagnosis.log.nominal import Nominal
from diagnosis.replay.stage_replay import Replay
from diagnosis.search.cell import Cell
from diagnosis.search.fit import neutral_fit, soft_l1_costs, soft_l1_weights
from machine.remainder import Form
from machine.rotations import Array

INSTANT_RESPONSE_FAMILIES = ("the valve command", "the change of the command", "the load", "the angle", "other joints")
ACTUATOR_FORM_FAMILIES = (*INSTANT_RESPONSE_FAMILIES, *RESPONSE_FAMILY_NAMES)
TRACKED_POINT_FAMILY = "acceleration"
COMMAND_KNOTS = np.array(
    [-1.0, -0.5, -0.25, -0.12, -0.06, -0.03, 0.0, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0]
)  # of full command
SHUFFLED_PIECE_DURATION_S = 0.1  # of a course: a motion of shuffled pieces has all the frequencies that matter
RIDGE_PENALTIES = (10.0, 100.0, 1e3, 1e4)  # rows' worth of prior, of a motion unlike any and of each number
ENCODER_SMOOTHING_ROWS = 11  # of the encoders, for their accelerations
RIDGE_GAIN_MIN_FRAC = 0.85  # of the best gain
FAMILY_GAIN_MIN_NATS = 1.0  # a recording: a family that adds less is not worth its numbers
FORM_GAIN_MIN_NATS = 12.0  # over all recordings: twice the margin of a name
FORM_EXCESS_RATIO_MAX = 1.5  # the most that some recordings showed is exceeded by one more in every dozen
FORM_RECORDINGS_MIN = 3  # recordings: one of two would be predicted by a single one


def with_form(cells: list[Cell], nominal: Nominal) -> list[Cell]:
    """Cells less what their machine's model is known to be wrong by; as they are where the machine file says nothing.

    Raises: DiagnosisError: the machine file's numbers belong to an arm with other joints.
    """
    return [_subtract_known_form(cell, nominal) for cell in cells]


def _subtract_known_form(cell: Cell, nominal: Nominal) -> Cell:
    seen = cell.whitened
    if isinstance(seen, PointResidual) and seen.encoder_paths:
        form = _form_of(nominal, cell.stage, None, "tracker")
        if form:
            known = _evaluate_form({TRACKED_POINT_FAMILY: acceleration_columns(seen)}, form, "structure")
            return replace(cell, whitened=replace(seen, known_model_error_m=known))
    if isinstance(seen, Replay) and cell.stage == "actuator":
        return replace(cell, whitened=_course_taken_off(cell, seen, nominal))
    return cell


def _course_taken_off(cell: Cell, replay: Replay, nominal: Nominal) -> Replay:
    """The replay less its joints' forms; a form that says much more of this motion than of any it was fitted to is
    left out.
    """
    records = [nominal.baseline_remainder(cell.stage, joint + 1) for joint in replay.joints]
    forms = [() if record is None else record.form for record in records]
    most = [0.0 if record is None else record.form_most for record in records]
    if not any(forms):
        return replay
    measured, modelled = [part.measured_output.copy() for part in replay.stretch_replays], modelled_of(cell, replay)
    moved: list[list[Callable[[Array], Array] | None]] = [[None] * len(replay.joints) for _ in replay.stretch_replays]
    for channel, (joint, form) in enumerate(zip(replay.joints, forms, strict=True)):
        if not form:
            continue
        courses = courses_of(cell, replay, modelled, channel)
        known = [
            _evaluate_form(course_columns, form, f"{cell.stage} {joint + 1}")
            for course_columns in _actuator_families(courses)
        ]
        if most[channel] and _whitened_mean_square(replay, channel, known) > FORM_EXCESS_RATIO_MAX * most[channel]:
            continue
        for own, said, otherwise, course in zip(measured, known, moved, courses, strict=True):
            own[: len(said), channel] -= said
            otherwise[channel] = OtherMotion.of_stretch(course, form)
    pieces = zip(replay.stretch_replays, measured, moved, strict=True)
    parts = tuple(replace(part, measured_output=own, model_error_by_motion=tuple(moved)) for part, own, moved in pieces)
    return replace(replay, stretch_replays=parts)


@dataclass(frozen=True, slots=True)
class OtherMotion:
    """What a joint's form says beyond `subtracted_prediction`, of a joint that moves otherwise than modelled.

    Why: a joint that sticks moves in jumps where its command is smooth. Taken from the model without a fault, a form
    then speaks of a motion that never was: three quarters of what stiction of 0.2 left was that.
    """

    joint_signals: Course
    model_error_form: Form
    subtracted_prediction: Array

    @classmethod
    def of_stretch(cls, course: Course, form: Form) -> "OtherMotion":
        """Of a stretch along whose `course` the model without a fault runs."""
        families = moving_families(course)
        own = tuple(entry for entry in form if entry[0] in families)
        return cls(course, own, _evaluate_form(families, own, "a joint"))

    def __call__(self, q: Array) -> Array:
        """For a modelled course q (m,), in its unit (m,)."""
        return (
            _evaluate_form(
                moving_families(replace(self.joint_signals, modelled_output=q)), self.model_error_form, "a joint"
            )
            - self.subtracted_prediction
        )


def _actuator_families(courses: list[Course]) -> list[dict[str, Array]]:
    """Of one joint's actuator, for each stretch: its immediate response, and its later one (m, k)."""
    return [
        {
            "the valve command": course.integral_of(hat_functions(course.input_signal, COMMAND_KNOTS)),
            **moving_families(course),
            **actuator_responses(course),
        }
        for course in courses
    ]


def _whitened_mean_square(replay: Replay, channel: int, signals: list[Array]) -> float:
    """Mean square of signals (m,) of one joint, as white as its residual.

    Why: asked about motions unlike those that it was fitted to, a form says much more than of any of those.
    """
    pieces = zip(replay.stretch_replays, signals, strict=True)
    white = [white_columns(replay.whitener, channel, part.stretch.dt_s, added[:, None]) for part, added in pieces]
    return float(np.mean(np.concatenate(white) ** 2))


def most_of(cells: list[Cell], form: Form) -> float:
    """The most that a joint's form says of these recordings, as `Remainder.form_most`; 0 for other cells."""
    found = [0.0]
    for cell in cells:
        replay = cell.whitened
        if isinstance(replay, Replay):
            families = _actuator_families(courses_of(cell, replay, modelled_of(cell, replay), 0))
            found.append(
                _whitened_mean_square(replay, 0, [_evaluate_form(family, form, cell.label) for family in families])
            )
    return max(found)


def _form_of(nominal: Nominal, stage: str, joint: int | None, on: str) -> Form:
    record = nominal.baseline_remainder(stage, joint, on)
    return () if record is None else record.form


def _evaluate_form(families: dict[str, Array], form: Form, where: str) -> Array:
    """What the families come to (m,)."""
    total = np.zeros(len(next(iter(families.values()))))
    for name, numbers in form:
        columns = families.get(name)
        if columns is None or columns.shape[1] != len(numbers):
            wanted = "no such family here" if columns is None else f"{columns.shape[1]} wanted"
            raise DiagnosisError(
                f"machine file, [[remainder]] of {where}: form.{name} has {len(numbers)} numbers, {wanted}; "
                "fit the baseline again (`longreach diagnose --fit-baseline`)"
            )
        total += columns @ np.array(numbers)
    return total


@dataclass(frozen=True, slots=True)
class _StackedRecordings:
    """Recordings' columns of one size (N, k), residuals (N,) and normal equations.

    `column_family` (k,): which each is of. `prior_precision` (k, k): a row's worth of it.
    """

    design_and_residual: tuple[tuple[Array, Array], ...]
    normal_equations: tuple[tuple[Array, Array], ...]
    column_family: NDArray[np.int64]
    prior_precision: Array

    def of_families(self, families: tuple[int, ...]) -> "_StackedRecordings":
        """The same with these families alone."""
        kept = np.isin(self.column_family, families)
        normal = tuple((H[np.ix_(kept, kept)], g[kept]) for H, g in self.normal_equations)
        rows = tuple((B[:, kept], r) for B, r in self.design_and_residual)
        return _StackedRecordings(rows, normal, self.column_family[kept], self.prior_precision[np.ix_(kept, kept)])

    def ridge_solution(self, ridge: float, without: int | None = None) -> Array:
        """The numbers (k,) of all recordings but one."""
        used = [equations for k, equations in enumerate(self.normal_equations) if k != without]
        H, g = (
            np.sum([equations[0] for equations in used], axis=0),
            np.sum([equations[1] for equations in used], axis=0),
        )
        return np.asarray(np.linalg.solve(H + ridge * self.prior_precision, g))

    def gain(self, ridge: float) -> float:
        """How well the others predict each recording, over all [nats]."""
        if len(self.column_family) == 0:
            return 0.0
        return sum(
            float((soft_l1_costs(r) - soft_l1_costs(r - B @ self.ridge_solution(ridge, k))).sum())
            for k, (B, r) in enumerate(self.design_and_residual)
        )


def form_of(cells: list[Cell]) -> Form:
    """The form that the same cell of several baseline recordings has in common; empty where none is predicted.

    Model: min sum w (r - B x)^2 + ridge |x|^2 over all recordings, columns of one size. Families that add little to
           what the others predict of a recording are dropped by the ridge that predicts most. Then the largest ridge
           is taken that predicts nearly as much: numbers that the data do not need would be wrong outside of them.
    """
    pairs = [(columns, neutral_fit(cell).residual) for cell in cells if (columns := _whitened_families(cell))]
    if len(pairs) < FORM_RECORDINGS_MIN:
        return ()
    names = list(pairs[0][0])
    unlike = [columns for cell in cells[:FORM_RECORDINGS_MIN] if (columns := _whitened_families(cell, jumbled=True))]
    pile, size = _stack_recordings(pairs, unlike, names)
    best, loose = max((pile.gain(ridge), ridge) for ridge in RIDGE_PENALTIES)
    kept = tuple(range(len(names)))
    while len(kept) > 1:
        fewer = [tuple(k for k in kept if k != out) for out in kept]
        gain, rest = max((pile.of_families(families).gain(loose), families) for families in fewer)
        if gain < best - FAMILY_GAIN_MIN_NATS * len(pairs):
            break
        best, kept = gain, rest
    chosen = pile.of_families(kept)
    gains = {ridge: chosen.gain(ridge) for ridge in RIDGE_PENALTIES}
    if max(gains.values()) <= FORM_GAIN_MIN_NATS:
        return ()
    ridge = max(ridge for ridge, gain in gains.items() if gain >= RIDGE_GAIN_MIN_FRAC * max(gains.values()))
    x = chosen.ridge_solution(ridge) / size[np.isin(pile.column_family, kept)]
    return tuple((names[k], tuple(map(float, x[chosen.column_family == k]))) for k in kept)


def _stack_recordings(
    pairs: list[tuple[dict[str, Array], Array]], unlike: list[dict[str, Array]], names: list[str]
) -> tuple[_StackedRecordings, Array]:
    """All recordings on one pile, and what each column (k,) was divided by; inf where one never moves."""
    family = np.repeat(np.arange(len(names)), [pairs[0][0][name].shape[1] for name in names])
    stacked = [(np.concatenate([columns[name] for name in names], axis=1), r) for columns, r in pairs]
    power = np.mean([np.mean(B**2, axis=0) for B, _ in stacked], axis=0)
    size = np.sqrt(np.where(power > 0.0, power, np.inf))
    rows = tuple((B / size, r) for B, r in stacked)
    normal = tuple(((B.T * soft_l1_weights(r)) @ B, (B.T * soft_l1_weights(r)) @ r) for B, r in rows)
    prior = np.eye(len(family))
    if unlike:
        U = np.concatenate([np.concatenate([columns[name] for name in names], axis=1) for columns in unlike]) / size
        prior += U.T @ U / len(U)
    return _StackedRecordings(rows, normal, family, prior), size


def _whitened_families(cell: Cell, jumbled: bool = False) -> dict[str, Array]:
    """Families (N, k) of a cell of one joint, or of tracked points, as white as its residual.

    `jumbled`: of a motion unlike any that was recorded; none of tracked points, whose form has no memory.
    """
    seen = cell.whitened
    if isinstance(seen, PointResidual) and seen.encoder_paths:
        return {} if jumbled else {TRACKED_POINT_FAMILY: seen.noise.whiten(acceleration_columns(seen).T).T}
    if not isinstance(seen, Replay) or cell.stage != "actuator":
        return {}
    courses = courses_of(cell, seen, modelled_of(cell, seen), 0)
    if jumbled:
        courses = [_shuffled_course(course) for course in courses]
    pieces = zip(courses, _actuator_families(courses), strict=True)
    white = [
        {name: white_columns(seen.whitener, 0, course.dt_s, families[name]) for name in ACTUATOR_FORM_FAMILIES}
        for course, families in pieces
    ]
    return {name: np.concatenate([columns[name] for columns in white]) for name in ACTUATOR_FORM_FAMILIES}


def _shuffled_course(c: Course) -> Course:
    """A motion of the same sizes that jumps all the time: the pieces of a course in another order."""
    rows = max(1, round(SHUFFLED_PIECE_DURATION_S / c.dt_s))
    pieces = np.array_split(np.arange(len(c.modelled_output)), max(1, len(c.modelled_output) // rows))
    order = np.concatenate([pieces[k] for k in np.random.default_rng(0).permutation(len(pieces))])
    q = c.modelled_output[0] + c.integral_of(c.rate(c.modelled_output)[order])
    return replace(
        c,
        modelled_output=q,
        input_signal=c.input_signal[order],
        gravity_load=c.gravity_load[order],
        other_joint_commands=c.other_joint_commands[order],
    )


def acceleration_columns(measured: PointResidual) -> Array:
    """(3 m, 3 n) of tracked points, not weighed: what radial, tangential and up do with each joint's acceleration."""
    return np.asarray(
        np.kron(
            _encoder_accelerations(
                measured.encoder_paths, measured.path_index, measured.measured_points.time_or_pose_index
            ),
            np.eye(3),
        ),
        dtype=float,
    )


def _encoder_accelerations(paths: tuple[Path, ...], at: NDArray[np.int64], t_s: Array) -> Array:
    """Encoders' accelerations (m, n) at times (m,) in paths `at` (m,)."""
    n = paths[0].encoder_angles.shape[1]
    a = np.zeros((len(t_s), n))
    window = np.ones(ENCODER_SMOOTHING_ROWS) / ENCODER_SMOOTHING_ROWS
    for k in np.unique(at):
        rows, path = at == k, paths[k]
        for j in range(n):
            smooth = (
                np.convolve(path.encoder_angles[:, j], window, mode="same")
                if len(path.t_s) > ENCODER_SMOOTHING_ROWS
                else path.encoder_angles[:, j]
            )
            speed = np.gradient(smooth, path.t_s)
            a[rows, j] = np.interp(t_s[rows], path.t_s, np.gradient(speed, path.t_s))
    return a
