"""One case after another, each in processes of its own: generate, diagnose, judge. Saved; a second run resumes."""

import json
import queue
import shutil
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.diagnosis.case_code import CASES, ROOT
from benchmarks.diagnosis.gap.packed import Packed, PackedError, read_packed, write_packed
from benchmarks.diagnosis.gap.warm import Warm, with_path
from longreach.diagnose_fleet_command import code_mark
from recording.spawn import SINGLE_THREAD_ENVIRONMENT

PLANTS = ("own", "foreign")
GENERATE = "benchmarks.diagnosis.sealed.generate"
STAGES = {  # module -> what it imports beforehand
    GENERATE: GENERATE,
    "longreach.cli": "longreach.diagnose_command",
    "benchmarks.diagnosis.sealed.judge": "benchmarks.diagnosis.sealed.judge",
}
UNDISTURBED = 36  # recordings: three to fit, the others to judge; fifteen do not tell a wander from chance
CASE_S = 3600.0  # a process that takes longer is stopped, and its case is run again next time
BAD_INPUT = 2  # exit code of a recording that the tool will not judge: a refusal, not a crash


class CampaignError(Exception):
    """The benchmark cannot be run here: no baseline could be made."""


@dataclass(frozen=True, slots=True)
class Campaign:
    """What is asked for. `factor`: a fixed size over the detection limit; None: drawn from 0.5 to 8."""

    plant: str
    seed: int
    folder: Path
    factor: float | None = None

    @property
    def place(self) -> Path:
        """Where this campaign's cases lie."""
        size = f"-{self.factor:g}x" if self.factor is not None else ""
        return self.folder / f"{self.plant}-{self.seed}{size}"

    @property
    def packed(self) -> Path:
        """Its scores in one file, here or brought from another computer."""
        return self.place.with_name(f"{self.place.name}.jsonl.gz")

    @property
    def machine(self) -> Path:
        """The plant's machine file with its baseline: one a plant."""
        return self.folder / f"{self.plant}.toml"

    @property
    def limits(self) -> Path:
        """The scorer's detection limits: one table a plant."""
        return self.folder / f"{self.plant}-limits.json"


@dataclass(frozen=True, slots=True)
class Ended:
    """How a process ended: its exit code (None: stopped for its time) and its words."""

    code: int | None
    text: str


def run_campaign(
    asked: Campaign, numbers: range, advance: Callable[[str], None] = lambda _text: None, workers: int = 1
) -> int:
    """Run the cases that are not on file yet, `workers` at a time; how many could not be judged.

    Raises: CampaignError: cases made by other code, packed scores that cannot be read, or no baseline or table of
            limits could be made.
    """
    packed = _packed(asked)
    _mark(asked, packed.code)
    numbers_left = [number for number in numbers if number not in packed.scores]
    if not asked.machine.is_file():
        advance("fitting the baseline")
        _fit(asked)
    if not asked.limits.is_file():
        advance("the scorer's detection limits")
        _limits(asked)
    with ExitStack() as stack, ThreadPoolExecutor(workers) as pool:  # each waits for processes of its own
        free: queue.SimpleQueue[Hands] = queue.SimpleQueue()
        for _ in range(min(workers, len(numbers_left))):
            free.put({name: stack.enter_context(Warm(name, first, ROOT)) for name, first in STAGES.items()})
        for number in packed.scores.keys() & set(numbers):
            advance(f"case {number}")
        ended = [pool.submit(_case_once, asked, number, free) for number in numbers_left]
        for number, one in zip(numbers_left, ended, strict=True):
            one.result()
            advance(f"case {number}")
    return sum(not one.result() for one in ended)


def _mark(asked: Campaign, packed: str | None) -> None:
    """Write down which code makes these cases, or refuse to mix them with other ones."""
    file, mark = asked.place / "code.txt", code_mark(ROOT, CASES)
    made_by = {file.read_text(encoding="utf-8").strip() if file.is_file() else mark, packed or mark}
    if made_by != {mark}:
        raise CampaignError(
            f"{asked.place}: its cases were made by other code than this; rates of two versions mean nothing together. "
            "Delete the folder, or give another --folder; --show lists what is there"
        )
    asked.place.mkdir(parents=True, exist_ok=True)
    file.write_text(mark + "\n", encoding="utf-8")


Hands = dict[str, Warm]  # a process for each stage of a case


def _case_once(asked: Campaign, number: int, free: "queue.SimpleQueue[Hands]") -> bool:
    folder = asked.place / f"case{number:05d}"
    if (folder / "score.json").is_file():
        return True
    hands = free.get()
    try:
        return _case(asked, number, folder, hands)
    finally:
        free.put(hands)


def _fit(asked: Campaign) -> None:
    """The plant's baseline, from undisturbed recordings, by the command that a person would use."""
    folder = asked.folder / f"{asked.plant}-undisturbed"
    made = ["--undisturbed", str(UNDISTURBED), "--out", str(folder), "--plant", asked.plant]
    _run(["-m", GENERATE, *made], folder)
    recordings = [str(folder / f"undisturbed{k}") for k in range(UNDISTURBED)]
    fitting = ["-m", "longreach.cli", "diagnose", *recordings, "--fit-baseline", "--out", str(asked.machine)]
    ended = _run(fitting, folder)
    if not asked.machine.is_file():
        raise CampaignError(f"no baseline could be made; see {folder / 'log.txt'}")
    (folder / "baseline.txt").write_text(ended.text, encoding="utf-8")


def _limits(asked: Campaign) -> None:
    folder = asked.folder / f"{asked.plant}-undisturbed"
    table = ["--machine", str(asked.machine), "--out", str(asked.limits), "--plant", asked.plant]
    _run(["-m", "benchmarks.diagnosis.sealed.limits", *table], folder)
    if not asked.limits.is_file():
        raise CampaignError(f"no table of limits could be made; see {folder / 'log.txt'}")


def _case(asked: Campaign, number: int, folder: Path, hands: Hands) -> bool:
    """One case from its truth to its score; False where a process crashed or was stopped."""
    folder.mkdir(parents=True, exist_ok=True)
    machine = ["--machine", str(asked.machine), "--plant", asked.plant]
    case = ["--case", str(number), "--seed", str(asked.seed), "--out", str(folder), "--limits", str(asked.limits)]
    size = ["--factor", str(asked.factor)] if asked.factor is not None else []
    if _stage(hands, GENERATE, [*case, *machine, *size], folder).code != 0:
        return False
    left_out = (folder / "lacking.txt").read_text(encoding="utf-8").strip()  # no secret: the tool has to do without it
    how = ["--without", left_out] if left_out else []
    answer = folder / "answer.json"
    told = _stage(
        hands, "longreach.cli", ["diagnose", str(folder / "recording"), "--json", str(answer), *how], folder
    )  # fmt: skip
    if told.code == BAD_INPUT:
        answer.write_text(json.dumps({"refused_to_read": told.text[-2000:]}), encoding="utf-8")
    elif told.code != 0:
        return False
    judged = _stage(hands, "benchmarks.diagnosis.sealed.judge", ["--folder", str(folder), *machine], folder)
    if judged.code == 0:
        for file in (folder / "recording").glob("*.csv"):
            file.unlink()  # the generator makes it again from its numbers
    return judged.code == 0


def _stage(hands: Hands, module: str, arguments: list[str], folder: Path) -> Ended:
    """One stage of a case in a process of its own; its words also go to the case's log."""
    words = folder / "words.txt"
    words.unlink(missing_ok=True)
    code = hands[module].run(arguments, words, CASE_S)
    text = words.read_text(encoding="utf-8", errors="replace") if words.is_file() else ""
    words.unlink(missing_ok=True)
    return _logged(folder, ["-m", module, *arguments], Ended(code, text))


def _run(arguments: list[str], folder: Path) -> Ended:
    """A process of its own, politely, however long it takes; its words also go to the folder's log."""
    folder.mkdir(parents=True, exist_ok=True)
    environment = {**with_path(ROOT), **SINGLE_THREAD_ENVIRONMENT}
    command = [*(["nice", "-n", "19"] if shutil.which("nice") else []), sys.executable, "-P", *arguments]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    return _logged(folder, arguments, Ended(done.returncode, done.stdout + done.stderr))


def _logged(folder: Path, arguments: list[str], ended: Ended) -> Ended:
    with (folder / "log.txt").open("a", encoding="utf-8") as log:
        log.write(f"$ {' '.join(arguments)}\n{ended.text}\nexit {ended.code}\n")
    return ended


def _packed(asked: Campaign) -> Packed:
    try:
        return read_packed(asked.packed)
    except PackedError as error:
        raise CampaignError(str(error)) from error


def scores(asked: Campaign, numbers: range) -> list[dict[str, Any]]:
    """What the judge wrote, of the cases that have been run here or were brought packed.

    Raises: CampaignError: the packed ones cannot be read.
    """
    found, packed = [], _packed(asked).scores
    for number in numbers:
        folder = asked.place / f"case{number:05d}"
        if (folder / "score.json").is_file():
            found.append(json.loads((folder / "score.json").read_text(encoding="utf-8")))
        elif number in packed:
            found.append(packed[number])
    return found


def pack(asked: Campaign, numbers: range) -> Path:
    """Everything on file as one file, which a run of the same code elsewhere goes on from; where it is.

    Raises: CampaignError: nothing is on file, or what is there cannot be read.
    """
    done, file = scores(asked, numbers), asked.place / "code.txt"
    code = file.read_text(encoding="utf-8").strip() if file.is_file() else _packed(asked).code
    if not done or code is None:
        raise CampaignError(f"{asked.place}: no judged case is on file; run the campaign first")
    write_packed(asked.packed, code, done)
    return asked.packed
