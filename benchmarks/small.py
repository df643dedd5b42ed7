"""The shorter benches: each a few lines about one module."""

import statistics
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from benchmarks.kills import repeated as bench_kills
from benchmarks.link import real_time as bench_link
from benchmarks.positioning import end_to_end as bench_position
from benchmarks.vision.real_pictures import bench_vision_real
from machine.chain import chain_of
from machine.inverse import inverse_all, inverse_nearest
from machine.kinematics import tcp_jacobian, tcp_pose
from server.settings import read_machine

console = Console(width=200)


def position(
    preset: Annotated[str, typer.Option(help="ideal, realistic or paper")] = "realistic",
    method: Annotated[str, typer.Option(help="ours or paper")] = "ours",
    n: Annotated[int, typer.Option(help="how many seeds")] = 20,
    seed: Annotated[int, typer.Option(help="first seed")] = 1,
    folder: Annotated[Path, typer.Option(help="where every case is saved; a second run resumes")] = Path("runs/bench"),
) -> None:
    """Position n seeds end to end and compare image-based with true errors."""
    cases = bench_position.bench(preset, method, n, seed, folder, console)
    console.print(bench_position.summary(cases))
    seconds = [case.duration_s for case in cases if case.steps]
    for moves in (1, 2, 3):
        stood = sum(bench_position.inside_after(case, moves) for case in cases)
        count = sum(bench_position.inside(case, moves) for case in cases)
        console.print(
            f"truly inside 5 mm and 1 deg after move {moves}: {stood} of {len(cases)}; "
            f"job ended there within {moves} moves: {count}"
        )
    if method == "paper":
        count = sum(bench_position.pattern_of_paper(case) for case in cases)
        console.print(f"pattern of the paper's Table 4: {count} of {len(cases)}")
    if seconds:
        console.print(
            f"seconds: median {statistics.median(seconds):.0f}, max {max(seconds):.0f}; N reached {len(cases)}"
        )


def kinematics(
    n: Annotated[int, typer.Option(help="random joint vectors")] = 1000,
    seed: Annotated[int, typer.Option(help="seed")] = 1,
    machine: Annotated[str, typer.Option(help="machine file or name")] = "hiab033",
) -> None:
    """Inverse recovers random joint vectors; microseconds per call."""
    chain = chain_of(read_machine(machine))
    rng = np.random.default_rng(seed)
    qs = rng.uniform(chain.q_min, chain.q_max, (n, chain.n))
    poses = [tcp_pose(chain, q) for q in qs]
    tcp_jacobian(chain, qs[0])
    nearest = [inverse_nearest(chain, T, q) for T, q in zip(poses, qs, strict=True)]
    recovered = sum(
        found.q_rad is not None and np.allclose(found.q_rad, q, atol=1e-7) for found, q in zip(nearest, qs, strict=True)
    )
    worst = max(
        float(np.abs(tcp_pose(chain, branch.q_rad) - T).max()) for T in poses for branch in inverse_all(chain, T)
    )
    console.print(f"inverse recovered {recovered} of {n}; worst branch reproduces its pose to {worst:.1e}")
    for name, call in (
        ("forward", lambda i: tcp_pose(chain, qs[i])),
        ("jacobian", lambda i: tcp_jacobian(chain, qs[i])),
        ("inverse, 8 branches", lambda i: inverse_all(chain, poses[i])),
        ("inverse, nearest", lambda i: inverse_nearest(chain, poses[i], qs[i])),
    ):
        console.print(f"{name:22s} {_micros(call, n):8.1f} us per call")


def _micros(call, n: int) -> float:
    started = time.perf_counter()
    for i in range(n):
        call(i)
    return (time.perf_counter() - started) / n * 1e6


def plant(
    seconds: Annotated[float, typer.Option(help="simulated seconds")] = 20.0,
    preset: Annotated[str, typer.Option(help="which preset")] = "realistic",
    seed: Annotated[int, typer.Option(help="seed")] = 1,
) -> None:
    """Real-time factor of the fine plant on one core."""
    from benchmarks.simulator.plant import bench_plant

    told = bench_plant(seconds, preset, seed)
    console.print(
        f"{told.preset}, seed {told.seed}, {told.simulated_s:g} s simulated: "
        f"{told.real_time_factor:.0f} times real time in a batch, "
        f"{told.real_time_factor_per_ms_calls:.0f} in calls of 1 ms; first call {told.first_call_s:.1f} s"
    )


def render(
    n: Annotated[int, typer.Option(help="stereo pairs")] = 50,
    seed: Annotated[int, typer.Option(help="seed")] = 1,
) -> None:
    """Stereo pairs rendered per second."""
    from benchmarks.simulator.render import bench_render

    told = bench_render(n, seed)
    stages = ", ".join(f"{stage} {spent_ms:g}" for stage, spent_ms in told.ms_per_stage.items())
    console.print(
        f"{told.n_pairs} pairs: {told.pairs_per_s:g} a second, {told.ms_per_pair:g} ms a pair ({stages}); "
        f"built in {told.build_s:g} s"
    )


def vision_real(
    data: Annotated[Path, typer.Option(help="folder with markers/ and stereo/")] = Path("../shared/data"),
) -> None:
    """Detector and odometry on real photographs and the KITTI clip."""
    bench_vision_real(data, console)


def link(
    minutes: Annotated[int, typer.Option(help="how long, beside the vision load")] = 10,
    seed: Annotated[int, typer.Option(help="seed of the simulated machine")] = 1,
    in_server: Annotated[
        bool, typer.Option("--in-server", help="for comparison: the client in the server's own process")
    ] = False,
    folder: Annotated[Path, typer.Option(help="where every minute is saved; a second run resumes")] = Path(
        "runs/bench-link"
    ),
) -> None:
    """Underruns, lateness and buffer depth of the PLC link in real time beside the vision load."""
    plan = bench_link.Plan(minutes=minutes, seed=seed, where="server" if in_server else "process")
    console.print(bench_link.summary([bench_link.bench(plan, folder, console)]))


def kills(
    n: Annotated[int, typer.Option(help="kills of each victim")] = 20,
    seed: Annotated[int, typer.Option(help="first seed")] = 1,
    victims: Annotated[str, typer.Option(help="server, link, plc")] = bench_kills.DEFAULT_VICTIMS,
    folder: Annotated[Path, typer.Option(help="where every case is saved; a second run resumes")] = Path(
        "runs/bench-kills"
    ),
) -> None:
    """SIGKILL in the middle of real jobs: ramp, rest, travel, and that nothing moves again by itself."""
    try:
        chosen = bench_kills.victims_of(victims)
    except bench_kills.UnknownVictimError as error:
        raise typer.BadParameter(str(error)) from error
    console.print(bench_kills.summary(bench_kills.bench(chosen, n, seed, folder, console)))
