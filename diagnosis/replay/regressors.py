"""What a remainder of the dynamic stages may go with: commands, motion, time, other joints."""

import numpy as np

from diagnosis.log.tables import filled
from diagnosis.noise.floor import BLOCK_S, block_means
from diagnosis.replay.stage_replay import Part
from machine.rotations import Array

MOVES_RAD = 1e-4  # within a block


def regressors_of(
    parts: tuple[Part, ...], joints: list[int], order: int, skipped: int, rows_of: list[int]
) -> tuple[tuple[tuple[str, Array], ...], Array]:
    """What a remainder may go with, at the residuals' rows."""
    by_name: dict[str, list[Array]] = {}
    times: list[Array] = []
    for part, rows in zip(parts, rows_of, strict=True):
        one, dt = part.stretch, part.stretch.dt_s
        position = one.enc if one.enc is not None else one.ref
        q = block_means(filled(position) if position is not None else part.measured, dt)
        u = block_means(filled(one.u), dt) if one.u is not None else np.zeros_like(q)
        t = one.t_s[0] + max(BLOCK_S, dt) * np.arange(len(q))
        skip = 1 + order + skipped
        for j in joints:
            moves = MOVES_RAD if one.enc_step is None else max(MOVES_RAD, float(one.enc_step[j]))
            for name, values in _signals(q, u, t - one.t_s[0], j, moves).items():
                by_name.setdefault(name, []).append(values[skip : skip + rows])
            times.append(t[skip : skip + rows])
    return tuple((name, np.concatenate(values)) for name, values in by_name.items()), np.concatenate(times)


def _signals(q: Array, u: Array, t: Array, j: int, moves: float) -> dict[str, Array]:
    """`moves`: change within a block [rad] from which a joint moves: a step of its encoder is in the residual, too."""
    v, du = np.gradient(q[:, j]), np.gradient(u[:, j])
    others = np.delete(np.abs(u), j, axis=1).sum(axis=1)
    way = np.sign(np.where(np.abs(v) > moves, v, 0.0))
    turning = np.abs(np.gradient(way))
    return {
        "command": u[:, j],
        "size of the command": np.abs(u[:, j]),
        "change of the command": du,
        "fast change of the command": du * np.abs(du),
        "cube of the command": u[:, j] ** 3,
        "sign of motion": way,
        "reversals": turning * np.sign(np.gradient(v)),
        "position": q[:, j],
        "speed times position": v * (q[:, j] - q[:, j].mean()),
        "time": t,
        "speed times time": v * (t - t.mean()),
        "other joints' commands": others,
        "speed times other joints' commands": v * (others - others.mean()),
    }
