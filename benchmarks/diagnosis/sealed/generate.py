"""`python -m benchmarks.diagnosis.sealed.generate --case K --seed S --machine FILE --limits FILE --out DIR`: a case.

DIR/recording is what the tool gets (with the baseline's machine file and the truth's hash), DIR/sealed/truth.json is
for the scorer alone. `--undisturbed N` writes N recordings without any fault, to fit a baseline on.
"""

import argparse
import hashlib
import json
from dataclasses import asdict
from pathlib import Path

from benchmarks.diagnosis.sealed import nominal_own as own
from benchmarks.diagnosis.sealed.cases import Case, draw, recording_seed
from benchmarks.diagnosis.sealed.faults import faults_of
from benchmarks.diagnosis.sealed.limits import Table
from benchmarks.diagnosis.sealed.plants import NAMES, OWN, Plant, plant_named
from benchmarks.diagnosis.sealed.recorded import NOISES, make, write

UNDISTURBED_SEED = 900_000  # no case's seed
IN_LOG = ("dropped_samples", "swapped_joints")


def sealed(case: Case) -> str:
    """The truth as text."""
    return json.dumps(asdict(case), indent=1)


def write_case(
    number: int, seed: int, machine: str, limits: Table, out: Path, factor: float | None = None, plant: Plant = OWN
) -> Case:
    """Make and write one case; the truth goes into a folder of its own."""
    case = draw(number, seed, limits, factor)
    injected = tuple(one.effect for one in case.effects)
    own_seed = recording_seed(number, seed)
    made = make(faults_of(injected, own.N), NOISES[case.noise], own_seed, plant)
    spoil = next((one.name for one in injected if one.name in IN_LOG), "")
    write(made, out / "recording", f"case {seed}-{number}", machine, spoil, own_seed)
    truth = sealed(case)
    digest = hashlib.sha256(truth.encode()).hexdigest()
    (out / "recording" / "seal.json").write_text(json.dumps({"sha256": digest}), encoding="utf-8")
    (out / "sealed").mkdir(exist_ok=True)
    (out / "sealed" / "truth.json").write_text(truth, encoding="utf-8")
    (out / "lacking.txt").write_text(case.lacking, encoding="utf-8")
    return case


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--case", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--machine", type=Path, help="the plant's machine file with its baseline")
    parser.add_argument("--limits", type=Path, help="the table by benchmarks.diagnosis.sealed.limits")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--factor", type=float, help="size over the detection limit, for all effects of the case")
    parser.add_argument("--undisturbed", type=int, default=0)
    parser.add_argument("--plant", choices=NAMES, default="own")
    given = parser.parse_args()
    plant = plant_named(given.plant)
    for k in range(given.undisturbed):
        noise = NOISES[k % len(NOISES)]  # the machine as it is met, on quiet days and on others
        made = make(faults_of((), own.N), noise, UNDISTURBED_SEED + k, plant)
        write(made, given.out / f"undisturbed{k}", f"undisturbed {k}", plant.toml())
    if not given.undisturbed:
        text = given.machine.read_text(encoding="utf-8")
        limits = json.loads(given.limits.read_text(encoding="utf-8"))
        write_case(given.case, given.seed, text, limits, given.out, given.factor, plant)


if __name__ == "__main__":
    main()
