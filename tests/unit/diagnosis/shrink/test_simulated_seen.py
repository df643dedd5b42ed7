"""The object of interest stands still where the simulator's tool and camera are right."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from diagnosis_cases import MACHINE, MACHINE_TOML

from benchmarks.diagnosis.links.recorded import Q_START
from diagnosis.log.nominal import nominal_of
from diagnosis.log.tables import MarkerTable, Tables
from diagnosis.replay.stretches import Stretch
from longreach.simulated_shrink.seen import about_their_mean, eyes_of, object_places
from machine.chain import chain_of
from machine.effects.entries import EffectEntry
from machine.effects.layout import neutral_sets
from machine.effects.seen import seen_corners
from machine.kinematics import tcp_pose
from recording.run import RunInfo
from sim_plc.recorded_drive import follow_reference, offline, plain_world

NOMINAL = nominal_of(MACHINE_TOML)
LATE = EffectEntry("camera_latency", None, (("latency_s", 0.08),))
T_S = np.arange(0.0, 8.0, 0.01)


@pytest.fixture(scope="module")
def driven():
    """A slow wave of slew and lift, and its stretch."""
    way = 0.03 * np.sin(0.7 * T_S)[:, None] * np.array([1.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    plain = plain_world(MACHINE)
    course = follow_reference(offline(plain, ()), T_S, Q_START + way, Q_START)
    nothing: Any = None
    stretch = Stretch("s", "sweep", "", 0.0, 0.01, T_S, nothing, course.q_encoder, nothing)
    return plain, course, stretch


def tables(course, late_s):
    """Corners of the object 1 m in front of the camera, each stamp later than its exposure."""
    camera, mount = NOMINAL.camera, MACHINE.T_tcp_cam_left
    markers = tuple(one for one in NOMINAL.markers if one.on == "ooi")
    ahead = np.diag([1.0, -1.0, -1.0, 1.0])
    ahead[2, 3] = 1.0
    T_base_ooi = tcp_pose(chain_of(MACHINE), Q_START) @ mount @ ahead
    t = np.arange(0.5, 7.5, 0.1)
    Ts = np.linalg.inv(course.at(T_S, t).tcp_poses() @ mount) @ T_base_ooi
    seen = seen_corners(neutral_sets(6), camera, markers, Ts)
    rows = [
        (stamp + late_s, eye, marker.marker_id, corners[k, m])
        for k, stamp in enumerate(t)
        for eye, corners in enumerate((seen.left, seen.right))
        for m, marker in enumerate(markers)
    ]
    stamps, eyes, ids, corners = zip(*rows, strict=True)
    table = MarkerTable(np.array(stamps), np.array(eyes), np.array(ids), np.array(corners))
    run = RunInfo("made", plc_to_pc_offset_s=0.0, camera_to_pc_offset_s=0.0)
    made: Any = SimpleNamespace(markers=table, run=run)
    return cast(Tables, made), T_base_ooi[:3, 3]


def test_the_object_is_found_where_it_is_from_wherever_it_is_seen(driven):
    plain, course, stretch = driven
    made, place = tables(course, 0.0)
    found = object_places(made, eyes_of(NOMINAL, plain, ()), course, stretch)
    assert len(found) > 50
    assert np.abs(found - place).max() < 1e-6


def test_a_late_stamp_moves_it_and_is_taken_out_by_its_effect(driven):
    plain, course, stretch = driven
    made, place = tables(course, 0.08)
    unaware = object_places(made, eyes_of(NOMINAL, plain, ()), course, stretch)
    aware = object_places(made, eyes_of(NOMINAL, plain, (LATE,)), course, stretch)
    assert np.abs(unaware - place).max() > 1e-3
    assert np.abs(aware - place).max() < 1e-5
    ((before, after),) = about_their_mean([unaware], [aware])
    assert np.sqrt((before**2).mean()) > 50.0 * np.sqrt((after**2).mean())


def test_a_focal_length_is_the_simulators(driven):
    plain, course, stretch = driven
    longer = EffectEntry("focal_length_error", None, (("scale_frac", 0.02),))
    made, place = tables(course, 0.0)
    found = object_places(made, eyes_of(NOMINAL, offline(plain, (longer,)).world, (longer,)), course, stretch)
    distance = np.linalg.norm(found - place, axis=1)
    assert distance.mean() == pytest.approx(0.02, rel=0.1)  # of 1 m
