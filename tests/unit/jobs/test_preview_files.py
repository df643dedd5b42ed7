"""docs/architecture.md lists the files between a look and a path; a trace of one preview holds it to that."""

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import pytest

from benchmarks.positioning.machines.saved import Order, run_one
from server.jobs.plans import assurance, moving

ROOT = Path(moving.__file__).parents[3]
PATH_PACKAGES = ("server/jobs/plans/moving.py", "server/jobs/plans/planning.py", "server/motion/")


@contextmanager
def _traced(files: set[str]) -> Iterator[None]:
    """Collects the files of the project whose functions are called meanwhile."""

    def note(frame: FrameType, event: str, argument: object) -> None:
        file = frame.f_code.co_filename
        if event == "call" and file.startswith(f"{ROOT}/") and "site-packages" not in file:
            files.add(Path(file).relative_to(ROOT).as_posix())

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        yield
    finally:
        sys.setprofile(before)


def test_the_files_of_a_preview_are_those_of_the_document(monkeypatch: pytest.MonkeyPatch) -> None:
    traced: list[set[str]] = []
    preview = moving.preview

    def watched(*given: object) -> object:
        files: set[str] = set()
        with _traced(files):
            previewed = preview(*given)
        traced.append(files)
        return previewed

    for module in (moving, assurance, sys.modules["benchmarks.positioning.machines.machine_run"]):
        monkeypatch.setattr(module, "preview", watched)
    run = run_one(Order("realistic"), 3)
    assert run.state == "done"
    assert traced
    server = {file for file in traced[0] if file.startswith("server/")}

    text = (ROOT / "docs/architecture.md").read_text()
    section = text.split("### Files from a look to a path")[1].split("\n## ")[0]
    listed = set(re.findall(r"`(server/[\w/]+\.py)`", section))
    assert listed == server
    assert len([file for file in server if file.startswith(PATH_PACKAGES)]) <= 12
