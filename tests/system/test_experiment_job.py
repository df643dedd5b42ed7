"""The loop closed on the real simulated stack: a diagnosis proposes, the server drives it, both recordings decide."""

import time
from importlib.resources import files

import httpx
import pytest

from longreach.fleet_client import JobClient, JobRefusedError
from longreach.processes import Stack, StackPorts
from recording.folder import write_folder
from recording.opening import read_run
from recording.rows import MarkerCorners

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(1200)]
READY_S = 180.0
DIAGNOSED_S = 400.0
SLOW_LIFT = '\n[[effect]]\nname = "flow_gain_error"\njoint = 2\nparameters = { gain_frac = -0.2 }\n'


def diagnosed(http, diagnosis_id):
    """The answer of a diagnosis, when it is done."""
    deadline = time.monotonic() + DIAGNOSED_S
    while time.monotonic() < deadline:
        one = http.get(f"/v1/diagnoses/{diagnosis_id}").json()
        if one["state"] not in ("waiting", "running"):
            break
        time.sleep(0.5)
    assert one["state"] == "done", one
    return one, http.get(f"/v1/diagnoses/{diagnosis_id}/result").json()


def without_camera(runs):
    """The only recording as a folder without marker corners: then gain and encoder scale look alike."""
    (path,) = runs.glob("*.mcap")
    read = read_run(path)
    rows = tuple(row for row in read.rows if not isinstance(row, MarkerCorners))
    write_folder(type(read)(read.form, read.run, read.machine_toml, rows), runs / "first")
    return "first"


def told_alike(answer):
    """Every name that the recording cannot tell from another one."""
    return {(one["name"], one["joint"]) for members in answer["indistinguishable"] for one in members}


def test_a_proposed_experiment_is_planned_driven_and_diagnosed_with_the_first(tmp_path):
    nominal = (files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8")
    machine = tmp_path / "slow_lift.toml"
    machine.write_text(nominal + SLOW_LIFT, encoding="utf-8")
    runs = tmp_path / "runs"
    stack = Stack(
        StackPorts.free(),
        preset="ideal",
        seed=3,
        camera_rate_hz=5.0,
        runs=runs,
        log_folder=tmp_path / "logs",
        sim_options=("--machine", str(machine)),
    )
    with stack, JobClient(stack.url) as client, httpx.Client(base_url=stack.url, timeout=20.0) as http:
        client.wait_ready(READY_S)
        assert client.run({"kind": "park", "wall_free": True}).state == "done"
        first, answer = diagnosed(
            http, http.post("/v1/diagnoses", json={"path": without_camera(runs)}).json()["diagnosis_id"]
        )
        assert answer["next_experiment"]["execute"]["kind"] == "motion"
        assert ("flow_gain_error", 2) in told_alike(answer)
        wanted = {"kind": "plan_experiment", "diagnosis_id": first["diagnosis_id"]}
        blind = client.run(wanted)
        assert (blind.state, "no wall is known" in blind.reason) == ("failed", True)
        plan = client.run(wanted | {"wall_free": True})
        assert plan.state == "done", plan.reason
        assert plan.result["tcp_speed_max_mm_s"] <= 150.0
        named = {"kind": "experiment", "diagnosis_id": first["diagnosis_id"]}
        with pytest.raises(JobRefusedError, match="is not the planned one"):
            client.run(named | {"plan_hash": "0" * 16})
        driven = client.run(named | {"plan_hash": plan.result["plan_hash"]})
        assert driven.state == "done", driven.reason
        both, answer = diagnosed(http, driven.result["followed_by"])
    assert both["recordings"] == answer["recordings"]
    assert answer["recordings"][0] == "first"
    assert driven.result["plan_hash"] == plan.result["plan_hash"]
    (second,) = runs.glob("*-experiment-*.mcap")
    assert answer["recordings"][1] == second.name
    assert both["job_id"] in second.name
    (segment,) = read_run(second).run.segments
    assert segment.name == plan.result["what"]
    assert segment.t_end_plc_s - segment.t_start_plc_s >= 20.0
    best = [(one["name"], one["joint"]) for one in answer["hypotheses"][0]["effects"]]
    assert ("flow_gain_error", 2) in best
    assert ("flow_gain_error", 2) not in told_alike(answer)
