"""The ChArUco boards of a machine in one pair: their corners as sightings, or why there are none."""

from collections.abc import Mapping

from machine.boards import board_marker_ids
from machine.description import Board, Machine
from server.vision.charuco import board_sighting, why_no_corner
from server.vision.contracts import Array, Image
from server.vision.detection import EyeDetection
from server.vision.object_pose import ObjectName, PointSighting
from server.vision.warm_up import warm_up_boards

Decoded = tuple[Mapping[int, Array], Mapping[int, Array]]


class BoardFinder:
    """Knows the boards of tool and OOI; holds nothing from pair to pair."""

    def __init__(self, machine: Machine) -> None:
        self._camera = machine.camera
        self._boards: dict[ObjectName, tuple[Board, ...]] = {
            "tool": _charuco(machine.boards_on("tool")),
            "ooi": _charuco(machine.boards_on("ooi")),
        }
        self.marker_ids = frozenset(
            one for boards in self._boards.values() for board in boards for one in board_marker_ids(board)
        )
        if self.marker_ids:
            warm_up_boards()

    def decoded(self, found: tuple[EyeDetection, EyeDetection]) -> Decoded:
        """The boards' own markers in each eye, wherever they were read once."""
        repeated = found[0].repeated_ids | found[1].repeated_ids
        left, right = (
            {
                one: corners
                for one, corners in {**eye.covered, **eye.markers}.items()
                if one in self.marker_ids and one not in repeated
            }
            for eye in found
        )
        return left, right

    def sightings(self, eyes: tuple[Image, Image], decoded: Decoded) -> dict[ObjectName, tuple[PointSighting, ...]]:
        """Corners of the boards of each object that at least one eye shows."""
        return {
            name: tuple(
                seen for board in boards if (seen := board_sighting(board, eyes, decoded, self._camera)) is not None
            )
            for name, boards in self._boards.items()
        }

    def why_unseen(self, name: ObjectName, decoded: Decoded) -> list[str]:
        """Why an object's boards give no corner."""
        reasons = (why_no_corner(board, {**decoded[0], **decoded[1]}) for board in self._boards[name])
        return [reason for reason in reasons if reason]


def _charuco(boards: tuple[Board, ...]) -> tuple[Board, ...]:
    return tuple(board for board in boards if board.kind == "charuco")
