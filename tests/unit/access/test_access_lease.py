"""The lease of control: every way to get, keep, lose and hand it over; time is an argument, nothing sleeps."""

import pytest

from server.access.errors import LeaseHeldError, LeaseLostError, LeaseStaleError, NoLeaseError, TakeRefusedError
from server.access.lease import HANDOVER_OFFER_TTL_S, LeaseBook, LeaseKind

PERSON, FLEET = LeaseKind.OPERATOR, LeaseKind.FLEET
TTL_S = 10.0


def held_by(owner="anna", kind=PERSON, fencing=0):
    book = LeaseBook(fencing)
    return book, book.acquire(owner, kind, TTL_S, f"secret of {owner}", 0.0)


def test_one_holder_and_the_refusal_names_them_and_the_time_left():
    book, lease = held_by()
    with pytest.raises(LeaseHeldError, match=r"anna \(operator\) has control for 6 s") as refusal:
        book.acquire("fleet 1", FLEET, TTL_S, "x", 4.0)
    assert refusal.value.references == {"owner": "anna", "kind": "operator", "fencing": "1", "expires_in_s": "6.0"}
    assert book.check(lease.lease_id, lease.fencing, 4.0) == lease


def test_the_fencing_number_grows_with_each_holder_also_across_a_restart():
    book, first = held_by(fencing=41)
    book.release(first.lease_id, 1.0)
    second = book.acquire("bert", PERSON, TTL_S, "b", 2.0)
    third = book.take_control("cora", PERSON, TTL_S, "shift change", "c", 3.0)
    assert (first.fencing, second.fencing, third.fencing, book.fencing) == (42, 43, 44, 44)


def test_stale_is_not_lost_its_holder_revives_it_until_somebody_else_acquires():
    book, lease = held_by()
    with pytest.raises(LeaseStaleError, match=r"not renewed for 10\.0 s"):
        book.check(lease.lease_id, lease.fencing, TTL_S)
    assert "stale" in book.why_lost(lease.fencing, TTL_S)
    revived = book.keep_alive(lease.lease_id, 25.0)
    assert revived.fencing == lease.fencing
    assert book.check(lease.lease_id, lease.fencing, 34.9).owner == "anna"
    assert book.why_lost(lease.fencing, 34.9) == ""
    book.acquire("bert", FLEET, TTL_S, "b", 35.0)
    with pytest.raises(LeaseLostError, match="bert acquired it"):
        book.keep_alive(lease.lease_id, 35.1)


def test_a_person_takes_it_from_a_fleet_or_a_person_and_a_fleet_from_nobody():
    book, lease = held_by("fleet 1", FLEET)
    taken = book.take_control("anna", PERSON, TTL_S, "somebody is in the way", "a", 1.0)
    with pytest.raises(LeaseLostError, match="anna took it: somebody is in the way; anna"):
        book.check(lease.lease_id, lease.fencing, 1.0)
    assert book.why_lost(lease.fencing, 1.0) == "control was lost: anna took it: somebody is in the way"
    for fleet in ("fleet 1", "anna"):
        with pytest.raises(TakeRefusedError):
            book.take_control(fleet, FLEET, TTL_S, "hurry", "f", 2.0)
    assert book.held == taken


def test_asking_and_granting_hand_it_over_to_the_named_one_only():
    book, lease = held_by()
    assert book.request_control("bert").asked_by == ("bert",)
    book.request_control("cora")
    assert book.request_control("bert").asked_by == ("cora", "bert")
    book.offer_to(lease.lease_id, "bert", 1.0)
    assert book.check(lease.lease_id, lease.fencing, 1.0).owner == "anna"  # until it is collected
    with pytest.raises(LeaseHeldError):
        book.acquire("cora", PERSON, TTL_S, "c", 1.5)
    assert book.acquire("bert", PERSON, TTL_S, "b", 2.0).fencing == 2


def test_an_offer_that_is_not_collected_ends():
    book, lease = held_by()
    book.offer_to(lease.lease_id, "bert", 0.0)
    late_s = HANDOVER_OFFER_TTL_S
    book.keep_alive(lease.lease_id, late_s)
    with pytest.raises(LeaseHeldError):
        book.acquire("bert", PERSON, TTL_S, "b", late_s)


def test_asking_for_free_control_says_that_it_is_free():
    assert LeaseBook().request_control("bert") is None


@pytest.mark.parametrize(
    ("lease_id", "fencing", "error"),
    [
        ("", None, NoLeaseError),
        ("", 1, NoLeaseError),
        ("secret of anna", None, NoLeaseError),
        ("guessed", 7, NoLeaseError),
        ("guessed", 0, NoLeaseError),
        ("of an earlier life", 1, LeaseLostError),
        ("secret of anna", 0, NoLeaseError),
        ("secret of anna", 2, LeaseLostError),
    ],
)
def test_what_is_no_lease_of_now_moves_nothing(lease_id, fencing, error):
    book, _ = held_by()
    with pytest.raises(error):
        book.check(lease_id, fencing, 1.0)


def test_the_secret_is_in_no_text():
    book, lease = held_by()
    assert "secret" not in repr(lease)
    with pytest.raises(LeaseHeldError) as refusal:
        book.acquire("bert", PERSON, TTL_S, "b", 1.0)
    assert "secret" not in str(refusal.value) + str(refusal.value.references)
