"""`python -m benchmarks.identify.first_move --n 20`: first move by one look and kinematics alone, in the fast world, by
the machine file and by a machine file with effects (the true ones, or FOLDER/seedN/identified.toml).
"""

import argparse
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np

from benchmarks.identify.truth import true_effects
from benchmarks.reproduce.fast_cell import context_of, fast_cell, run_plan
from benchmarks.reproduce.fast_machine import QuasiStaticMachine
from benchmarks.reproduce.noise_model import fitted_noise
from machine.description import parse_machine_toml
from machine.effects.entries import EffectEntry, make_entry
from machine.effects.registry import effect_named
from machine.poses import inverse_pose
from server.compensation.compensation import compensation_of
from server.errors import ServerError
from server.jobs.plans.looking import good_look
from server.jobs.plans.moving import execute, preview
from sim_plc.draw_world import draw_world
from sim_plc.world import World


def missed_mm(world: World, entries: tuple[EffectEntry, ...] | None) -> float:
    """How far the tool ends from its goal after the first move [mm]; infinite where no move was possible."""
    ctx, cell = context_of(world, "ours"), fast_cell(world, QuasiStaticMachine(world), fitted_noise())
    if entries is not None:
        ctx = replace(ctx, compensation=compensation_of(world.nominal, entries))
    try:
        taken = run_plan(good_look(ctx), cell)
        run_plan(execute(ctx, preview(ctx, taken, 0), 1), cell)
    except ServerError:
        return float("inf")
    T_ooi_tool = inverse_pose(world.scene.T_base_ooi) @ cell.machine.T_base_tcp() @ world.scene.T_tcp_tool
    return 1e3 * float(np.linalg.norm(T_ooi_tool[:3, 3] - ctx.T_ooi_goal[:3, 3]))


def true_entries(world: World) -> tuple[EffectEntry, ...]:
    """The drawn machine's own effects, as far as the catalogue has them."""
    out = []
    for line in true_effects(world):
        effect = effect_named(line["name"])
        if effect is None or line["value"] is None:
            continue
        given = dict(line["parameters"])
        vector = given.pop("vector", None)
        if vector is not None and effect.direction is not None:
            given[effect.direction.name] = vector
        out.append(make_entry(effect, line["joint"], given))
    return tuple(out)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.identify.first_move", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--n", type=int, default=20)
    parser.add_argument("--folder", type=Path, help="of identified machines; without it the true effects")
    given = parser.parse_args()
    text = (files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8")
    pairs = []
    for seed in range(given.seed, given.seed + given.n):
        world = draw_world(parse_machine_toml(text), "realistic", seed)
        file = None if given.folder is None else given.folder / f"seed{seed}" / "identified.toml"
        entries = true_entries(world) if file is None else parse_machine_toml(file.read_text(encoding="utf-8")).effects
        pairs.append((missed_mm(world, None), missed_mm(world, entries)))
        print(f"seed {seed}: {pairs[-1][0]:.1f} mm, with effects {pairs[-1][1]:.1f} mm", flush=True)  # output
    inside = [sum(pair[k] <= 5.0 for pair in pairs) for k in (0, 1)]
    print(f"inside 5 mm: {inside[0]} and {inside[1]} of {len(pairs)}")  # output


if __name__ == "__main__":
    main()
