"""`longreach bench compensation`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import cv2
import typer
from rich.console import Console
from rich.table import Table

from benchmarks.positioning.compensation.run import VARIANTS, Compared, compare
from benchmarks.positioning.machines.paired import paired_change
from benchmarks.reproduce.noise_model import fitted_noise
from benchmarks.reproduce.summary import share
from benchmarks.same_options import require_same_options, text_mark
from benchmarks.saved_lines import open_to_add, whole_lines
from server.settings import read_machine, read_machine_text

console = Console(width=150)


def compensation(
    n: Annotated[int, typer.Option(help="machines")] = 200,
    seed: Annotated[int, typer.Option(help="first seed")] = 1,
    machine: Annotated[str, typer.Option(help="machine file, or the name of a shipped one")] = "hiab033",
    folder: Annotated[Path, typer.Option(help="where every machine is saved; a second run resumes")] = Path(
        "runs/bench-compensation"
    ),
) -> None:
    """Diagnosed effects compensated against not, paired on drawn machines in the fast world."""
    cv2.setNumThreads(1)
    noise, nominal, text = fitted_noise(), read_machine(machine), read_machine_text(machine)
    require_same_options(folder, machine=text_mark(text))
    file = folder / "compared.jsonl"
    found = {one.seed: one for one in whole_lines(file, Compared.of_line)}
    wanted = range(seed, seed + n)
    with open_to_add(file) as out:
        for number in wanted:
            if number in found:
                continue
            one = compare(nominal, text, noise, number)
            if one is None:
                console.print(f"seed {number}: no usable scene; not counted")
                continue
            found[number] = one
            out.write(one.to_line() + "\n")
            out.flush()
            console.print(_line(one))
    tell([found[number] for number in wanted if number in found])


def _line(one: Compared) -> str:
    ends = ", ".join(f"{r.variant} {'in' if r.inside else 'out'}" for r in one.reached)
    return f"seed {one.seed}: {one.verdict}, closed {one.closed_frac:.3f}; {ends}"


def tell(runs: Sequence[Compared]) -> None:
    """Success after one move of every variant, and the paired changes."""
    if not runs:
        return
    used = share([one.compensated for one in runs])
    console.print(f"N reached {len(runs)}; compensated {used.k} of {used.n}, the others refused and run as without")
    table = Table(title="one move, true |x| and |y| <= 5 mm", title_justify="left")
    for heading in ("variant", "inside", "95 %", "change", "95 %", "lost : won"):
        table.add_column(heading)
    inside = {name: [bool(r and r.inside) for r in (one.of(name) for one in runs)] for name in VARIANTS}
    for name, values in inside.items():
        got = share(values)
        before = inside[name.split(" + ")[0]]
        change = paired_change(before, values)
        table.add_row(
            name,
            f"{got.k} of {got.n}",
            f"{100 * got.low:.1f} to {100 * got.high:.1f} %",
            f"{100 * change.value:+.1f}",
            f"{100 * change.low:+.1f} to {100 * change.high:+.1f}",
            f"{change.only_default} : {change.only_other}",
        )
    console.print(table)
