"""The order of the steps, what each needs, and that no expected error ends the list."""

import pytest
from commissioning_states import StandInLink, StandInOperator, health, sample, site

from server.commissioning import check_list
from server.commissioning.check_list import CHECK_LIST_STEPS, Step, StepRequirement, go_through
from server.commissioning.contracts import StepResult, Verdict
from server.commissioning.moving import NotReadyError
from server.link.contracts import LinkPhase
from server.link.errors import LinkRefusedError


def passing(name):
    return StepResult(name, Verdict.PASS, "fine")


def step(number=5, name="joint signs", needs=(), after=(), raises=None):
    async def run(_site):
        if raises is not None:
            raise raises
        return passing(name)

    return Step(number, name, run, needs, after)


async def run(steps, where=None, earlier=()):
    return await go_through(where or site(), steps, earlier, lambda result: None)


@pytest.fixture
def impatient(monkeypatch):
    for name in ("PLC_WAIT_S", "CAMERA_WAIT_S", "DRY_RUN_WAIT_S"):
        monkeypatch.setattr(check_list, name, 0.0)


def test_numbers_and_names_are_unique_and_failures_point_back():
    assert [each.number for each in CHECK_LIST_STEPS] == list(range(1, 9))
    assert len({each.name for each in CHECK_LIST_STEPS}) == 8
    assert all(before < each.number for each in CHECK_LIST_STEPS for before in each.prerequisite_steps)


def test_whatever_moves_needs_leave_open_valves_and_a_proven_link():
    for each in CHECK_LIST_STEPS:
        if StepRequirement.LEAVE in each.requirements:
            assert StepRequirement.VALVES in each.requirements
            assert {1, 2} <= set(each.prerequisite_steps)


@pytest.mark.parametrize("error", [LinkRefusedError("ENABLE"), NotReadyError("no room"), ValueError("no motion")])
async def test_an_expected_error_leaves_its_step_open_and_the_rest_goes_on(error):
    link = StandInLink()
    results = await run([step(raises=error), step(6, "camera axes")], site(link))
    assert [result.verdict for result in results] == [Verdict.INCONCLUSIVE, Verdict.PASS]
    assert str(error) in results[0].summary
    assert link.calls == ["disarm", "disarm"]


async def test_a_defect_is_not_hidden_but_the_machine_is_disarmed():
    link = StandInLink()
    with pytest.raises(KeyError):
        await run([step(raises=KeyError("defect"))], site(link))
    assert link.calls == ["disarm"]


async def test_a_silent_plc_leaves_a_step_open_and_names_the_server(impatient):
    link = StandInLink()
    link.health = health(LinkPhase.OFFLINE, last_reject="SESSION: another session is open")
    (result,) = await run([step(needs=(StepRequirement.PLC,))], site(link))
    assert result.verdict is Verdict.INCONCLUSIVE
    assert "SESSION" in result.summary
    assert "one controller at a time" in result.remedy


async def test_a_dry_run_leaves_a_moving_step_open(impatient):
    link = StandInLink()
    link.health = health(dry_run=True)
    (result,) = await run([step(needs=(StepRequirement.VALVES,))], site(link))
    assert result.verdict is Verdict.INCONCLUSIVE
    assert "bDryRun" in result.remedy


async def test_without_leave_a_moving_step_is_skipped_and_leave_is_asked_once():
    operator = StandInOperator(leave=False)
    results = await run(
        [step(needs=(StepRequirement.LEAVE,)), step(8, "stop times", (StepRequirement.LEAVE,))], site(operator=operator)
    )
    assert {result.verdict for result in results} == {Verdict.SKIPPED}
    assert operator.leave_asked == 1


async def test_without_a_camera_a_looking_step_stays_open(impatient):
    (result,) = await run([step(needs=(StepRequirement.CAMERA,))])
    assert result.verdict is Verdict.INCONCLUSIVE


async def test_a_silent_camera_leaves_a_looking_step_open(impatient):
    class Silent:
        age_s = float("inf")
        stream_text = "connection refused"

    (result,) = await run([step(needs=(StepRequirement.CAMERA,))], site(vision=Silent()))
    assert result.verdict is Verdict.INCONCLUSIVE
    assert "connection refused" in result.summary


async def test_a_failure_before_keeps_what_comes_after_from_beginning():
    failed = StepResult("link dry run", Verdict.FAIL, "did not stop")
    (result,) = await run([step(after=(1,))], earlier=[failed])
    assert result.verdict is Verdict.INCONCLUSIVE
    assert "'link dry run' failed" in result.summary
    mended = passing("link dry run")
    (result,) = await run([step(after=(1,))], earlier=[failed, mended])
    assert result.verdict is Verdict.PASS


async def test_what_was_not_proven_before_is_noted():
    (result,) = await run([step(after=(1, 2))], earlier=[passing("link dry run")])
    assert result.notes == ("'limits equal' before it: not run",)


async def test_a_real_machine_is_not_moved_before_the_link_was_seen_to_stop():
    link = StandInLink()
    link.latest = sample(0.0, simulation=False)
    moving = step(needs=(StepRequirement.LEAVE,))
    (refused,) = await run([moving], site(link))
    assert refused.verdict is Verdict.INCONCLUSIVE
    assert "step 1" in refused.summary
    (allowed,) = await run([moving], site(link), earlier=[passing("link dry run")])
    assert allowed.verdict is Verdict.PASS


@pytest.mark.parametrize("later", [Verdict.SKIPPED, Verdict.INCONCLUSIVE])
async def test_a_failure_stands_until_its_step_was_gone_through_again(later):
    failed = StepResult("joint signs", Verdict.FAIL, "tool went the wrong way")

    async def left_open(_site):
        return StepResult("joint signs", later, "nobody looked")

    steps = [Step(5, "joint signs", left_open, ()), step(8, "stop times", after=(5,))]
    again, after = await run(steps, earlier=[failed])
    assert (again.verdict, after.verdict) == (later, Verdict.INCONCLUSIVE)
    assert "'joint signs' failed" in after.summary
    mended = [step(5, "joint signs"), step(8, "stop times", after=(5,))]
    assert [one.verdict for one in await run(mended, earlier=[failed])] == [Verdict.PASS, Verdict.PASS]
