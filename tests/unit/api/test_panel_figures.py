"""What the page is told beside the state: figures, goal, history, settings with units, overlay."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_api_routes import MACHINE, StandInLink, StandInPerformer, StandInRecorder, StandInVision, previewed

from machine.chain import chain_of
from machine.poses import pose
from server.api.panel import setting_rows
from server.api.panel_view import LATENESS_BIN_EDGES_MS, link_figures, loss_pct, safety_view
from server.api.state_view import step_refusals
from server.api.video import _axes_overlay
from server.jobs.cell import Cell
from server.jobs.engine import JobEngine
from server.link.contracts import LinkHealth, LinkPhase
from server.settings import ServerSettings, read_machine

HEALTH = LinkHealth(LinkPhase.ARMED, 1.0, 100, 1000, 20, 3, 50.0, 700.0, 9000.0, 0.4, "", 1)


def sample(t_plc_ms, t_mono_ms, bits=0):
    return SimpleNamespace(
        t_plc_ns=int(t_plc_ms * 1e6), t_mono_ns=int(t_mono_ms * 1e6), buffer_us=120_000, fault_bits=bits
    )


def test_the_histogram_counts_every_state_from_the_earliest_one():
    late_ms = [0.0, 0.2, 0.7, 3.0, 100.0]
    figures = link_figures([sample(10 * i, 5000 + 10 * i + late) for i, late in enumerate(late_ms)], HEALTH, 0.0)
    assert figures.lateness_edges_ms == list(LATENESS_BIN_EDGES_MS)
    assert figures.lateness_counts == [2, 1, 0, 1, 0, 0, 0, 1]
    assert figures.buffer_ms == 120.0


def test_no_state_no_count():
    assert sum(link_figures([], HEALTH, 0.0).lateness_counts) == 0


def test_loss_is_of_the_window_and_survives_counters_that_begin_anew():
    assert loss_pct((900, 10), HEALTH) == pytest.approx(100.0 * 10 / 110)
    assert loss_pct((5000, 10), HEALTH) == 0.0


@pytest.mark.parametrize(
    ("phase", "bits", "estop", "enable"),
    [
        (LinkPhase.ARMED, 0, "not pressed", "given"),
        (LinkPhase.DISARMED, 0, "not pressed", "needed to arm"),
        (LinkPhase.FAULT, 1, "PRESSED", "needed to arm"),
        (LinkPhase.FAULT, 2, "not pressed", "LOST"),
        (LinkPhase.OFFLINE, 0, "not reported", "not reported"),
    ],
)
def test_what_the_plc_tells_of_the_hardware(phase, bits, estop, enable):
    view = safety_view(replace(HEALTH, phase=phase), sample(0, 0, bits), [])
    assert (view.estop, view.enable) == (estop, enable)


def test_what_the_page_may_execute_is_what_the_server_would():
    link = StandInLink()
    cell = Cell(ServerSettings(), MACHINE, chain_of(MACHINE), "", link, StandInVision(), StandInRecorder())
    engine = JobEngine(StandInPerformer(link))
    assert step_refusals(cell, engine)["execute"] == "preview first"
    cell.knowledge.previewed_plan = previewed(60.0)
    link.latest = SimpleNamespace(q_rad=np.deg2rad([0, 0.1, 0, 0, 0, 0]), simulation=True)
    assert step_refusals(cell, engine)["execute"] == ""
    link.latest = SimpleNamespace(q_rad=np.deg2rad([0, 0.2, 0, 0, 0, 0]), simulation=True)
    told = "joint lift moved by +0.200 deg since the look (limit 0.115 deg); look again"
    assert step_refusals(cell, engine)["execute"] == told


@pytest.mark.parametrize("names_a_posture", [True, False])
def test_the_park_button_tells_of_a_machine_without_a_posture(names_a_posture):
    joints = MACHINE.joints if names_a_posture else tuple(replace(joint, park_rad=None) for joint in MACHINE.joints)
    machine, link = replace(MACHINE, joints=joints), StandInLink()
    cell = Cell(ServerSettings(), machine, chain_of(machine), "", link, StandInVision(), StandInRecorder())
    why = step_refusals(cell, JobEngine(StandInPerformer(link)))["park"]
    assert ("names no park posture" in why) is not names_a_posture


def test_settings_carry_their_units():
    rows = {row.name: row for row in setting_rows(ServerSettings().model_dump())}
    assert rows["position.tolerance_mm"].unit == "mm"
    assert rows["closed_loop.speed_max_mm_s"].unit == "mm/s"
    assert rows["look.timeout_s"].unit == "s"
    assert rows["plc.auth_key_file"].value == "not set"


def test_a_cross_stands_where_the_pinhole_puts_it_and_nowhere_behind_the_camera():
    camera = replace(read_machine("hiab033").camera, distortion=(0.0,) * 5)
    cross = _axes_overlay(camera, pose(np.eye(3), np.array([0.1, 0.0, 1.0])))
    assert cross.origin_px == [pytest.approx(camera.cx_px + 0.1 * camera.fx_px, abs=0.1), camera.cy_px]
    assert cross.axes_px[0][0] - cross.origin_px[0] == pytest.approx(0.05 * camera.fx_px, abs=0.1)
    assert _axes_overlay(camera, pose(np.eye(3), np.array([0.0, 0.0, -1.0]))) is None
