"""Object position from camera and simulated tool pose; it is constant if both are right."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.behind.views import views_of
from diagnosis.datagrams.clocks import camera_to_plc_s
from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import MarkerTable, Tables
from diagnosis.replay.stretches import Stretch
from longreach.simulated_shrink.compare import SKIPPED_S
from machine.effects.entries import EffectEntry
from machine.rotations import Array
from sim_plc.recorded_drive import Course
from sim_plc.world import World

LATE = {"clock_offset": "offset_s", "camera_latency": "latency_s"}  # by how much a stamp is later than its exposure


@dataclass(frozen=True, slots=True)
class Eyes:
    """The camera and the object's markers as the simulator has them, and how late its stamps are [s]."""

    nominal: Nominal
    T_tcp_cam_left: Array
    late_s: float


def eyes_of(nominal: Nominal, world: World, entries: tuple[EffectEntry, ...]) -> Eyes:
    """The simulator's camera in place of the file's; the right eye is taken to be as the left one."""
    others = tuple(marker for marker in nominal.markers if marker.on != "ooi")
    known = replace(nominal, camera=world.camera.left, markers=(*others, *world.scene.ooi_markers))
    late_s = sum(entry.value(LATE[entry.name]) for entry in entries if entry.name in LATE)
    return Eyes(known, world.camera.T_tcp_cam_left, late_s)


def object_places(tables: Tables, eyes: Eyes, course: Course, stretch: Stretch) -> Array:
    """Places (m, 3) [m] of the object in the base, one a frame in which both eyes see a marker whole.

    Model: T_base_ooi = T_base_tcp(t) T_tcp_cam T_cam_ooi, with the simulator's T_base_tcp at the exposure.
    """
    table = tables.markers
    if table is None:
        return np.zeros((0, 3))
    to_plc_s = camera_to_plc_s(tables)
    # one window for both cameras, so that before and after see the same frames
    start, end = stretch.t_s[0] + SKIPPED_S, stretch.t_s[-1] - 0.5 * SKIPPED_S
    inside = (table.t_s + to_plc_s >= start) & (table.t_s + to_plc_s <= end)
    seen = views_of(eyes.nominal, _rows(table, np.nonzero(inside)[0]), "ooi")
    if len(seen.t_s) == 0:
        return np.zeros((0, 3))
    Ts = course.at(stretch.t_s, seen.t_s + to_plc_s - eyes.late_s).tcp_poses()
    return np.asarray((Ts @ eyes.T_tcp_cam_left @ seen.Ts_cam_object)[:, :3, 3], dtype=float)


def _rows(table: MarkerTable, rows: NDArray[np.int64]) -> MarkerTable:
    return MarkerTable(table.t_s[rows], table.eye[rows], table.ids[rows], table.corners[rows])


def about_their_mean(before: list[Array], after: list[Array]) -> list[tuple[Array, Array]]:
    """Places less their mean over all stretches, before and after each by its own: the true place is unknown."""
    if not before or sum(len(places) for places in before) < 2:
        return []
    means = [np.concatenate(ones).mean(axis=0) for ones in (before, after)]
    return [(b - means[0], a - means[1]) for b, a in zip(before, after, strict=True) if len(b)]
