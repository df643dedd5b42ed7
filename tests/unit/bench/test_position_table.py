"""What `longreach position` ends with can be read in a terminal of eighty columns."""

from io import StringIO

from rich.console import Console

from longreach.position import error_table


def test_no_number_is_cut_in_eighty_columns() -> None:
    axes = {"x_mm": -117.24, "y_mm": -22.6, "z_mm": 520.5, "sigma_x_mm": 10.5, "sigma_y_mm": 0.5, "sigma_z_mm": 1.5}
    error = {**axes, "rotation_deg": 8.26, "sigma_rotation_deg": 0.05}
    moves = [
        {"kind": "orientation", "after": error, "length_mm": 101.0, "duration_s": 13.8, "trims": 1},
        {"kind": "move", "number": 1, "after": error, "length_mm": 1576.0, "duration_s": 17.2, "trims": 0},
    ]
    console = Console(width=80, file=StringIO())
    console.print(error_table({"start": error, "moves": moves}))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert "…" not in text
    assert text.count("-117.2 ± 10.5") == 3
    assert "1576" in text
