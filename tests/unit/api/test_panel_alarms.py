"""The alarm list: latched, acknowledged, never a reason to move; and its pages."""

from dataclasses import replace
from pathlib import Path

import pytest

from protocol.codes import FaultBit
from server.api.panel_alarm_catalogue import CATALOGUE, index_markdown, page_markdown
from server.api.panel_alarms import FAULT_CODES, AlarmBook, Surroundings, active_alarms, unknown_alarms
from server.inner_faults import KEYS_UNREADABLE_FAULT_ID, SERVER_PART_FAILED_FAULT_ID

DOCS = Path(__file__).parents[3] / "docs"
CALM = Surroundings(10**12, "", "", "", 0.0, 0.0, 1e4)


class Part:
    def __init__(self, **values):
        self.__dict__.update(values)


def state(phase="armed", age_ms=5.0, bits=0, camera_age_ms=50.0, warnings=(), calibration=None, simulation=True):
    link = Part(phase=phase, age_ms=age_ms, fault_bits=bits, warning="", simulation=simulation)
    return Part(link=link, camera=Part(age_ms=camera_age_ms, warnings=list(warnings)), calibration=calibration)


def test_all_is_well():
    assert active_alarms(state(), CALM) == {}


@pytest.mark.parametrize("bit", list(FaultBit))
def test_every_fault_bit_of_the_plc_has_an_alarm(bit):
    (code,) = active_alarms(state("fault", bits=int(bit)), CALM)
    assert code in CATALOGUE
    assert CATALOGUE[code].level == "high"


def test_every_code_that_can_be_raised_is_in_the_catalogue():
    raised = {
        *active_alarms(state("offline", age_ms=900.0, camera_age_ms=2000.0), CALM),
        *active_alarms(state(warnings=["frozen"]), replace(CALM, unfit_for_s=1.0)),
        *active_alarms(state(), replace(CALM, vision_problem="vision process ended", scene_problem="gone")),
        *active_alarms(state(), replace(CALM, disk_free_bytes=10**6, recorder_problem="full", loss_pct=7.0)),
        *active_alarms(state(simulation=False), CALM),
        *active_alarms(state(), replace(CALM, store_problem="no space left on device", other_pc="another PC holds it")),
        *active_alarms(state(calibration=Part(valid=False, expiry_reason="too old")), CALM),
        *active_alarms(
            state(), replace(CALM, inner_faults={KEYS_UNREADABLE_FAULT_ID: "x", SERVER_PART_FAILED_FAULT_ID: "x"})
        ),
        *(code for _, code in FAULT_CODES),
    }
    assert raised | {"job_failed", "hold_lost"} == set(CATALOGUE)


def test_what_was_never_heard_is_no_alarm_while_everything_starts():
    silent = state("offline", age_ms=None, camera_age_ms=None)
    assert active_alarms(silent, replace(CALM, up_s=10.0)) == {}
    assert set(active_alarms(silent, replace(CALM, up_s=200.0))) == {"plc_silent", "camera_silent"}


def test_one_bad_picture_is_no_alarm():
    assert active_alarms(state(warnings=["blurred"]), replace(CALM, unfit_for_s=0.1)) == {}


def test_an_alarm_stays_until_it_is_acknowledged():
    book = AlarmBook()
    book.update({"plc_silent": "x"}, 10.0)
    book.update({}, 20.0)
    (alarm,) = book.alarms
    assert (alarm.since_unix_s, alarm.ended_unix_s) == (10.0, 20.0)
    assert book.acknowledge("plc_silent", "anna")
    assert book.alarms == ()


def test_an_acknowledged_alarm_stays_while_its_cause_does():
    book = AlarmBook()
    book.update({"plc_silent": "x"}, 10.0)
    book.acknowledge("plc_silent", "anna")
    book.update({"plc_silent": "x"}, 11.0)
    assert [alarm.acknowledged_by for alarm in book.alarms] == ["anna"]
    book.update({}, 12.0)
    assert book.alarms == ()


def test_what_comes_back_must_be_acknowledged_anew():
    book = AlarmBook()
    for t_s, active in ((1.0, {"plc_silent": ""}), (2.0, {}), (3.0, {"plc_silent": ""})):
        book.update(active, t_s)
    (alarm,) = book.alarms
    assert (alarm.since_unix_s, alarm.ended_unix_s, alarm.acknowledged_by) == (3.0, None, "")


def test_an_unknown_alarm_cannot_be_acknowledged():
    assert not AlarmBook().acknowledge("nothing", "anna")


def test_the_gravest_unacknowledged_one_comes_first():
    book = AlarmBook()
    book.update({"scene_ended": "", "plc_silent": "", "camera_unfit": ""}, 1.0)
    book.acknowledge("plc_silent", "anna")
    assert [alarm.code for alarm in book.alarms] == ["camera_unfit", "scene_ended", "plc_silent"]


def test_what_is_still_so_comes_before_what_is_over():
    book = AlarmBook()
    book.update({"plc_silent": ""}, 1.0)
    book.update({"disk_low": ""}, 2.0)
    assert [alarm.code for alarm in book.alarms] == ["disk_low", "plc_silent"]


@pytest.mark.parametrize(("set_mode", "simulation", "told"), [("SIM", False, "a real"), ("REAL", True, "a sim")])
def test_settings_and_plc_that_disagree_about_the_machine_are_an_alarm(set_mode, simulation, told):
    found = active_alarms(state(simulation=simulation), replace(CALM, set_mode=set_mode))
    assert told in found["mode_mismatch"]
    assert active_alarms(state(simulation=not simulation), replace(CALM, set_mode=set_mode)) == {}


def test_the_documents_are_those_of_the_catalogue():
    assert (DOCS / "alarms.md").read_text("utf-8") == index_markdown()
    for kind in CATALOGUE.values():
        assert (DOCS / "alarms" / f"{kind.code}.md").read_text("utf-8") == page_markdown(kind)
    assert {path.stem for path in (DOCS / "alarms").glob("*.md")} == set(CATALOGUE)


@pytest.mark.parametrize("acknowledged", [False, True])
def test_a_plc_that_falls_silent_ends_none_of_its_alarms(acknowledged):
    """The emergency stop may have cut its supply: that its cause is over, nobody knows."""
    book, pressed, silent = AlarmBook(), state("fault", bits=int(FaultBit.ESTOP)), state("offline", age_ms=900.0)
    book.update(active_alarms(pressed, CALM), 100.0, unknown_alarms(pressed))
    if acknowledged:
        book.acknowledge("plc_estop", "anna")
    book.update(active_alarms(silent, CALM), 101.0, unknown_alarms(silent))
    told = {one.code: one for one in book.alarms}
    assert set(told) == {"plc_estop", "plc_silent"}
    assert told["plc_estop"].ended_unix_s is None
    back = state("disarmed")
    book.update(active_alarms(back, CALM), 102.0, unknown_alarms(back))
    assert [one.code for one in book.alarms if one.ended_unix_s is None] == []
