"""Where the gap lies: each stage's residual beyond its own noise floor, by joint, axis and regime."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.behind.points import fit_points, static_data, tracked_data
from diagnosis.behind.views import ooi_residual, tool_residual, views_of
from diagnosis.datagrams.clocks import camera_to_plc_s
from diagnosis.log.nominal import Nominal
from diagnosis.noise.floor import BLOCK_DURATION_S, block_increments, block_means
from diagnosis.reading.read import Read
from diagnosis.regimes import regimes_of
from diagnosis.replay.merge import merged_drives
from diagnosis.replay.repeats import align_repeats
from diagnosis.replay.replayer import PreparedStretch, Replayer, replayer_of
from diagnosis.replay.stretches import Stretch, repeat_groups
from diagnosis.sliding import unit_of
from machine.effects.entries import pack_effects
from machine.effects.layout import ParameterSets, neutral_sets
from machine.effects.structure import tcp_poses
from machine.rotations import Array

MERGED_STAGE_NAME = "actuator"  # the last of the stages that no valve command separates
STAGE_UNITS = {"link": "rad", "controller": "1", "actuator": "rad/s"}
POSE_AXIS_NAMES = ("x", "y", "z", "roll", "pitch", "yaw")
LEVER_ARM_POSTURES = 25
FINITE_DIFFERENCE_STEP_RAD = 1e-4
SUB_REGIMES = ("still", "forward", "backward", "reversal", "first half", "second half")  # regimes inside "all"


@dataclass(frozen=True, slots=True)
class Place:
    """Gap of one stage, joint (1-based) or axis, and regime: sqrt(max(0, MSE - floor^2)) in `unit`.

    `tcp_mm`: the gap carried to the tcp [mm, RMS]; `share_frac`: of the sum of what all stages miss the tool by.
    """

    stage: str
    joint: int | None
    axis: str | None
    motion_regime: str
    model_gap: float
    noise_floor: float
    unit: str
    tcp_mm: float
    share_frac: float = 0.0


@dataclass(frozen=True, slots=True)
class Localisation:
    """All places, largest share first within regime "all"; `floor_known`: from repeats. `merged_stage_reasons`:
    (stages, why).
    """

    gap_places: tuple[Place, ...]
    merged_stage_reasons: tuple[tuple[tuple[str, ...], str], ...]
    floor_known: bool


def localise(whole: Read) -> Localisation:
    """The gap of the nominal machine (with its baseline, if its file has one) on every stage that can be judged."""
    nominal, tables = whole.nominal_machine, whole.tables
    if nominal is None or tables is None or not whole.has_judgeable_stage:
        return Localisation((), (), False)
    sets = pack_effects(nominal.baseline_effects, nominal.n)
    groups = repeat_groups(whole.stretches)
    replayer, places = replayer_of(nominal, whole.stretches), []
    lever = levers_mm(nominal, whole.stretches)
    if replayer is not None:
        prepared = [replayer.prepare(stretch) for stretch in whole.stretches]
        for stage in STAGE_UNITS:
            places += _dynamic_stage_places(replayer, stage, prepared, groups, sets, lever)
        places += _dynamic_stage_places(
            replayer, MERGED_STAGE_NAME, merged_drives(replayer, whole.stretches), groups, sets, lever
        )
    places += _structure_places(whole, nominal, sets) + _camera_places(whole, nominal, sets)
    return Localisation(_assign_shares(places), merged_stages(whole), bool(groups))


def _dynamic_stage_places(
    replayer: Replayer,
    stage: str,
    prepared: list[PreparedStretch],
    groups: dict[str, tuple[Stretch, ...]],
    sets: ParameterSets,
    lever: Array,
) -> list[Place]:
    errors: dict[str, Array] = {}
    for entry in prepared:
        error = stage_error(replayer, stage, entry, sets)
        if error is not None:
            errors[entry.stretch.name] = error
    judged = [entry.stretch for entry in prepared if entry.stretch.name in errors]
    if not judged:
        return []
    floor = np.hypot(_repeat_noise_floor(stage, groups, errors), _baseline_remainder(replayer.nominal_machine, stage))
    carried = _to_radians(replayer, stage) * lever
    places: list[Place] = []
    for j in range(replayer.nominal_machine.n):
        values = [_regime_values(stretch, errors[stretch.name][:, j], j) for stretch in judged]
        for regime in dict.fromkeys(name for by_name in values for name in by_name):
            pooled = np.concatenate([by_name[regime] for by_name in values if regime in by_name])
            if not np.isfinite(pooled).all():
                continue  # a column that was not recorded
            gap = error_above_floor(pooled, float(floor[j]))
            tcp_mm = gap * float(carried[j])
            unit = unit_of(STAGE_UNITS[stage], replayer.nominal_machine.joint_slides, j)
            places.append(Place(stage, j + 1, None, regime, gap, float(floor[j]), unit, tcp_mm))
    return places


def _baseline_remainder(nominal: Nominal, stage: str) -> Array:
    """What the baseline leaves of a stage, in the unit of its error (n,)."""
    records = [nominal.baseline_remainder(stage, j + 1) for j in range(nominal.n)]
    per_second = 1.0 / BLOCK_DURATION_S if stage == "actuator" else 1.0
    return per_second * np.array([record.rms if record is not None else 0.0 for record in records])


def stage_error(replayer: Replayer, stage: str, prepared: PreparedStretch, sets: ParameterSets) -> Array | None:
    """A stage's error at 20 Hz (m, n): reference [rad], command [1], or speed of the actuator [rad/s]."""
    residual = replayer.residuals(stage, prepared, sets)
    if residual is None:
        return None
    dt_s = prepared.stretch.dt_s
    if stage == "actuator":  # open loop: its error of position is a random walk, its error of speed is not
        return block_increments(residual[0], dt_s) / max(BLOCK_DURATION_S, dt_s)
    return block_means(residual[0], dt_s)[1:]


def _repeat_noise_floor(stage: str, groups: dict[str, tuple[Stretch, ...]], errors: dict[str, Array]) -> Array:
    """RMS deviation (n,) of the repeats' errors from their mean; without repeats, from their second differences."""
    squares: list[Array] = []
    for members in groups.values():
        known = tuple(member for member in members if member.name in errors)
        if len(known) > 1:
            laid = align_repeats(
                tuple(_at_20_hz(stretch) for stretch in known), [errors[stretch.name] for stretch in known]
            )
            squares.append(np.mean((laid - laid.mean(axis=0)) ** 2, axis=(0, 1)) * len(known) / (len(known) - 1.0))
    if squares:
        return np.sqrt(np.mean(squares, axis=0))
    rough = [
        np.median(np.abs(np.diff(error, n=2, axis=0)), axis=0) / 0.6745 / np.sqrt(6.0) for error in errors.values()
    ]
    return np.asarray(np.median(rough, axis=0), dtype=float)


def _at_20_hz(stretch: Stretch) -> Stretch:
    return replace(stretch, dt_s=max(BLOCK_DURATION_S, stretch.dt_s))


def _regime_values(stretch: Stretch, error: Array, j: int) -> dict[str, Array]:
    position = stretch.enc if stretch.enc is not None else stretch.ref
    if position is None:
        return {"all": error}
    blocks = block_means(position[:, [j]], stretch.dt_s)[1 : len(error) + 1, 0]
    return {name: error[mask] for name, mask in regimes_of(blocks, max(BLOCK_DURATION_S, stretch.dt_s)).items()}


def error_above_floor(error: Array, floor: float) -> float:
    """sqrt(max(0, MSE - floor^2)) of errors (m,)."""
    return float(np.sqrt(max(0.0, float(np.mean(error**2)) - floor**2)))


def _to_radians(replayer: Replayer, stage: str) -> Array:
    """What one unit of a stage's error comes to at the joint (n,) [rad], in the closed loop at rest.

    Model: a reference's error is the joint's; a command's error is held by error / kp; a speed's error by
           speed / (kp velocity gain), or, without a controller, over one second.
    """
    gain, kp = replayer.plant.joints[:, 0], replayer.plant.joints[:, 3]
    closed = replayer.nominal_machine.has_controller
    ones = np.ones(len(gain))
    return {
        "link": ones,
        "controller": 1.0 / kp if closed else gain,
        "actuator": 1.0 / (kp * gain) if closed else ones,
    }[stage]


def levers_mm(nominal: Nominal, stretches: tuple[Stretch, ...]) -> Array:
    """RMS motion of the tcp per joint angle (n,) [mm/rad] over the recorded postures; 1000 without an arm."""
    if nominal.arm is None or not stretches:
        return np.full(nominal.n, 1e3)
    found = [stretch.enc if stretch.enc is not None else stretch.ref for stretch in stretches]
    stack = np.concatenate([q[np.isfinite(q).all(axis=1)] for q in found if q is not None])
    if len(stack) == 0:
        return np.full(nominal.n, 1e3)
    qs = stack[np.linspace(0, len(stack) - 1, LEVER_ARM_POSTURES).astype(int)]
    sets = neutral_sets(nominal.n)
    at = tcp_poses(nominal.arm, sets, qs)[:, :3, 3]
    moved = [tcp_poses(nominal.arm, sets, qs + FINITE_DIFFERENCE_STEP_RAD * row)[:, :3, 3] for row in np.eye(nominal.n)]
    return np.array(
        [1e3 * np.sqrt(np.mean(np.sum((shifted - at) ** 2, axis=1))) / FINITE_DIFFERENCE_STEP_RAD for shifted in moved]
    )


def _structure_places(whole: Read, nominal: Nominal, sets: ParameterSets) -> list[Place]:
    tables, places = whole.tables, []
    if tables is None or nominal.arm is None:
        return []
    static = static_data(nominal, tables.static) if tables.static is not None else None
    tracked = tracked_data(nominal, tables.tracker, whole.stretches) if tables.tracker is not None else None
    for regime, data in (("at rest", static), ("tracked", tracked)):
        if data is not None and len(data.xyz) >= 4:
            residual = fit_points(nominal, sets, data).residual_m
            places += _places_by_axis("structure", regime, residual, np.zeros(3))
    return places


def _camera_places(whole: Read, nominal: Nominal, sets: ParameterSets) -> list[Place]:
    tables, places = whole.tables, []
    if tables is None or tables.markers is None or nominal.camera is None:
        return []
    tool = tool_residual(nominal, views_of(nominal, tables.markers, "tool"))
    if tool is not None:
        places += _places_by_axis("camera", "tool marker", tool, _view_noise(tool))
    views = views_of(nominal, tables.markers, "ooi")
    shift_s = camera_to_plc_s(tables)
    q, inside = _encoders_at(whole.stretches, views.t_s + shift_s, nominal.n)
    if inside.sum() > 1:
        seen = replace(views, t_s=views.t_s[inside], Ts_cam_object=views.Ts_cam_object[inside])
        ooi = ooi_residual(nominal, sets, seen, q[inside])
        if ooi is not None:
            places += _places_by_axis("camera", "ooi", ooi, _view_noise(ooi))
    return places


def _encoders_at(stretches: tuple[Stretch, ...], t_s: Array, n: int) -> tuple[Array, NDArray[np.bool_]]:
    """Encoders (m, n) at these times, and whether a stretch holds them (m,)."""
    q, inside = np.full((len(t_s), n), np.nan), np.zeros(len(t_s), dtype=bool)
    for stretch in stretches:
        if stretch.enc is not None:
            now = (t_s >= stretch.t_s[0]) & (t_s <= stretch.t_s[-1])
            q[now] = np.stack([np.interp(t_s[now], stretch.t_s, column) for column in stretch.enc.T], axis=1)
            inside |= now
    return q, np.asarray(inside & np.isfinite(q).all(axis=1), dtype=bool)


def _view_noise(error: Array) -> Array:
    """Noise from one view to the next (k,), by the median of second differences; an upper bound in motion."""
    if len(error) < 4:
        return np.zeros(error.shape[1])
    return np.asarray(np.median(np.abs(np.diff(error, n=2, axis=0)), axis=0) / 0.6745 / np.sqrt(6.0), dtype=float)


def _places_by_axis(stage: str, regime: str, error: Array, floor: Array) -> list[Place]:
    """One place an axis; positions [m] count at the tcp as they are, rotations are not carried on."""
    places = []
    for k in range(error.shape[1]):
        gap = error_above_floor(error[:, k], float(floor[k]))
        unit, tcp_mm = ("m", 1e3 * gap) if k < 3 else ("rad", 0.0)
        places.append(Place(stage, None, POSE_AXIS_NAMES[k], regime, gap, float(floor[k]), unit, tcp_mm))
    return places


def beyond_noise(found: Localisation, stages_mm: Mapping[tuple[str, int | None], float]) -> Localisation:
    """The same places by what each stage, or each of its joints, misses beyond its noise [mm at the tcp].

    Why: repeats show how much a healthy machine scatters in one recording, not what it leaves from day to day, nor the
    noise of points and markers. The budget knows both: what it does not see as a gap is the place's floor.
    """
    places = []
    for place in found.gap_places:
        of_joint = (place.stage, place.joint) in stages_mm
        mm = stages_mm.get((place.stage, place.joint if of_joint else None), 0.0)
        alike = [p for p in found.gap_places if p.stage == place.stage and (not of_joint or p.joint == place.joint)]
        moved = math.hypot(*(p.tcp_mm for p in alike if p.motion_regime not in SUB_REGIMES))
        part = min(1.0, mm / moved) if moved > 0.0 else 0.0
        floor = math.sqrt(place.noise_floor**2 + (1.0 - part**2) * place.model_gap**2)
        places.append(replace(place, model_gap=part * place.model_gap, tcp_mm=part * place.tcp_mm, noise_floor=floor))
    totals = {stage: math.hypot(*(mm for at, mm in stages_mm.items() if at[0] == stage)) for stage, _ in stages_mm}
    return replace(found, gap_places=_assign_shares(places, totals))


def _assign_shares(places: list[Place], stages_mm: Mapping[str, float] | None = None) -> tuple[Place, ...]:
    """Shares of the sum over stages of their tcp motion (root sum of squares within a stage), largest first; those of
    all places, without the regimes inside "all", sum to one.
    """
    whole = [place for place in places if place.motion_regime not in SUB_REGIMES]
    moved = stages_mm or {p.stage: math.hypot(*(q.tcp_mm for q in whole if q.stage == p.stage)) for p in whole}
    total = sum(moved[stage] for stage in {place.stage for place in whole} & moved.keys())
    shared = [replace(place, share_frac=_share_of_place(place, whole, moved, total)) for place in places]
    return tuple(sorted(shared, key=lambda place: (place.motion_regime in SUB_REGIMES, -place.share_frac)))


def _share_of_place(place: Place, whole: list[Place], moved: Mapping[str, float], total: float) -> float:
    """A place's share: its stage's, by its part of the stage's motion; in equal parts where nothing stands out."""
    if total <= 0.0 or place.stage not in moved:
        return 0.0
    of_stage = sum(other.tcp_mm for other in whole if other.stage == place.stage)
    if of_stage > 0.0:
        return moved[place.stage] / total * place.tcp_mm / of_stage
    return moved[place.stage] / total / sum(other.stage == place.stage for other in whole)


def totals_of(places: tuple[Place, ...]) -> tuple[Place, ...]:
    """One place a stage and unit, of all of its joints or axes and motions together, largest share first.

    Model: gap and floor are RMS over joints, those that turn and those that slide apart: what is in rad/s and what is
           in m/s has no mean, and only the shares, which are motions of the tcp, go over both. Of axes, those in m, the
           root of their sum of squares, RMS over "at rest", "tracked", "tool marker" and "ooi".
    """
    out = []
    for stage in dict.fromkeys(place.stage for place in places):
        all_of = [place for place in places if place.stage == stage and place.motion_regime not in SUB_REGIMES]
        for unit in dict.fromkeys(_counted_under(place, all_of) for place in all_of):
            together = [place for place in all_of if _counted_under(place, all_of) == unit]
            out.append(_stage_total(stage, unit, together))
    return tuple(sorted(out, key=lambda place: -place.share_frac))


def _counted_under(place: Place, of_stage: list[Place]) -> str:
    """The unit of the total that a place belongs to: a joint's own; of axes the first one's, rotations as well as m."""
    return place.unit if place.joint is not None else of_stage[0].unit


def _stage_total(stage: str, unit: str, together: list[Place]) -> Place:
    same = [place for place in together if place.unit == unit]
    count = len(same) if same[0].axis is None else len({place.motion_regime for place in same})
    gap = math.sqrt(sum(place.model_gap**2 for place in same) / count)
    floor = math.sqrt(sum(place.noise_floor**2 for place in same) / count)
    tcp_mm, share = math.hypot(*(place.tcp_mm for place in together)), sum(place.share_frac for place in together)
    return Place(stage, None, None, "all", gap, floor, unit, tcp_mm, share)


def merged_stages(whole: Read) -> tuple[tuple[tuple[str, ...], str], ...]:
    """Neighbouring stages that this recording cannot distinguish, and the missing signal that merges them."""
    tables = whole.tables
    some = whole.stretches
    if tables is None:
        return ()
    merged: list[tuple[tuple[str, ...], str]] = []
    if some and not any(stretch.enc is not None for stretch in some):
        merged.append((("controller", "actuator"), "no q in plc.csv: how the joints moved is not known"))
    has_ref, has_u = any(stretch.ref is not None for stretch in some), any(stretch.u is not None for stretch in some)
    if some and not any(stretch.sent_reference is not None for stretch in some):
        merged.append((("time", "link"), "no sent.csv: the link is not seen"))
    if some and not has_ref:
        merged.append((("link", "controller", "actuator"), "no q_ref in plc.csv: the received reference is not known"))
    elif some and not all(stretch.ref_logged for stretch in some):
        text = "no q_ref in plc.csv: what the PLC makes of a datagram's numbers looks like its controller"
        merged.append((("link", "controller"), text))
    if has_ref and not has_u:
        merged.append((("controller", "actuator"), "no u in plc.csv: the valve command is not known"))
    outside = tables.static is not None or tables.tracker is not None
    if tables.markers is None and not outside:
        text = "nothing was measured behind the encoders: no camera, no tracker"
        if tables.odometry is not None:
            text = "behind the encoders only odometry was measured: no marker, no tracker"
        merged.append((("joint", "structure", "camera"), text))
    elif not outside:
        merged.append((("joint", "structure", "camera"), "no tracker: the camera alone measures behind the encoders"))
    elif tables.markers is None:
        merged.append((("joint", "structure"), "no link-side angle: the tracker sees joints and links together"))
    return tuple(merged)
