"""Lists of tables in a machine file's text: found however TOML lets them be written, and never written as no TOML."""

import tomllib

import pytest

from machine.description import parse_machine_toml
from machine.effects.entries import EffectEntry, entries_to_toml
from machine.errors import MachineFileError
from machine.file_tables import with_room_for_effects, with_tables, without_lists
from server.settings import read_machine_text

TEXT = read_machine_text("hiab033")
BOTH = ("effect", "remainder")
PLAY = '[[effect]]\nname = "backlash"\njoint = 2\nparameters = { width_rad = 0.002 }\n'
NEW = entries_to_toml([EffectEntry("gravity_sag", 2, (("compliance_rad_nm", 1.5e-6),))])


def names(text: str) -> list[str]:
    return [one.name for one in parse_machine_toml(text).effects]


@pytest.mark.parametrize(
    "text",
    [
        TEXT + PLAY,
        TEXT + '[[effect]]\nname = "backlash"\njoint = 2\n[effect.parameters]\nwidth_rad = 0.002\n',
        TEXT + PLAY.replace("[[effect]]", "[[ effect ]]  # usual"),
        TEXT + PLAY.replace("[[effect]]", '[["effect"]]'),
        "effect = [\n  { name = 'backlash', joint = 2, parameters = { width_rad = 0.002 } },\n]\n" + TEXT,
        "\ufeff" + (TEXT + PLAY).replace("\n", "\r\n"),
    ],
)
def test_a_list_is_found_however_it_is_written(text: str) -> None:
    assert names(text.removeprefix("\ufeff")) == ["backlash"]
    bare = without_lists(text, BOTH)
    assert tomllib.loads(bare) == tomllib.loads(TEXT)
    assert bare.count("#") >= TEXT.count("#")
    assert names(with_tables(bare, NEW)) == ["gravity_sag"]
    assert names(with_tables(with_room_for_effects(text).removeprefix("\ufeff"), NEW)) == ["backlash", "gravity_sag"]


@pytest.mark.parametrize("nothing", ["effect = []\n", "effect = [ ] # none\nremainder = []\n"])
def test_a_list_that_is_empty_takes_no_room(nothing: str) -> None:
    assert names(with_tables(without_lists(nothing + TEXT, BOTH), NEW)) == ["gravity_sag"]
    assert names(with_tables(with_room_for_effects(nothing + TEXT), NEW)) == ["gravity_sag"]


def test_the_rows_of_a_list_in_a_list_go_with_it() -> None:
    text = (
        TEXT
        + '[[remainder]]\nstage = "link"\nusual = [\n  ["a", 1.0],\n  ["b"]\n]\n\n[[ remainder ]]\nstage = "camera"\n'
    )
    with pytest.raises(MachineFileError):  # its last row looks like a table of its own
        without_lists(text, BOTH)
    assert tomllib.loads(without_lists(text.replace('["b"]', '["b", 2.0]'), BOTH)) == tomllib.loads(TEXT)


@pytest.mark.parametrize("text", ['notes = """\n[[effect]]\n"""\n' + TEXT, TEXT + "[effect]\n", "no TOML\n" + TEXT])
def test_what_cannot_be_taken_apart_or_added_to_is_refused(text: str) -> None:
    with pytest.raises(MachineFileError, match=r"machine file"):
        with_tables(with_room_for_effects(text), without_lists(text, BOTH) and NEW)
