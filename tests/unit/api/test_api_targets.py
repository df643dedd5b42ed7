"""A target over REST: measured without control, used and cleared with it only, never while a job runs."""

import numpy as np
import pytest
from served import bench

from server.camera.contracts import MarksFound
from server.errors import BusyError
from server.jobs.targets import TargetChoice
from server.targets.contracts import AnchoredTarget, Landmarks, PatchStatus, SurfacePatch, refused_patch
from server.targets.round_marks import RoundMark

CLICK = {"image": 7, "u_px": 640.0, "v_px": 250.0}


def target(number: int) -> AnchoredTarget:
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[2, 3] = 1.0
    none = np.zeros((0, 2))
    patch = SurfacePatch(
        PatchStatus.OK, "", (640.0, 250.0), T, 1e-6 * np.eye(6), none, np.zeros((0, 3)), 0.06, "plane", 60, 0.03
    )
    marks = Landmarks(none, none, np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 2, 3)))
    image = np.zeros((720, 1280), np.uint8)
    return AnchoredTarget(number, patch, T, 1e-6 * np.eye(6), 1e-3, image, image, marks, marks)


@pytest.fixture
def stand(open_bench):
    vision = open_bench.service.cell.vision
    vision.answers, vision.used, vision.asked = [target(1)], [], []

    async def measure_target(image, pixel, roll_rad):
        vision.asked.append((image, pixel, roll_rad))
        return vision.answers.pop(0)

    vision.measure_target, vision.use_target = measure_target, vision.used.append
    return open_bench


async def test_a_target_is_measured_used_and_cleared(stand):
    knowledge = stand.service.cell.knowledge
    async with stand.client() as client:
        patch = (await client.post("/v1/target/measure", json=CLICK | {"roll_deg": 90.0})).json()
        assert (patch["status"], patch["target_id"], patch["image"]) == ("ok", 1, 7)
        assert len(patch["axes_px"]) == 4
        assert stand.service.cell.vision.asked == [(7, (640.0, 250.0), pytest.approx(np.pi / 2.0))]
        assert stand.service.cell.vision.used == []  # measured only
        knowledge.last_look = object()
        used = await client.post("/v1/target", json={"target_id": 1}, headers=stand.control())
        assert used.status_code == 200, used.text
        assert used.json()["target"]["target_id"] == 1
        assert knowledge.target.target_id == 1
        assert knowledge.last_look is None  # it saw another object
        stand.service.engine.leases.expel("test")
        cleared = await client.request("DELETE", "/v1/target", headers=stand.control())
        assert cleared.json()["target"] is None
        assert knowledge.target is None
        assert [one and one.target_id for one in stand.service.cell.vision.used] == [1, None]


async def test_a_mark_is_found_and_chosen_by_its_number(stand):
    refusal = refused_patch(PatchStatus.TOO_FAR, "come nearer", (100.0, 90.0))
    found = [(RoundMark(1, target(5).patch, 0.0507, 0.0004, 0.051, True), target(5))]
    found.append((RoundMark(2, refusal, 0.064, 0.001, 0.064, True), refusal))
    asked = []

    async def find_marks(image, diameters_m):
        asked.append((image, diameters_m))
        return MarksFound(5, tuple(found), "")

    stand.service.cell.vision.find_marks = find_marks
    held = stand.control()
    async with stand.client() as client:
        answer = await client.post("/v1/target/marks", json={"image": 7, "diameters_mm": [51.0, 64.0]})
        marks = answer.json()["marks"]
        assert asked == [(7, (pytest.approx(0.051), pytest.approx(0.064)))]
        assert [(one["number"], one["patch"]["target_id"], one["patch"]["status"]) for one in marks] == [
            (1, 5, "ok"),
            (2, 0, "too_far"),
        ]
        assert (await client.post("/v1/target", json={"target_id": 6}, headers=held)).status_code == 409
        used = await client.post("/v1/target", json={"target_id": 5}, headers=held)
        assert used.json()["target"]["target_id"] == 5
        job = {"kind": "pattern", "target_ids": [5, 6]}
        refused = await client.post("/v1/jobs", json=job, headers=held)
        assert (refused.status_code, refused.json()["code"]) == (409, "no_such_target")


async def test_without_control_nothing_is_used(stand):
    async with stand.client() as client:
        await client.post("/v1/target/measure", json=CLICK)
        assert (await client.post("/v1/target", json={"target_id": 1})).status_code == 403
        assert (await client.request("DELETE", "/v1/target")).status_code == 403
    assert stand.service.cell.vision.used == []


async def test_a_refused_patch_or_an_older_candidate_cannot_be_used(stand):
    refusal = refused_patch(PatchStatus.TOO_FAR, "Patch at (640, 250) px: come nearer", (640.0, 250.0))
    stand.service.cell.vision.answers = [target(1), refusal]
    held = stand.control()
    async with stand.client() as client:
        await client.post("/v1/target/measure", json=CLICK)
        refused = (await client.post("/v1/target/measure", json=CLICK)).json()
        assert (refused["status"], refused["reason"]) == ("too_far", refusal.reason)
        answer = await client.post("/v1/target", json={"target_id": 1}, headers=held)
        assert (answer.status_code, answer.json()["code"]) == (409, "no_such_target")
    assert stand.service.cell.vision.used == []


async def test_while_a_job_runs_the_target_stays(stand):
    job = type("Running", (), {"ended": False, "job_id": "1", "kind": "look", "owner": "x", "state": PatchStatus.OK})
    engine = type("Engine", (), {"current": job})
    choice = TargetChoice(stand.service.cell.vision, stand.service.cell.knowledge, engine)
    choice.candidate = target(1)
    for act in (lambda: choice.accept(1), choice.clear):
        with pytest.raises(BusyError):
            act()
    assert stand.service.cell.vision.used == []


async def test_a_viewer_may_not_measure(tmp_path):
    keyed = bench(tmp_path, keyed=True)
    async with keyed.client("viewer") as viewer:
        assert (await viewer.post("/v1/target/measure", json=CLICK)).status_code == 403

    keyed.keeper.database.close()
