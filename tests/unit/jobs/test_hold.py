"""Hold-to-run: who may keep motion going, and what does not."""

import itertools

import pytest

from server.jobs.hold import CHALLENGE_NS, HOLD_SILENCE_MAX_NS, Challenge, HoldToRun, reply_to

MS = 1_000_000


def hold():
    return HoldToRun("plan-a", itertools.count(0x1234).__next__, 0)


def asked(held, t_ns):
    challenge = held.poll(t_ns)
    assert isinstance(challenge, Challenge)
    return challenge


def test_it_goes_on_as_long_as_every_challenge_is_answered():
    held = hold()
    for t_ns in range(0, 5_000 * MS, CHALLENGE_NS):
        challenge = asked(held, t_ns)
        assert held.answer(challenge.seq, reply_to(challenge.nonce), "plan-a")
    assert held.why_ended == ""


def test_silence_ends_it_after_250_ms_and_for_ever():
    held = hold()
    challenge = asked(held, 0)
    held.answer(challenge.seq, reply_to(challenge.nonce), "plan-a")
    held.poll(HOLD_SILENCE_MAX_NS)
    assert held.why_ended == ""
    assert held.poll(HOLD_SILENCE_MAX_NS + MS) is None
    assert "silent for 251 ms" in held.why_ended
    assert not held.answer(challenge.seq, reply_to(challenge.nonce), "plan-a")
    assert held.poll(HOLD_SILENCE_MAX_NS + 40 * MS) is None


def test_a_burst_of_late_answers_renews_nothing():
    held = hold()
    challenges = [asked(held, t_ms * MS) for t_ms in range(0, 241, 40)]
    for challenge in challenges[:2]:
        assert held.answer(challenge.seq, reply_to(challenge.nonce), "plan-a")  # all arrive at 245 ms
    held.poll(291 * MS)  # 251 ms after the challenge at 40 ms was made
    assert held.why_ended != ""


@pytest.mark.parametrize(
    ("seq", "reply", "bond"),
    [
        (1, 0x1234, "plan-a"),  # echoed
        (1, reply_to(0x1234), "plan-b"),  # of another plan
        (2, reply_to(0x1234), "plan-a"),  # never asked
        (1, -1, "plan-a"),
    ],
)
def test_a_wrong_answer_does_not_count(seq, reply, bond):
    held = hold()
    asked(held, 0)
    assert not held.answer(seq, reply, bond)
    held.poll(HOLD_SILENCE_MAX_NS + MS)
    assert held.why_ended != ""


def test_an_answer_counts_once():
    held = hold()
    challenge = asked(held, 0)
    assert held.answer(challenge.seq, reply_to(challenge.nonce), "plan-a")
    assert not held.answer(challenge.seq, reply_to(challenge.nonce), "plan-a")


def test_letting_go_ends_it_with_its_first_reason():
    held = hold()
    held.release("button released")
    held.release("socket closed")
    assert held.why_ended == "button released"
    assert held.poll(0) is None
