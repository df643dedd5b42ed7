"""`longreach commission` against a simulated PLC and camera: real processes, real UDP, real pictures."""

import json
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest

from benchmarks.kills.plc_process import PlcProcess
from longreach.processes import StackPorts, free_port
from machine.chain import chain_of
from machine.kinematics import tcp_pose
from server.settings import read_machine, read_machine_text
from sim_plc.process import SimSettings

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]
COMMAND = [sys.executable, "-m", "longreach.cli", "commission", "--yes"]
PASS, FAIL, OPEN = 0, 1, 3
# The file says that the camera hangs upside down, which the simulated one does not.
MOUNTED = "T_tcp_cam_left = [0.0, -1.0, 0.0, 0.18,\n                  -1.0, 0.0, 0.0, 0.06,"
UPSIDE_DOWN = "T_tcp_cam_left = [0.0, 1.0, 0.0, 0.18,\n                  1.0, 0.0, 0.0, -0.06,"


@contextmanager
def simulator(dry_run):
    """A simulated machine in a process of its own; its ports. Seed and start posture are the same every time."""
    ports = StackPorts.free()
    machine_text = read_machine_text("hiab033")
    with PlcProcess(SimSettings(machine_text, plc_port=ports.plc, camera_port=ports.camera, dry_run=dry_run)):
        yield ports


def commission(ports, runs, *options):
    """Exit code, report and what was shown."""
    command = [*COMMAND, "--plc-port", str(ports.plc), "--plc-local-port", str(ports.plc_local), "--runs", str(runs)]
    camera = ["--camera-url", f"http://127.0.0.1:{ports.camera}/stream"]
    done = subprocess.run([*command, *camera, *options], capture_output=True, text=True, timeout=800, check=False)
    reports = sorted(runs.glob("*.json"))
    report = json.loads(reports[-1].read_text()) if reports else None
    shown = " ".join((done.stdout + done.stderr).split())  # long lines are wrapped
    return done.returncode, report, shown


def verdicts(report):
    return {result["name"]: result["verdict"] for result in [*report["earlier"], *report["results"]]}


def result_of(report, name):
    return next(result for result in report["results"] if result["name"] == name)


def figure(result, part):
    return next(each["value"] for each in result["figures"] if part in each["name"])


def wait_for_plc(ports, runs):
    """The simulator's first start compiles; limits are compared as soon as it answers."""
    codes = []
    while PASS not in codes:
        assert len(codes) < 10, "the simulated PLC did not answer"
        codes.append(commission(ports, runs, "--steps", "2")[0])


def test_without_a_plc_nothing_is_told_and_the_server_is_suspected(tmp_path):
    code, report, shown = commission(StackPorts.free(), tmp_path, "--steps", "2")
    assert code == OPEN, shown
    assert verdicts(report) == {"limits equal": "inconclusive"}
    assert "one controller at a time" in shown
    assert next(tmp_path.glob("*.md")).read_text().startswith("# Commissioning of hiab033")


def test_a_taken_port_is_told_before_anything_starts(tmp_path):
    ports = StackPorts.free()
    with socket.socket(type=socket.SOCK_DGRAM) as taken:
        taken.bind(("0.0.0.0", ports.plc_local))
        code, report, shown = commission(ports, tmp_path, "--steps", "2")
    assert code == 2
    assert report is None
    assert "is a server running" in shown


@pytest.mark.slow
def test_dry_run_first_then_the_moving_machine_until_everything_passes(tmp_path):
    with simulator(dry_run=True) as ports:
        wait_for_plc(ports, tmp_path / "wait")
        code, first, shown = commission(ports, tmp_path / "dry", "--move", "--steps", "1,2,3,4,5", "--listen-s", "5")
    assert code == OPEN, shown
    assert verdicts(first) == {
        "link dry run": "pass",
        "limits equal": "pass",
        "encoder zeros": "skipped",
        "joint ranges": "pass",
        "joint signs": "inconclusive",  # in dry run nothing moves
    }, shown
    dry = result_of(first, "link dry run")
    assert figure(dry, "encoders moved") < 0.2
    assert figure(dry, "largest valve command") == 0.0
    assert figure(dry, "reference off its path") < 1e-6
    assert 200.0 < figure(dry, "silence: ramp begins after") <= 270.0
    answers = tmp_path / "answers.toml"
    answers.write_text(answers_for(first))
    with simulator(dry_run=False) as ports:
        wait_for_plc(ports, tmp_path / "wait")
        resume = str(next((tmp_path / "dry").glob("*.json")))
        options = ("--move", "--steps", "2,3,4,5,6,7,8", "--resume", resume, "--answers", str(answers))
        code, report, shown = commission(ports, tmp_path / "runs", *options)
    assert code == PASS, shown
    assert set(verdicts(report).values()) == {"pass"}
    assert report["simulation"]
    assert report["open_answers"] == []
    stops = result_of(report, "stop times")
    assert len(stops["tables"][0]["rows"]) == 6
    assert all(each["value"] <= 80.0 for each in stops["figures"] if "TCP travel" in each["name"])
    assert 200.0 < figure(stops, "100 %, silence: ramp begins after") <= 270.0
    assert figure(stops, "100 %, STOP: ramp begins after") <= 100.0


def answers_for(report):
    """What an engineer would read and see at this machine: the encoders as they are, the tool by its geometry."""
    rows = result_of(report, "encoder zeros")["tables"][0]["rows"]
    q_deg = {name: float(encoder) for name, encoder, _ in rows}
    zeros = "\n".join(f"{name} = {value}" for name, value in q_deg.items())
    machine = read_machine("hiab033")
    q = np.deg2rad(list(q_deg.values()))
    signs = "\n".join(f'{name} = "{seen_by_hand(machine, q, i)}"' for i, name in enumerate(q_deg))
    return f"[encoder_zeros]\n{zeros}\n[joint_signs]\n{signs}\n"


def seen_by_hand(machine, q, joint):
    """The largest component of the tip's motion for a positive step; the last joint turns the tool about its line."""
    if joint == len(q) - 1:
        return "cw"
    after = q.copy()
    after[joint] += 0.01
    chain = chain_of(machine)
    start, step = tcp_pose(chain, q)[:3, 3], tcp_pose(chain, after)[:3, 3] - tcp_pose(chain, q)[:3, 3]
    heading = np.arctan2(start[1], start[0])
    out = step[0] * np.cos(heading) + step[1] * np.sin(heading)
    left = -step[0] * np.sin(heading) + step[1] * np.cos(heading)
    words = {"out": out, "in": -out, "left": left, "right": -left, "up": step[2], "down": -step[2]}
    return max(words, key=lambda word: words[word])


@pytest.mark.slow
def test_a_wrong_mounting_and_other_limits_are_found(tmp_path):
    text = read_machine_text("hiab033")
    assert MOUNTED in text
    upside_down, limits = tmp_path / "upside_down.toml", tmp_path / "limits.toml"
    upside_down.write_text(text.replace(MOUNTED, UPSIDE_DOWN))
    limits.write_text(text.replace("qd_max_deg_s = 15.0", "qd_max_deg_s = 16.0"))
    with simulator(dry_run=False) as ports:
        wait_for_plc(ports, tmp_path / "wait")
        options = ("--move", "--steps", "6,7", "--machine", str(upside_down))
        code, report, shown = commission(ports, tmp_path / "camera", *options)
        assert code == FAIL, shown
        assert "upside down" in result_of(report, "camera axes")["summary"]
        assert result_of(report, "tool marker")["verdict"] == "fail"
        options = ("--move", "--steps", "2,5", "--machine", str(limits))
        code, report, shown = commission(ports, tmp_path / "limits", *options)
        assert code == FAIL, shown
        assert verdicts(report) == {"limits equal": "fail", "joint signs": "inconclusive"}
        assert "16 deg" in result_of(report, "limits equal")["tables"][0]["rows"][1][3]


@pytest.mark.slow
def test_a_silent_camera_leaves_its_steps_open_and_the_rest_goes_on(tmp_path):
    with simulator(dry_run=False) as ports:
        wait_for_plc(ports, tmp_path / "wait")
        nowhere = StackPorts(ports.http, ports.plc, ports.plc_local, free_port())
        code, report, shown = commission(nowhere, tmp_path / "runs", "--move", "--steps", "2,4,6,7")
    assert code == OPEN, shown
    assert verdicts(report) == {
        "limits equal": "pass",
        "joint ranges": "pass",
        "camera axes": "inconclusive",
        "tool marker": "inconclusive",
    }


@pytest.mark.slow
def test_without_leave_nothing_moves(tmp_path):
    with simulator(dry_run=False) as ports:
        wait_for_plc(ports, tmp_path / "wait")
        code, report, shown = commission(ports, tmp_path / "runs", "--steps", "5,8")
    assert code == OPEN, shown
    assert verdicts(report) == {"joint signs": "skipped", "stop times": "skipped"}


@pytest.mark.slow
def test_ctrl_c_stops_the_machine_and_keeps_what_was_found(tmp_path):
    with simulator(dry_run=False) as ports:
        wait_for_plc(ports, tmp_path / "wait")
        ours = ["--plc-port", str(ports.plc), "--plc-local-port", str(ports.plc_local)]
        command = [*COMMAND, *ours, "--runs", str(tmp_path / "runs"), "--move", "--steps", "2,5"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as process:
            assert process.stdout is not None
            assert any("slew will now be jogged" in line for line in process.stdout)
            time.sleep(2.5)  # so that it moves
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=30)
        code, _, shown = commission(ports, tmp_path / "after", "--steps", "2")  # the PLC is free again
    assert process.returncode == 130
    (report,) = [json.loads(path.read_text()) for path in (tmp_path / "runs").glob("*.json")]
    assert verdicts(report) == {"limits equal": "pass"}
    assert not report["complete"]
    assert code == PASS, shown
