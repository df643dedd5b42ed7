"""`longreach compile`: done once for these sources, this compiler and this processor, and then complete."""

import inspect
import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from longreach import compile_command
from longreach.cli import COMPILED_CODE_MARK_FILE, NUMBA_CACHE_ENV_VARIABLE, app
from server.camera.contracts import StereoFrame, VisionSettings
from server.camera.process import build_pipeline, made_up_pairs
from server.camera.sources.settings import HttpSource
from server.camera.sources.side_by_side import decode_side_by_side
from server.settings import read_machine

ROOT = Path(__file__).parents[3]
#: Compiled when a baseline is first fitted or used, in a process of its own; when a scene has holes.
LATER = ("diagnosis/known/courses.py", "diagnosis/noise/floor.py", "sim_plc/camera/round_marks.py")


def kernels_of(file: Path) -> list:
    """The compiled functions that a source file defines."""
    from importlib import import_module

    from numba.core.registry import CPUDispatcher

    module = import_module(".".join(file.relative_to(ROOT).with_suffix("").parts))
    return [
        value
        for value in vars(module).values()
        if isinstance(value, CPUDispatcher)
        and value.py_func.__module__ == module.__name__
        and value.targetoptions.get("inline") != "always"  # compiled within its callers
    ]


MISSING = f"""
import json
from longreach.compile_command import kernel_files
from pathlib import Path
ROOT = Path.cwd()
{inspect.getsource(kernels_of)}
print(json.dumps([
    f"{{file.relative_to(Path.cwd())}}:{{kernel.py_func.__name__}}"
    for file in kernel_files() for kernel in kernels_of(file) if not kernel._cache._cache_file._load_index()
]))
"""


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(NUMBA_CACHE_ENV_VARIABLE, str(tmp_path))
    return tmp_path


def test_what_is_compiled_of_other_sources_another_processor_or_not_at_all_is_not_taken(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not compile_command.is_compiled()
    (cache / COMPILED_CODE_MARK_FILE).write_text("not json")
    assert not compile_command.is_compiled()
    (cache / COMPILED_CODE_MARK_FILE).write_text(json.dumps({"key": compile_command.source_key()}))
    assert compile_command.is_compiled()
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    assert not compile_command.is_compiled()
    monkeypatch.delenv("NUMBA_CPU_NAME")
    files = compile_command.kernel_files()
    assert ROOT / "machine" / "kinematics.py" in files
    (changed := cache / "kinematics.py").write_bytes(files[0].read_bytes() + b"\n")
    monkeypatch.setattr(compile_command, "kernel_files", lambda: [changed, *files[1:]])
    assert not compile_command.is_compiled()


def test_an_index_that_cannot_be_loaded_is_cleared_by_its_name(cache: Path) -> None:
    """An older version's index that named a type which is gone ended every command, `compile` too."""
    stale, foreign = cache / "vision_1" / "pose_refinement.f-9.py311.nbi", cache / "else_1" / "module.f-9.py311.nbi"
    for file in (stale, foreign):
        file.parent.mkdir()
        file.write_bytes(b"cserver.vision.pose_refinement\nGone\n.")
    compile_command.clear("")
    assert not stale.exists()
    assert foreign.exists()


def test_a_second_call_compiles_nothing_and_a_check_answers_by_its_exit_code(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[str] = []
    monkeypatch.setattr(compile_command, "_run_stages", lambda machine, _report: ran.append(machine))
    codes = [CliRunner().invoke(app, ["compile", *more]).exit_code for more in (["--check"], [], [], ["--check"])]
    assert codes == [1, 0, 0, 0]
    assert ran == ["hiab033"]
    assert CliRunner().invoke(app, ["compile", "--again"]).exit_code == 0
    assert ran == ["hiab033"] * 2


@pytest.mark.slow
def test_after_it_no_process_of_the_system_compiles(cache: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    for arguments in (["-m", "longreach.cli", "compile"], ["-c", MISSING]):
        done = subprocess.run(
            [sys.executable, "-P", *arguments],
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
    missing = [place for place in json.loads(done.stdout) if not place.startswith(LATER)]
    assert missing == []


def test_the_first_picture_of_a_live_camera_compiles_nothing() -> None:
    """The warm-up sees pictures as each source delivers them: of the same memory layout, decoded from the same type."""
    machine = read_machine("hiab033")
    pipeline = build_pipeline(VisionSettings(HttpSource("http://127.0.0.1/")), machine)
    kernels = [k for file in compile_command.kernel_files() if "server" in file.parts for k in kernels_of(file)]
    before = {kernel.py_func.__name__: len(kernel.signatures) for kernel in kernels}
    for number, pair in enumerate(made_up_pairs(machine)):
        jpeg = cv2.imencode(".jpg", np.hstack(pair))[1].tobytes()
        for left, right in (decode_side_by_side(jpeg), pair):
            t_ns = (number + 1) * 200_000_000
            pipeline.process(StereoFrame(left, right, t_ns, t_ns, number), 0)
    pipeline.close()
    assert {kernel.py_func.__name__: len(kernel.signatures) for kernel in kernels} == before
