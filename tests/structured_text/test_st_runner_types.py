"""The Structured Text runner refuses what a TwinCAT compiler would refuse, by POU and line; and says nothing else."""

import re

import pytest
from st_errors import StSyntaxError, StTypeError
from st_program import check_types, load_sources

LIBRARY = """
TYPE E_Mode : (IDLE := 0, ARM := 1) UINT; END_TYPE
TYPE E_Other : (NONE, SOME) USINT; END_TYPE
TYPE ST_A : STRUCT n : UINT; END_STRUCT END_TYPE
TYPE U_A : UNION m : ST_A; b : ARRAY[0..1] OF BYTE; END_UNION END_TYPE

FUNCTION F_Two : DINT
VAR_INPUT nA : DINT; nB : DINT := 5; END_VAR
VAR_OUTPUT nOut : DINT; END_VAR
VAR_IN_OUT nBoth : DINT; END_VAR
END_FUNCTION

FUNCTION_BLOCK FB_A
VAR_INPUT nIn : INT; END_VAR
VAR_OUTPUT nOut : INT; aOut : ARRAY[0..1] OF INT; END_VAR
VAR nLocal : INT; fbInner : FB_B; END_VAR

METHOD Go : BOOL
VAR_INPUT b : BOOL; END_VAR
END_METHOD
METHOD Sum
VAR_IN_OUT aList : ARRAY[0..1] OF INT; END_VAR
END_METHOD
END_FUNCTION_BLOCK

FUNCTION_BLOCK FB_B
VAR_INPUT n : INT; END_VAR
END_FUNCTION_BLOCK
"""
GLOBALS = "VAR_GLOBAL CONSTANT N : INT := 3; LIST : ARRAY[0..1] OF INT := [1, 2]; END_VAR VAR_GLOBAL k : INT; END_VAR"
VARIABLES = """VAR
    b : BOOL; us : USINT; ui : UINT; ud : UDINT; ul : ULINT; si : SINT; i : INT; di : DINT; li : LINT;
    by : BYTE; dw : DWORD; r : REAL; lr : LREAL; e : E_Mode; eo : E_Other; st : ST_A; u : U_A; fb : FB_A;
    a : ARRAY[0..3] OF INT; a2 : ARRAY[0..4] OF INT; p : POINTER TO BYTE; aBy : ARRAY[0..1] OF BYTE;
END_VAR
VAR CONSTANT LIMIT_ : INT := 4; END_VAR
"""


def errors_of(body: str) -> list[str]:
    """Type errors of a program with these variables and this body, which begins on line 8."""
    sources = {"L.st": LIBRARY, "GVL.st": GLOBALS, "P.st": f"PROGRAM P\n{VARIABLES}{body}\nEND_PROGRAM"}
    return [str(error) for error in check_types(sources)]


@pytest.mark.parametrize(
    "body",
    [
        "ui := us; ud := ui; ul := ud; li := ud; di := ui; i := us; i := si; li := di;",
        "by := us; us := by; dw := ud; ud := dw; ud := by;",
        "lr := r; lr := ud; r := ui; lr := 1; r := 0.1; us := 255; si := -128;",
        "e := E_Mode.ARM; b := e = E_Mode.IDLE; b := ui = E_Mode.ARM; ui := E_Mode.ARM; us := TO_USINT(e);",
        "b := us < ui; b := di >= us; ud := ud + us; li := li + ud; b := lr > r; lr := lr * r;",
        "b := b AND us = 1; dw := dw XOR 16#FF; us := us AND by;",
        "CASE e OF E_Mode.IDLE, E_Mode.ARM: b := TRUE; END_CASE",
        "CASE ui OF E_Mode.IDLE: b := TRUE; 7..9: b := b; END_CASE",
        "di := F_Two(1, nBoth := di); di := F_Two(nA := i, nB := 2, nBoth := di, nOut => li);",
        "fb(nIn := i, nOut => i); fb.nIn := 4; i := fb.nOut; b := fb.Go(b := TRUE); fb.Go(b);",
        "a[LIMIT_ - 1] := GVL.N; a[us] := GVL.LIST[1]; GVL.k := a[3]; u.b[1] := by; u.m := st; i := i + LIMIT_;",
        "p := ADR(u); p := ADR(aBy); by := p[2]; b := p = 0; b := p <> 0; p := 0;",
        "ud := SIZEOF(st); MEMSET(ADR(u), 0, SIZEOF(u));",
        "FOR i := 0 TO 3 DO a[i] := 0; END_FOR; ; IF b THEN END_IF;",
        "r := r * 0.5; b := r > 2; r := r + r;",
    ],
)
def test_what_twincat_takes_is_taken(body: str) -> None:
    assert errors_of(body) == []


@pytest.mark.parametrize(
    ("body", "subject"),
    [
        ("x := 1;", "unknown name x"),
        ("i := Foo(1);", "unknown function Foo"),
        ("i := GVL.M;", "GVL has no M"),
        ("i := NoGvl.M;", "unknown name NoGvl"),
        ("st.x := 1;", "ST_A has no member x"),
        ("i.x := 1;", "INT has no members"),
        ("ui := E_Mode.RUN;", "no E_Mode.RUN"),
        ("i := lr;", "LREAL does not become INT"),
        ("i := 1.0;", "does not become INT"),
        ("r := lr;", "LREAL does not become REAL"),
        ("lr := ul;", "ULINT does not become LREAL"),
        ("r := ud;", "UDINT does not become REAL"),
        ("b := 1;", "does not become BOOL"),
        ("b := us;", "USINT does not become BOOL"),
        ("us := b;", "BOOL does not become USINT"),
        ("us := ui;", "UINT does not become USINT"),
        ("i := ui;", "UINT does not become INT"),
        ("ui := i;", "INT does not become UINT"),
        ("ud := di;", "DINT does not become UDINT"),
        ("us := 256;", "256 does not fit USINT"),
        ("us := -1;", "-1 does not fit USINT"),
        ("us := us + 300;", "UINT does not become USINT"),
        ("b := ul < li;", "ULINT < LINT: no common type"),
        ("i := i + us * ud;", "no common type"),
        ("b := b + b;", "not a number"),
        ("b := b AND us;", "BOOL AND USINT"),
        ("b := us;", "USINT"),
        ("b := b > b;", "BOOL > BOOL"),
        ("b := 1 AND_THEN b;", "BOOLs only"),
        ("lr := lr MOD 2.0;", "MOD of a real"),
        ("us := -us;", "- of USINT"),
        ("b := lr AND lr;", "whole numbers or BOOLs"),
        ("b := r > 0.1;", "not exact as REAL"),
        ("ud := E_Mode.ARM;", "E_Mode does not become UDINT"),
        ("e := 1;", "does not become E_Mode"),
        ("e := ui;", "UINT does not become E_Mode"),
        ("e := E_Other.NONE;", "E_Other does not become E_Mode"),
        ("b := e = E_Other.NONE;", "E_Mode compared with E_Other"),
        ("b := ud = E_Mode.ARM;", "UDINT compared with E_Mode"),
        ("e := e + 1;", "no common type"),
        ("IF ui THEN b := TRUE; END_IF", "a condition is BOOL, not UINT"),
        ("WHILE 1 DO EXIT; END_WHILE", "a condition is BOOL"),
        ("CASE lr OF 1: b := TRUE; END_CASE", "CASE of LREAL"),
        ("CASE ui OF 1, 2: b := TRUE; 2: b := FALSE; END_CASE", "CASE label 2"),
        ("CASE ui OF i: b := TRUE; END_CASE", "a CASE label is a constant"),
        ("CASE us OF 256: b := TRUE; END_CASE", "256 does not fit USINT"),
        ("CASE e OF E_Other.NONE: b := TRUE; END_CASE", "E_Other does not become E_Mode"),
        ("FOR lr := 0 TO 3 DO b := TRUE; END_FOR", "FOR variable lr is LREAL"),
        ("FOR us := 0 TO ui DO b := TRUE; END_FOR", "UINT does not become USINT"),
        ("FOR i := 0 TO 3 BY i DO b := TRUE; END_FOR", "FOR step must be a constant"),
        ("EXIT;", "EXIT outside a loop"),
        ("LIMIT_ := 5;", "LIMIT_ is a constant"),
        ("GVL.N := 5;", "GVL.N is a constant"),
        ("GVL.LIST[0] := 5;", "GVL.LIST is a constant"),
        ("fb.nOut := 1;", "FB_A.nOut is no input"),
        ("fb.nLocal := 1;", "FB_A.nLocal is local to FB_A"),
        ("i := fb.nLocal;", "FB_A.nLocal is local to FB_A"),
        ("fb.fbInner.n := 1;", "FB_A.fbInner is local to FB_A"),
        ("fb.Sum(fb.aOut);", "FB_A.aOut is no input"),
        ("fb.Sum(a);", r"given ARRAY\[0..3\] OF INT"),
        ("a := a2;", "ARRAY"),
        ("a[4] := 1;", r"index 4 outside 0\.\.3"),
        ("a[lr] := 1;", "an index is a whole number"),
        ("i[0] := 1;", "INT takes no index"),
        ("fb(nOther := 1);", "FB_A has no parameter nOther"),
        ("fb(1);", "without a name"),
        ("fb.Go(c := TRUE);", "no parameter c"),
        ("fb.Go(b := TRUE, b := TRUE);", "given twice"),
        ("fb.Go(TRUE, TRUE);", "takes 1 arguments"),
        ("b := fb.Gone();", "FB_A has no variable Gone"),
        ("b := fb.Sum(aBy);", "Sum has no value"),
        ("b := fb();", "has no value"),
        ("di := F_Two(nB := 1, nBoth := di);", "nA is not given"),
        ("di := F_Two(1);", "nBoth is not given"),
        ("di := F_Two(1, nBoth := 5);", "not a variable"),
        ("di := F_Two(1, nBoth := i);", "VAR_IN_OUT DINT, given INT"),
        ("di := F_Two(1, nBoth := di, nOut => i);", "DINT does not become INT"),
        ("i;", "a statement without effect"),
        ("i := SHL(1, 3);", "its width is not known"),
        ("us := SHR(us, 8);", "SHR by 8 of 8 bits"),
        ("i := i / 0;", "division by zero"),
        ("p := ADR(i) + 1;", "no common type"),
        ("di := TO_DINT(st);", "TO_DINT of ST_A"),
        ("di := INT_TO_DINT(lr);", "LREAL does not become INT"),
        ("i := SIZEOF(nothing);", "unknown name nothing"),
        ("lr := ABS(b);", "ABS of BOOL"),
        ("fb := fb;", "a function block is not assigned"),
        ("us := UINT#7;", "UINT does not become USINT"),
        ("us := USINT#300;", "USINT#300 does not fit"),
    ],
)
def test_what_twincat_refuses_is_refused_with_pou_line_and_subject(body: str, subject: str) -> None:
    found = errors_of(f"\n{body}")
    assert len(found) == 1
    assert found[0].startswith("P line 9: ")
    assert re.search(subject, found[0])


def test_every_wrong_statement_is_told() -> None:
    found = errors_of("i := lr;\nx := 1;\nIF b THEN\n  us := -1;\nEND_IF\ni := 1;")
    assert [error.split(":")[0] for error in found] == ["P line 8", "P line 9", "P line 11"]


@pytest.mark.parametrize(
    ("text", "subject"),
    [
        ("PROGRAM P VAR a : INT; A : INT; END_VAR END_PROGRAM", "a|A is declared twice"),
        ("PROGRAM P VAR a : NOTHING; END_VAR END_PROGRAM", "unknown type NOTHING"),
        ("PROGRAM P VAR a : STRING(20); END_VAR END_PROGRAM", "unknown type STRING"),
        ("PROGRAM P VAR a : REFERENCE TO INT; END_VAR END_PROGRAM", "REFERENCE TO"),
        ("PROGRAM P VAR a : ARRAY[3..1] OF INT; END_VAR END_PROGRAM", r"array bounds 3\.\.1"),
        ("PROGRAM P VAR a : ARRAY[0..n] OF INT; n : INT; END_VAR END_PROGRAM", "not a constant"),
        ("PROGRAM P VAR a : ARRAY[0..1] OF INT := [1, 2, 3]; END_VAR END_PROGRAM", "3 values for 2 elements"),
        ("PROGRAM P VAR CONSTANT a : INT; END_VAR END_PROGRAM", "constant a has no value"),
        ("PROGRAM P VAR CONSTANT a : INT := b; b : INT := a; END_VAR END_PROGRAM", "depends on itself"),
        ("PROGRAM P VAR a : USINT := 256; END_VAR END_PROGRAM", "256 does not fit USINT"),
        ("PROGRAM P VAR_STAT a : USINT; END_VAR END_PROGRAM", "VAR_STAT is not in the dialect"),
        ("TYPE E : (A, B, A) INT; END_TYPE", "A = 2: twice"),
        ("TYPE E : (A := 300) USINT; END_TYPE", "300 does not fit USINT"),
        ("FUNCTION F : INT VAR F : INT; END_VAR END_FUNCTION", "F is the name of the result"),
        ("PROGRAM P END_PROGRAM PROGRAM P END_PROGRAM", "P is declared twice"),
    ],
)
def test_wrong_declarations_are_refused(text: str, subject: str) -> None:
    with pytest.raises(StTypeError, match=subject):
        load_sources({"X.st": text})


ALIASES = """FUNCTION_BLOCK FB
VAR n : INT; k : INT; a : ARRAY[0..1] OF INT; END_VAR
{body}
METHOD M
VAR_IN_OUT x : INT; y : INT; END_VAR
x := n;
END_METHOD
END_FUNCTION_BLOCK"""


@pytest.mark.parametrize(
    ("body", "wrong"), [("M(n, k);", 1), ("M(k, k);", 1), ("M(a[0], a[1]);", 0), ("M(k, a[0]);", 0)]
)
def test_two_ways_to_one_number_are_refused(body: str, wrong: int) -> None:
    assert len(check_types({"FB.st": ALIASES.format(body=body)})) == wrong


def test_blocks_with_interfaces_are_read_and_left_out() -> None:
    sources = {
        "FB_X.st": "FUNCTION_BLOCK FB_X IMPLEMENTS I VAR s : STRING(9) := 'a'; END_VAR ip.Go(s); END_FUNCTION_BLOCK",
        "FB_Y.st": "FUNCTION_BLOCK FB_Y VAR fb : LibraryBlock; END_VAR END_FUNCTION_BLOCK",
        "P.st": "PROGRAM P VAR_OUTPUT n : INT; END_VAR n := 1; END_PROGRAM",
    }
    assert [str(error) for error in check_types(sources)] == ["FB_Y line 1: unknown type LibraryBlock"]
    program = load_sources(sources, without=["FB_Y"])
    assert program.skipped == ("FB_X", "FB_Y")


@pytest.mark.parametrize("text", ["PROGRAM P\nx := ;\nEND_PROGRAM", "PROGRAM P\nIF a THEN\nEND_PROGRAM", "PROGRAM"])
def test_what_is_no_structured_text_is_a_syntax_error_with_its_line(text: str) -> None:
    with pytest.raises(StSyntaxError, match=r"^P\.st: line (2|3|1|-1)"):
        load_sources({"P.st": text})
