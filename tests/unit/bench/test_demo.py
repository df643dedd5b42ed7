"""`longreach demo` waits as long as it takes, tells why, and gives up at once where something has ended."""

import os
import sys
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console
from rich.status import Status
from typer.testing import CliRunner

from longreach import demo
from longreach.cli import app
from longreach.fleet_client import JobClient, JobRefusedError
from server.api.state import camera_reason


class Started:
    """A stack that is started by nothing."""

    url = "http://127.0.0.1:1"
    ended: int | None = None

    def __init__(self, *_: Any, **__: Any) -> None:
        self.processes: dict[str, Any] = {"sim": SimpleNamespace(poll=lambda: self.ended, returncode=self.ended)}

    def __enter__(self) -> "Started":
        return self

    def __exit__(self, *_: object) -> None:
        pass


def test_what_has_ended_will_never_be_ready_and_is_told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "Stack", type("Ended", (Started,), {"ended": 3}))
    done = CliRunner().invoke(app, ["demo", "--no-browser"])
    assert done.exit_code == 1
    assert "not started: sim ended with code 3; see runs/realistic-1/logs" in " ".join(done.output.split())


def test_while_it_waits_it_says_for_what() -> None:
    status = Status("starting", console=Console(quiet=True))
    with JobClient(Started.url) as client, pytest.raises(JobRefusedError, match="not ready after 1 s"):
        client.wait_ready(
            1.0, lambda waited_s, why: demo._show_startup_status(Started().processes, status, waited_s, why)
        )
    assert "the server is not up yet" in str(status.status)


def test_nobody_is_sent_to_look_for_a_cable_while_a_simulated_camera_is_compiled() -> None:
    status = Status("starting", console=Console(quiet=True))
    demo._show_startup_status(Started().processes, status, 40.0, camera_reason(None) or "")
    assert str(status.status) == "starting, 40 s: no image from the simulated camera yet"


def test_each_stage_of_the_start_is_told_once_when_it_has_ended() -> None:
    console = Console(record=True, width=120, quiet=False)
    stages = demo.Stages(console, "http://127.0.0.1:1")
    for waited_s, why in (
        (0.2, "server does not answer (refused)"),
        (3.0, "the server is starting: it loads its numerics; the PLC does not answer; camera: process is starting"),
        (3.5, "server does not answer (timed out)"),
        (4.0, "camera: vision process is starting"),
        (4.2, "the PLC does not answer"),
    ):
        assert stages.report_progress(waited_s, why) == why
    told = [line.split("s  ")[1] for line in console.export_text().splitlines()]
    assert told == [
        "the panel answers: http://127.0.0.1:1/",
        "the numerics are loaded",
        "pictures arrive",
    ]


@pytest.mark.parametrize(
    ("started", "called"),
    [
        ("/opt/x/longreach/__main__.py", f"{os.path.relpath(sys.executable)} -m longreach"),
        (".venv/bin/longreach", None),
    ],
)
def test_the_command_that_it_names_can_be_entered_as_it_is(
    monkeypatch: pytest.MonkeyPatch, started: str, called: str | None
) -> None:
    monkeypatch.setattr(demo.shutil, "which", lambda _name: None)
    monkeypatch.setattr(sys, "argv", [started])
    assert demo._longreach_command() == (called or started)
