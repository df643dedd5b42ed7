"""What a name gains is evidence for its own stage, whichever instrument saw it."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from diagnosis.verdict.cell_answer import CellAnswer
from diagnosis.verdict.stage_evidence import nats_by_stage


class TwoParts:
    """A tracker's two rows, then a camera's three."""

    def by_part(self, values: Any) -> Any:
        """Each part with its own rows of values (5,)."""
        return (SimpleNamespace(stage="structure"), values[:2]), (SimpleNamespace(stage="camera"), values[2:])


def answer(*named: str) -> CellAnswer:
    """Names of these stages take 0.5 x (8 - 2) nats from the tracker's rows and 0.5 x (27 - 3) from the camera's."""
    none = np.array([2.0, 2.0, 3.0, 3.0, 3.0])
    fit = SimpleNamespace(hypothesis=tuple(SimpleNamespace(stage=stage) for stage in named))
    search = SimpleNamespace(cell=TwoParts(), none=SimpleNamespace(held_out=none))
    made: Any = SimpleNamespace(search=search, chosen=SimpleNamespace(fit=fit, held_out=np.ones(5)), fired=())
    return cast(CellAnswer, made)


def test_what_a_camera_sees_of_an_arms_fault_counts_for_the_arm() -> None:
    assert nats_by_stage((answer("structure"),)) == {"structure": 15.0, "camera": 0.0}
    assert nats_by_stage((answer("camera"),)) == {"structure": 0.0, "camera": 15.0}


def test_names_of_two_stages_count_where_they_were_seen() -> None:
    assert nats_by_stage((answer("structure", "camera"),)) == {"structure": 3.0, "camera": 12.0}


def test_a_joints_encoder_counts_where_it_was_seen_since_its_stage_has_no_rows() -> None:
    assert nats_by_stage((answer("joint"),)) == {"structure": 3.0, "camera": 12.0}


def test_nothing_named_gains_nothing() -> None:
    assert nats_by_stage((answer(),)) == {"structure": 0.0, "camera": 0.0}
