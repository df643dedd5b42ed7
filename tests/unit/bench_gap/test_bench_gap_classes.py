"""How large the classes are that names are told in: one told apart from all others counts, too."""

from benchmarks.diagnosis.sealed.judge import _class_sizes

LAG, GAIN, ASYMMETRY = ("valve_lag", 1), ("flow_gain_error", 2), ("valve_asymmetry", 2)


def answer(*classes: tuple[tuple[str, int | None], ...]) -> dict[str, object]:
    return {"indistinguishable": [[{"name": name, "joint": joint} for name, joint in one] for one in classes]}


def test_a_name_told_apart_from_all_others_is_a_class_of_one() -> None:
    assert _class_sizes(answer((GAIN, ASYMMETRY)), [LAG, GAIN]) == [1, 2]
    assert _class_sizes(answer(), [LAG]) == [1]


def test_what_is_not_named_has_no_class() -> None:
    assert _class_sizes(answer((GAIN, ASYMMETRY)), []) == []
