"""Tables 2, 3 and 4 of Makinen et al. 2023 as printed, with the defects we found, and what Figures 5 to 9 show.

Errors are absolute values by the paper's own camera, in camera axes; e_Z of Table 4 contains the stand-off of 100 mm.
"""

from dataclasses import dataclass

RADIUS_MM = 200.0
CIRCLE_POINTS = 18
STAND_OFF_MM = 100.0
TOLERANCE_MM = 5.0
MEASUREMENTS = 10


@dataclass(frozen=True, slots=True)
class LineRow:
    """A row of Table 2: rotation errors after the orientation step [deg], position errors after the one move [mm]."""

    measurement: int
    rotation_deg: tuple[float, float, float]
    position_mm: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class MatchingRow:
    """A row of Table 4: position errors after the first and after the second control input [mm]."""

    measurement: int
    first_mm: tuple[float, float, float]
    second_mm: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class PointSetErrors:
    """Table 3: errors between matched odometry and encoder TCP along one path, Cartesian axes [mm]."""

    mean_mm: tuple[float, float, float]
    maximum_mm: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Defect:
    """Something in the printed tables that cannot be as it stands."""

    where: str
    what: str


@dataclass(frozen=True, slots=True)
class Figure:
    """What a figure shows, and the numbers that the text gives with it (name, value, unit)."""

    number: int
    title: str
    shows: str
    numbers: tuple[tuple[str, float, str], ...]


TABLE_2: tuple[LineRow, ...] = (
    LineRow(1, (1.40, 2.75, 14.25), (27, 21, 404)),
    LineRow(2, (0.71, 0.94, 3.11), (37, 66, 334)),
    LineRow(3, (0.72, 1.33, 5.91), (45, 42, 321)),
    LineRow(4, (2.40, 1.52, 8.59), (4, 28, 387)),
    LineRow(5, (2.03, 2.21, 11.59), (4, 11, 342)),
    LineRow(6, (2.83, 1.50, 9.18), (12, 23, 611)),
    LineRow(7, (0.77, 1.83, 1.82), (3, 2, 338)),
    LineRow(8, (1.28, 1.25, 3.50), (27, 29, 303)),
    LineRow(10, (1.74, 1.08, 2.07), (36, 37, 424)),
)
TABLE_2_MEAN = LineRow(0, (1.58, 1.57, 6.64), (24, 29, 338))

TABLE_3 = PointSetErrors(mean_mm=(3.7, 1.8, 14.2), maximum_mm=(21.9, 25.4, 58.2))

TABLE_4: tuple[MatchingRow, ...] = (
    MatchingRow(1, (8.1, 19.3, 95.4), (5.9, 1.9, 89.4)),
    MatchingRow(2, (11.4, 30.4, 67.3), (2.9, 3.0, 112.7)),
    MatchingRow(3, (6.4, 29.4, 110.1), (5.1, 0.8, 83.8)),
    MatchingRow(4, (4.1, 35.2, 91.8), (5.7, 1.1, 105.9)),
    MatchingRow(5, (0.4, 27.6, 91.5), (3.6, 0.7, 93.9)),
    MatchingRow(6, (5.9, 26.2, 111.0), (2.8, 0.9, 79.8)),
    MatchingRow(7, (11.3, 22.3, 91.8), (0.5, 0.2, 79.0)),
    MatchingRow(8, (6.0, 25.6, 110.9), (1.0, 0.8, 97.6)),
    MatchingRow(9, (17.1, 30.8, 103.9), (0.6, 0.8, 97.6)),
    MatchingRow(10, (5.6, 26.8, 85.5), (4.9, 1.5, 89.2)),
)
TABLE_4_MEAN = MatchingRow(0, (7.6, 27.4, 95.9), (3.3, 1.2, 92.3))

DEFECTS: tuple[Defect, ...] = (
    Defect("Table 2", "measurement 9 is missing: nine rows, means of ten"),
    Defect(
        "Table 2, means of rotation, e_X and e_Y",
        "they are those of ten rows when the missing one is about (1.92, 1.29, 6.38) deg, 45 mm, 31 mm",
    ),
    Defect(
        "Table 2, mean of e_Z",
        "338 mm fits no positive tenth value (the nine rows average 385 mm); it repeats the e_Z of measurement 7",
    ),
    Defect("Table 4, second input, mean of e_Z", "92.3 mm is printed, the ten rows average 92.9 mm"),
    Defect("Table 4, second input, measurements 8 and 9", "e_Y and e_Z repeat exactly (0.8, 97.6): perhaps one copied"),
)

FIGURES: tuple[Figure, ...] = (
    Figure(
        5,
        "Orientation errors before and after the orientation adjustment",
        "Euler XYZ angles between tool marker and OOI over time; one control input; two of three errors go close to "
        "zero, the third does not; samples at exactly zero are failed detections",
        (("control input at", 5.6, "s"),),
    ),
    Figure(
        6,
        "Circular path and the line-equation move",
        "reference (black) and driven path (red) in base axes: a circle that is not quite planar, then a straight line "
        "to the computed reference",
        (("radius", 200.0, "mm"), ("points", 18.0, ""), ("control inputs", 1.0, "")),
    ),
    Figure(
        7,
        "Position errors during the line-equation move",
        "image-based X, Y and Z errors over time; X and Y fall to a few centimetres, the depth is not corrected",
        (),
    ),
    Figure(
        8,
        "Trajectory matching",
        "reference path (green), encoder-based TCP (black) and odometry after the match (red) in base axes; Table 3 "
        "belongs to it",
        (("mean error Z", 14.2, "mm"), ("maximum error Z", 58.2, "mm")),
    ),
    Figure(
        9,
        "Position errors during the trajectory-matching moves",
        "image-based X, Y and Z errors over time; two control inputs; X and Y below 1 cm after the second, Z at "
        "the stand-off of about 100 mm",
        (("first control input at", 8.0, "s"), ("second control input at", 45.0, "s")),
    ),
)


def tool_distances_mm() -> tuple[float, ...]:
    """Depth between tool and OOI in the paper's own runs: e_Z of Table 2, which its method leaves as it was [mm]."""
    return tuple(row.position_mm[2] for row in TABLE_2)
