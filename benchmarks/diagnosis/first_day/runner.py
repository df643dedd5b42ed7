"""One case after another: a plant and the diagnosis in processes of their own; a line of JSON each."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

from benchmarks.diagnosis.case_code import CASES, ROOT
from longreach.diagnose_fleet_command import code_mark
from recording.spawn import SINGLE_THREAD_ENVIRONMENT

PLANT = "benchmarks.diagnosis.sealed.third_plant"
DRAWN = "benchmarks.identify"
REALISTIC = "realistic"  # the fine plant with every number of the preset drawn, driven by `identify`
FIVE_JOBS = "five_jobs"  # of such a machine: what a normal day records, in place of `identify`
CASE_S = 3600.0  # a process that takes longer is stopped, and its case is run again next time
BAD_INPUT = 2  # exit code of a recording that the diagnosis does not take: an answer, not a crash
POORER = ("no_repeats", "one_job", "no_tracker", "camera_only", "static_only")
MIXTURE = (  # 43 % many, 14 % single, 19 % foreign, 10 % healthy, 14 % poorer recordings, in an order that mixes early
    "many", "healthy", "foreign_many", "many", "single", "poorer", "many", "foreign", "many", "single", "many",
    "poorer", "healthy_no_repeats", "many", "foreign_many", "many", "single", "many", "foreign", "poorer", "many",
)  # fmt: skip
KEPT = ("verdict", "why", "budget", "stages", "searched", "missing")  # of an answer, in the file of scored cases
Scored = dict[str, Any]


class FirstDayError(Exception):
    """The benchmark cannot be run here, or a file of scored cases cannot be read."""


@dataclass(frozen=True, slots=True)
class Campaign:
    """What is asked for. `kind`: one of the third plant's, "mixed", or "realistic". `recording`: not the kind's own.

    `shorten`: of the motion's length, for cases that cost less.
    """

    kind: str
    seed: int
    folder: Path
    recording: str | None = None
    shorten: float = 1.0

    @property
    def name(self) -> str:
        """Its name in the folder."""
        shorter = [f"{self.shorten:g}x"] if self.shorten != 1.0 else []
        return "-".join((self.kind, *([self.recording] if self.recording else []), *shorter, str(self.seed)))

    @property
    def scored(self) -> Path:
        """The file with a line for each case that is done."""
        return self.folder / f"{self.name}.jsonl"

    def kind_of(self, number: int) -> str:
        """The third plant's kind of case `number`."""
        kind = MIXTURE[number % len(MIXTURE)] if self.kind == "mixed" else self.kind
        return POORER[number % len(POORER)] if kind == "poorer" else kind


def run_campaign(
    campaign: Campaign, numbers: Sequence[int], advance: Callable[[], None] = lambda: None, workers: int = 1
) -> int:
    """Run the cases that are not on file yet, `workers` at a time; how many could not be diagnosed.

    Raises: FirstDayError: the file of scored cases cannot be read.
    """
    done = {case["number"] for case in read_scored([campaign.scored])} if campaign.scored.is_file() else set[int]()
    mark, lock = code_mark(ROOT, CASES), Lock()

    def one(number: int) -> bool:
        case = None if number in done else _case(campaign, number)
        if case is not None:
            with lock, campaign.scored.open("a", encoding="utf-8") as file:
                file.write(json.dumps({**case, "code": mark}) + "\n")
        advance()
        return number in done or case is not None

    campaign.folder.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(workers) as pool:
        return sum(not ended for ended in pool.map(one, numbers))


def read_scored(files: Sequence[Path]) -> list[Scored]:
    """All cases of these files.

    Raises: FirstDayError: a file cannot be read.
    """
    try:
        return [json.loads(line) for file in files for line in file.read_text(encoding="utf-8").splitlines()]
    except (OSError, ValueError) as error:
        raise FirstDayError(
            f"cannot read the scored cases: {error}; give files that this command has written"
        ) from error


def _case(campaign: Campaign, number: int) -> Scored | None:
    """One case from its truth to its answer; None where a process crashed or was stopped."""
    folder, kind = campaign.folder / campaign.name / f"{number:04d}", campaign.kind_of(number)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    made = _drawn_machine(campaign, number, folder) if kind == REALISTIC else _third_plant(campaign, number, folder)
    if made is None:
        return None
    (given, truth), answer = made, folder / "answer.json"
    began = time.monotonic()
    machine_out = ["--machine-out", str(folder / "identified.toml")] if kind == REALISTIC else []
    parts = sorted(path for path in given.iterdir() if path.is_dir()) or [given]
    code = _run(["-m", "longreach.cli", "diagnose", *map(str, parts), "--json", str(answer), *machine_out], folder)
    if code not in (0, BAD_INPUT):
        return None
    seconds = time.monotonic() - began
    said = json.loads(answer.read_text(encoding="utf-8")) if code == 0 else {"verdict": "refused"}
    for file in given.rglob("*.csv"):
        file.unlink()  # the third plant makes it again from its numbers
    return {
        "kind": kind,
        "recording": campaign.recording,
        "shorten": campaign.shorten,
        "seed": campaign.seed,
        "number": number,
        "seconds": round(seconds, 1),
        "truth": truth,
        "answer": {key: said[key] for key in KEPT if key in said},
    }


def _third_plant(campaign: Campaign, number: int, folder: Path) -> tuple[Path, Scored] | None:
    """A case of the third plant: its recording and its truth, whose hash is sealed in the recording."""
    drawn = ["--n", "1", "--first", str(number), "--seed", str(campaign.seed), "--kind", campaign.kind_of(number)]
    drawn += ["--shorten", str(campaign.shorten)]
    recording = ["--recording", campaign.recording] if campaign.recording else []
    if _run(["-m", PLANT, str(folder), *drawn, *recording], folder) != 0:
        return None
    given = folder / f"case_{number:03d}"
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))[given.name]
    seal = json.loads((given / "seal.json").read_text(encoding="utf-8"))["sha256"]
    if seal != hashlib.sha256(json.dumps(truth, sort_keys=True).encode()).hexdigest():
        raise FirstDayError(f"{folder}: the truth does not fit its seal; delete the folder and run the case again")
    return given, truth


def _drawn_machine(campaign: Campaign, number: int, folder: Path) -> tuple[Path, Scored] | None:
    """A machine of preset `realistic`, driven in virtual time; what its truth says, in the third plant's form."""
    seed = 1000 * campaign.seed + number
    jobs = ["--jobs", "5"] if campaign.recording == FIVE_JOBS else []
    if _run(["-m", DRAWN, str(folder), "--seed", str(seed), *jobs], folder) != 0:
        return None
    own = folder / f"seed{seed}"
    return own / "recording", json.loads((own / "truth.json").read_text(encoding="utf-8"))


def _run(arguments: list[str], folder: Path) -> int | None:
    """A process of its own, politely; its words go to the case's log. None where it was stopped for its time."""
    command = [*(["nice", "-n", "15"] if shutil.which("nice") else []), sys.executable, *arguments]
    with (folder / "log.txt").open("a", encoding="utf-8") as log:
        log.write(f"$ {' '.join(arguments)}\n")
        log.flush()
        try:
            done = subprocess.run(
                command,
                cwd=ROOT,
                env={**os.environ, **SINGLE_THREAD_ENVIRONMENT},
                stdout=log,
                stderr=subprocess.STDOUT,
                timeout=CASE_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return None
    return done.returncode
