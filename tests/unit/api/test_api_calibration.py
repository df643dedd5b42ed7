"""The calibration over REST and by command: shown, exported, expired, absent."""

import asyncio
import time
from dataclasses import replace

import httpx
import numpy as np
import pytest
import yaml
from fastapi import FastAPI
from test_api_routes import MACHINE, StandInLink, StandInPerformer, StandInRecorder, StandInVision, control
from typer.testing import CliRunner

from longreach.cli import app
from machine.chain import chain_of
from machine.kinematics import tcp_pose
from server.api.calibration import calibration_router
from server.api.jobs import jobs_router
from server.api.problems import install_problem_handlers
from server.api.state import state_router
from server.calibration.calibration_file import SavedCalibration, calibration_text, parse_calibration
from server.calibration.calibration_life import LocalCalibration, MadeAt
from server.jobs.calibration_store import CalibrationStore
from server.jobs.cell import Cell
from server.jobs.engine import JobEngine
from server.jobs.knowledge import Knowledge
from server.jobs.service import JobService
from server.settings import ServerSettings

Q = np.deg2rad([10.0, 42.0, -85.0, 4.0, -43.0, 3.0])


def calibration(machine_id):
    return LocalCalibration(
        machine_id=machine_id,
        method="chords",
        R_tcp_cam=MACHINE.T_tcp_cam_left[:3, :3],
        covariance=np.diag(np.deg2rad([0.2, 0.5, 0.1])) ** 2,
        p_tcp_cam_m=MACHINE.T_tcp_cam_left[:3, 3],
        from_nominal_deg=0.0,
        time_offset_s=-0.06,
        residual_rms_mm=0.8,
        residual_max_mm=2.0,
        n_used=61,
        path_length_m=1.0,
        observability=0.2,
        made_at=MadeAt(time.time() - 600.0, Q, tcp_pose(chain_of(MACHINE), Q)),
    )


def served(path, **changed):
    """A service whose disk holds a calibration."""
    cell = Cell(ServerSettings(), MACHINE, chain_of(MACHINE), "", StandInLink(), StandInVision(), StandInRecorder())
    engine = JobEngine(StandInPerformer(cell.link))
    machine_id = JobService(cell, engine).context.machine_id
    path.write_text(calibration_text(SavedCalibration(replace(calibration(machine_id), **changed))))
    return JobService(cell, engine, CalibrationStore(path))


def client_of(service):
    api = FastAPI()
    install_problem_handlers(api)
    for router in (state_router, jobs_router, calibration_router):
        api.include_router(router(service))
    transport = httpx.ASGITransport(app=api)
    return httpx.AsyncClient(transport=transport, base_url="http://test", headers=control(service))


async def test_a_kept_calibration_is_shown_after_a_restart(tmp_path):
    async with client_of(served(tmp_path / "calibration.json")) as client:
        view = (await client.get("/v1/calibration")).json()
        assert view["valid"]
        assert view["age_s"] == pytest.approx(600.0, abs=30.0)
        assert view["sigma_deg"] == pytest.approx(0.5, abs=1e-6)
        assert (view["radius_mm"], view["age_max_h"]) == (1000.0, 12.0)
        assert (await client.get("/v1/state")).json()["calibration"]["observability_text"] == view["observability_text"]


async def test_it_expires_on_the_page_when_the_machine_moves_away(tmp_path):
    service = served(tmp_path / "calibration.json")
    away = Q + np.deg2rad([0.0, 0.0, 61.0, 0.0, 0.0, 0.0])
    service.cell.link.latest = type("Sample", (), {"q_rad": tuple(away), "oil_temperature_c": 0.0})()
    async with client_of(service) as client:
        view = (await client.get("/v1/calibration")).json()
    assert not view["valid"]
    assert "calibrate" in view["expiry_reason"]
    assert view["distance_mm"] > 500.0


async def test_exports_are_files_of_their_kind(tmp_path):
    async with client_of(served(tmp_path / "calibration.json")) as client:
        assert yaml.safe_load((await client.get("/v1/calibration/export")).text)["n_used"] == 61
        ros = await client.get("/v1/calibration/export?format=ros")
        assert "static_transform_publisher" in ros.text
        again = parse_calibration((await client.get("/v1/calibration/export?format=json")).text)
        assert again.calibration.n_used == 61
        assert (await client.get("/v1/calibration/export?format=xml")).status_code == 422


@pytest.mark.parametrize(
    ("changed", "word"), [({"machine_id": "another"}, "another machine"), ({"slip": "marker slipped"}, "slipped")]
)
async def test_what_was_not_taken_up_is_said(tmp_path, changed, word):
    async with client_of(served(tmp_path / "calibration.json", **changed)) as client:
        answer = await client.get("/v1/calibration")
        assert answer.status_code == 404
        assert word in answer.json()["detail"]
        assert word in (await client.get("/v1/state")).json()["calibration_note"]


async def test_without_any_it_says_what_to_do(tmp_path):
    service = served(tmp_path / "calibration.json")
    service.cell.knowledge = Knowledge()
    async with client_of(service) as client:
        assert "run the job 'calibrate'" in (await client.get("/v1/calibration/export")).json()["detail"]


async def test_the_closed_loop_is_off_until_switched_on(tmp_path):
    service = served(tmp_path / "calibration.json")
    ended = asyncio.Event()
    service.engine.on_event(lambda job, event: ended.set() if job.has_ended else None)
    async with client_of(service) as client:
        started = (await client.post("/v1/jobs", json={"kind": "servo"})).json()
        await asyncio.wait_for(ended.wait(), 10.0)
        job = (await client.get(f"/v1/jobs/{started['job_id']}")).json()
    assert (job["state"], job["code"]) == ("failed", "closed_loop_off")
    assert "closed_loop = true" in job["reason"]


def test_the_command_reads_a_file_and_names_what_is_wrong(tmp_path):
    file = tmp_path / "calibration.json"
    served(file)
    shown = CliRunner().invoke(app, ["calibration", "show", "--file", str(file)])
    assert shown.exit_code == 0, shown.output
    assert "0.50 deg" in shown.output
    exported = CliRunner().invoke(app, ["calibration", "export", "--file", str(file), "--format", "ros"])
    assert yaml.safe_load(exported.output)["transforms"][0]["child_frame_id"] == "cam_left"
    out = tmp_path / "mount.yaml"
    assert CliRunner().invoke(app, ["calibration", "export", "--file", str(file), "--out", str(out)]).exit_code == 0
    assert yaml.safe_load(out.read_text())["T_tcp_cam_left"]["translation_m"]
    file.write_text("{")
    assert CliRunner().invoke(app, ["calibration", "show", "--file", str(file)]).exit_code == 2
    assert CliRunner().invoke(app, ["calibration", "export", "--format", "xml"]).exit_code == 2
