"""A fresh installation: versions, templates, folders with the names of our packages, systems without POSIX."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from longreach.cli import app
from longreach.settings_command import settings_template
from server.settings import ServerSettings, read_machine
from server.version import library_versions

ROOT = Path(__file__).parents[2]
PACKAGES = ("diagnosis", "machine", "protocol", "recording", "server", "sim_plc", "web")
#: Modules and names that Windows or macOS do not have, and libraries that `diagnose` must do without.
WITHOUT = """
import os, signal, sys
for name in ("fcntl", "resource", "termios", "pwd", "grp", "cv2", "fastapi", "uvicorn", "viser", "httpx", "websockets"):
    sys.modules[name] = None
for module, names in ((os, ("sched_getaffinity", "register_at_fork", "getuid", "fork", "nice", "wait4", "chown")),
                      (signal, ("SIGHUP", "SIGKILL", "SIGUSR1"))):
    for name in names:
        if hasattr(module, name):
            delattr(module, name)
os.O_DIRECTORY = None
from longreach.cli import main
sys.argv = ["longreach", *sys.argv[1:]]
main()
"""


def run(arguments: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {"PATH": "/usr/bin:/bin", "PYTHONPATH": str(ROOT), "HOME": str(folder), "COLUMNS": "200"}
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def test_a_working_folder_with_our_packages_names_does_no_harm(tmp_path: Path) -> None:
    for name in PACKAGES:
        (tmp_path / f"{name}.py").write_text('raise SystemExit("the working folder is in the way")', encoding="utf-8")
    told = run(["-m", "longreach", "--version"], tmp_path)
    assert told.stdout.startswith("longreach "), told.stderr
    told = run(["-m", "longreach", "serve", "--help"], tmp_path)
    assert told.returncode == 0, told.stderr


def test_the_diagnosis_runs_without_posix_and_without_web_and_vision(tmp_path: Path) -> None:
    rows = "".join(f"{0.01 * k:.2f},0.{k % 10}\n" for k in range(200))
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "plc.csv").write_text(f"t_plc_s,q_1_rad\n{rows}", encoding="utf-8")
    told = run(["-c", WITHOUT, "diagnose", "run"], tmp_path)
    assert told.returncode == 2, told.stderr
    assert "there is no machine.toml" in told.stderr
    assert "Traceback" not in told.stderr
    told = run(["-c", WITHOUT, "recording", "check", "run"], tmp_path)
    assert told.returncode == 0, told.stderr
    told = run(["-c", WITHOUT, "camera", "check"], tmp_path)
    assert told.returncode == 2, told.stderr
    assert "pip install 'longreach[server]'" in told.stderr


def test_templates_can_be_used_as_they_are(tmp_path: Path) -> None:
    file = tmp_path / "machine.toml"
    assert CliRunner().invoke(app, ["machine", "new", str(file)]).exit_code == 0
    assert read_machine(str(file)).name == "hiab033"
    assert CliRunner().invoke(app, ["machine", "new", str(file)]).exit_code == 2  # never over a file
    file = tmp_path / "settings.toml"
    assert CliRunner().invoke(app, ["settings", "new", str(file)]).exit_code == 0
    assert tomllib.loads(file.read_text(encoding="utf-8")) == {}


@pytest.mark.parametrize("section", ["http", "plc", "recording"])
def test_what_the_settings_template_shows_is_the_default(section: str) -> None:
    lines = settings_template().splitlines()
    start = lines.index(f"# [{section}]")
    shown: list[str] = []
    for line in lines[start:]:
        if not line:
            break
        bare = line.removeprefix("# ")
        if not bare.split("#")[0].strip().endswith("="):
            shown.append(bare)
    given = tomllib.loads("\n".join(shown))
    assert ServerSettings.model_validate(given) == ServerSettings()


def test_a_recording_says_which_libraries_computed_it() -> None:
    versions = dict(library_versions())
    assert set(versions) == {"numpy", "scipy", "numba", "opencv-contrib-python-headless"}
    assert all(version[0].isdigit() for version in versions.values()), versions
