"""How far each of several machine files misses the tool over a recording: simulated by what was sent, against what was
seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.behind.link_angles import link_angles, path_index, paths_of, without_encoders
from diagnosis.behind.views import views_of
from diagnosis.datagrams.clocks import camera_to_plc_s
from diagnosis.errors import DiagnosisError
from diagnosis.log.nominal import Nominal, nominal_of
from diagnosis.log.tables import MarkerTable, Tables
from diagnosis.reading.read import Read
from diagnosis.replay.replayer import closed_loop, replayer_of
from diagnosis.replay.stretches import Stretch
from machine.effects.dynamics import DynamicStage, simulate
from machine.effects.entries import pack_under
from machine.effects.layout import MARKER_SIZE, ParameterSets, neutral_sets
from machine.effects.seen import camera_mount, true_camera, true_times
from machine.effects.structure import tcp_poses
from machine.rotations import Array
from machine.targets import Marker

START_SKIPPED_S = 1.0  # at a stretch's start: what the valves were doing there is not known
MM = 1e3


@dataclass(frozen=True, slots=True)
class ToolMiss:
    """One machine file's miss at the tool. `t_s` (m,) on the PLC's clock, `miss_mm` (m,).

    `measured_by`: "camera" (where the object seems to be, about its median: all that is wrong is in it), or "encoders"
    (how the tool follows what was sent).
    """

    machine_file_name: str
    measured_by: str
    t_s: Array
    miss_mm: Array

    @property
    def rms_mm(self) -> float:
        """Over the whole recording."""
        return float(np.sqrt(np.mean(self.miss_mm**2))) if len(self.miss_mm) else float("nan")


def tool_misses(whole: Read, machines: Sequence[tuple[str, str]]) -> tuple[ToolMiss, ...]:
    """Every machine file's miss, by the encoders and, where the object was seen, by the camera.

    Args:   machines: (name, text) of each file.
    Raises: DiagnosisError: nothing in the recording can drive a simulation.
    """
    out: list[ToolMiss] = []
    for name, text in machines:
        nominal = nominal_of(text)
        runs = _recorded_and_simulated_runs(whole, nominal)
        if not runs:
            raise DiagnosisError(
                "nothing recorded can drive a simulation: it needs encoders and the reference, as sent or received"
            )
        out.append(_by_encoders(name, nominal, runs))
        seen = _by_camera(name, whole.tables, nominal, [run for _, run in runs])
        out += [seen] if seen is not None else []
    return tuple(out)


def _recorded_and_simulated_runs(whole: Read, nominal: Nominal) -> list[tuple[Stretch, Stretch]]:
    """Every stretch as recorded, and as a machine with the file's effects drives it by what was sent."""
    replayer = replayer_of(nominal, whole.stretches)
    if replayer is None or nominal.arm is None or not nominal.has_controller:
        return []
    base, out = pack_under(nominal.baseline_effects, nominal.n), []
    for stretch in whole.stretches:
        run = closed_loop(replayer, stretch)
        if run is not None:
            plant, drive, _ = run
            simulated = simulate(plant, base, drive, DynamicStage.ACTUATOR).enc[0]
            out.append((stretch, replace(stretch, enc=simulated)))
    return out


def _by_encoders(name: str, nominal: Nominal, runs: list[tuple[Stretch, Stretch]]) -> ToolMiss:
    times, miss = [], []
    for recorded, simulated in runs:
        if nominal.arm is None or recorded.enc is None or simulated.enc is None:
            continue
        rows = slice(round(START_SKIPPED_S / recorded.dt_s), None, max(1, round(0.05 / recorded.dt_s)))
        plain = neutral_sets(nominal.n)
        at = [tcp_poses(nominal.arm, plain, enc[rows])[:, :3, 3] for enc in (recorded.enc, simulated.enc)]
        times.append(recorded.t_s[rows])
        miss.append(MM * np.linalg.norm(at[0] - at[1], axis=1))
    return ToolMiss(name, "encoders", np.concatenate(times), np.concatenate(miss))


def _by_camera(name: str, tables: Tables | None, nominal: Nominal, simulated: list[Stretch]) -> ToolMiss | None:
    """Where the object seems to be by the simulated machine; about its mean, since its true place is unknown."""
    if tables is None or tables.markers is None or nominal.camera is None or nominal.arm is None:
        return None
    if nominal.T_tcp_cam_left is None or not simulated:
        return None
    base = pack_under(nominal.baseline_effects, nominal.n)
    eyes = _nominal_with_camera_effects(nominal, base)
    paths = paths_of(tuple(simulated))
    stamps = tables.markers.t_s + camera_to_plc_s(tables)
    starts = np.array([path.t_s[0] for path in paths])
    exposed = true_times(base, stamps, float(starts.min()))
    there = path_index(paths, exposed, START_SKIPPED_S) >= 0
    seen = views_of(eyes, _select_marker_rows(tables.markers, np.nonzero(there)[0]), "ooi")
    if len(seen.t_s) < 2:
        return None
    t_s = true_times(base, seen.t_s + camera_to_plc_s(tables), float(starts.min()))
    angles = link_angles(paths, base, 0, path_index(paths, t_s), t_s)
    Ts = tcp_poses(nominal.arm, without_encoders(base), angles) @ camera_mount(base, nominal.T_tcp_cam_left)
    places = (Ts @ seen.Ts_cam_object)[:, :3, 3]
    return ToolMiss(name, "camera", t_s, MM * np.linalg.norm(places - np.median(places, axis=0), axis=1))


def _nominal_with_camera_effects(nominal: Nominal, base: ParameterSets) -> Nominal:
    """The nominal machine with the camera and the markers as the file's effects have them."""
    if nominal.camera is None:
        return nominal
    size = 1.0 + float(base.machine_parameters[0, MARKER_SIZE])
    markers: tuple[Marker, ...] = tuple(replace(marker, side_m=marker.side_m * size) for marker in nominal.markers)
    return replace(nominal, camera=true_camera(base, nominal.camera), markers=markers)


def _select_marker_rows(table: MarkerTable, rows: NDArray[np.int64]) -> MarkerTable:
    return MarkerTable(table.t_s[rows], table.eye[rows], table.marker_ids[rows], table.corners_px[rows])
