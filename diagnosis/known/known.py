"""What is known of a machine's baseline beyond its effects, taken into account before anything is searched."""

from diagnosis.known.form import with_form
from diagnosis.known.wander import with_wander
from diagnosis.log.nominal import Nominal
from diagnosis.search.cell import Cell


def with_known(cells: list[Cell], nominal: Nominal) -> list[Cell]:
    """Cells less the form that their machine's model is wrong by, with what its numbers wander by as noise."""
    return with_wander(with_form(cells, nominal), nominal)
