"""A cell of three candidates whose residual is known in closed form."""

import numpy as np

from diagnosis.search.candidates import candidates_of_effects
from diagnosis.search.cell import Cell, ResidualRows, blocks_of, folds_of
from machine.effects.layout import ParameterSets, neutral_sets, slots_of

GAIN, ASYMMETRY, LAG = (slots_of(name, 1)[0] for name in ("flow_gain_error", "valve_asymmetry", "valve_lag"))
N = 600
T = np.arange(N) * 0.05
COLUMNS = np.stack([np.sin(1.3 * T), np.maximum(np.sin(1.3 * T), 0.0) + 0.3 * np.cos(3.1 * T), np.cos(1.3 * T)])


def made_up(truth: tuple[float, float, float], seed: int = 4, noise: float = 1.0) -> Cell:
    """Residual: noise + sum of (truth - size) columns, 40 noise levels per unit."""
    rng = np.random.default_rng(seed)
    base_noise = rng.normal(0.0, noise, N)

    def whitened(sets: ParameterSets) -> np.ndarray:
        sizes = np.stack([sets.joint_parameters[:, 0, slot.column] for slot in (GAIN, ASYMMETRY, LAG)], axis=1)
        return base_noise + (np.array(truth) - sizes) @ (40.0 * COLUMNS)

    block, _ = blocks_of([N // 2, N // 2])
    fold, same = folds_of(["steps", "workcycle"], [N // 2, N // 2], block)
    assert not same
    zero = np.zeros(N, np.int64)
    return Cell(
        stage="actuator",
        joint=1,
        unit="rad/s",
        candidates=candidates_of_effects(("flow_gain_error", "valve_asymmetry", "valve_lag"), (1,)),
        baseline_parameters=neutral_sets(1),
        whitened=whitened,
        rows=ResidualRows(fold, block, zero, zero),
        scale=np.ones(N),
        quiet=1.0,
        floor_known=True,
        regressors=(("command", np.sin(1.9 * T)),),
        t_s=T,
    )
