"""The paper's tables as data: their means are those of the rows, but for the defects that are named."""

import numpy as np
import pytest

from benchmarks.reproduce.paper_tables import (
    DEFECTS,
    FIGURES,
    TABLE_2,
    TABLE_2_MEAN,
    TABLE_3,
    TABLE_4,
    TABLE_4_MEAN,
    tool_distances_mm,
)


def test_table_4s_means_but_one():
    first = np.array([row.first_mm for row in TABLE_4])
    second = np.array([row.second_mm for row in TABLE_4])
    assert len(TABLE_4) == 10
    np.testing.assert_allclose(first.mean(axis=0), TABLE_4_MEAN.first_mm, atol=0.05)
    np.testing.assert_allclose(second.mean(axis=0)[:2], TABLE_4_MEAN.second_mm[:2], atol=0.05)
    assert second.mean(axis=0)[2] - TABLE_4_MEAN.second_mm[2] == pytest.approx(0.6, abs=0.05)  # a named defect
    assert any("92.9" in defect.what for defect in DEFECTS)
    np.testing.assert_allclose(np.abs(first[:, 2] - 100.0).mean(), 11.3, atol=0.05)
    np.testing.assert_allclose(np.abs(second[:, 2] - 100.0).mean(), 10.8, atol=0.05)


def test_table_2_lacks_a_row_that_the_means_still_hold():
    assert [row.measurement for row in TABLE_2] == [1, 2, 3, 4, 5, 6, 7, 8, 10]
    position = np.array([row.position_mm for row in TABLE_2])
    rotation = np.array([row.rotation_deg for row in TABLE_2])
    missing = 10 * np.array(TABLE_2_MEAN.position_mm) - position.sum(axis=0)
    np.testing.assert_allclose(missing[:2], [45.0, 31.0], atol=5.0)
    assert missing[2] < 0.0  # no depth can be negative: the printed mean is wrong
    np.testing.assert_allclose(
        10 * np.array(TABLE_2_MEAN.rotation_deg) - rotation.sum(axis=0), [1.92, 1.29, 6.38], atol=0.05
    )
    assert {defect.where for defect in DEFECTS} >= {"Table 2", "Table 2, mean of e_Z"}


def test_table_3_and_the_figures():
    assert all(mean < maximum for mean, maximum in zip(TABLE_3.mean_mm, TABLE_3.maximum_mm, strict=True))
    assert [figure.number for figure in FIGURES] == [5, 6, 7, 8, 9]
    assert min(tool_distances_mm()) == 303
    assert max(tool_distances_mm()) == 611
