"""Grammar of the Structured Text dialect (lark, LALR); `parse` gives the syntax tree."""

import re
from typing import Any

from lark import Lark, UnexpectedInput
from st_errors import StSyntaxError
from st_tree import Tree

GRAMMAR = r"""
file: unit* | block+ -> globals_file
?unit: pou | type_declaration

pou: POU_KIND MODIFIER* NAME extension? result? block* statements method* POU_END
pou_head: POU_KIND MODIFIER* NAME extension? result? block*
extension: ("EXTENDS"i qualified)? ("IMPLEMENTS"i qualified ("," qualified)*) | "EXTENDS"i qualified
result: ":" type ";"?
method: "METHOD"i MODIFIER* NAME result? block* statements "END_METHOD"i
method_head: "METHOD"i MODIFIER* NAME result? block*

block: VAR_KIND VAR_MODIFIER* declaration* "END_VAR"i
declaration: NAME ("," NAME)* ("AT"i LOCATION)? ":" type (":=" initial)? ";"

?type: "ARRAY"i "[" range ("," range)* "]" "OF"i type -> array_type
    | POINTER "TO"i type -> pointer_type
    | qualified -> named_type
    | qualified "(" expression ")" -> sized_type
range: expression ".." expression
qualified: NAME ("." NAME)*

?initial: expression
    | "[" array_item ("," array_item)* "]" -> array_initial
    | "(" struct_item ("," struct_item)* ")" -> struct_initial
array_item: initial | INTEGER "(" initial ")" -> repeated_item
struct_item: NAME ":=" initial

type_declaration: "TYPE"i NAME ":" type_body "END_TYPE"i
?type_body: RECORD declaration* RECORD_END ";"? -> record
    | "(" enum_item ("," enum_item)* ")" NAME? (":=" qualified)? ";" -> enumeration
    | type ";" -> alias
enum_item: NAME (":=" expression)?

statements: (statement | ";")*
?statement: postfix ":=" expression ";" -> assign
    | postfix ";" -> call_statement
    | "IF"i expression "THEN"i statements elsif* else_part? "END_IF"i -> if_statement
    | "CASE"i expression "OF"i case_part* else_part? "END_CASE"i -> case_statement
    | "FOR"i NAME ":=" expression "TO"i expression by_part? "DO"i statements "END_FOR"i -> for_statement
    | "WHILE"i expression "DO"i statements "END_WHILE"i -> while_statement
    | "REPEAT"i statements "UNTIL"i expression ";"? "END_REPEAT"i -> repeat_statement
    | JUMP ";" -> jump
elsif: "ELSIF"i expression "THEN"i statements
else_part: "ELSE"i statements
by_part: "BY"i expression
?case_part: label ("," label)* ":" -> labels
    | statement
    | ";" -> nothing
label: expression (".." expression)?

?expression: xor_part | expression (OR | OR_ELSE) xor_part -> binary
?xor_part: and_part | xor_part XOR and_part -> binary
?and_part: equality | and_part (AND | AND_THEN) equality -> binary
?equality: relation | equality (EQUAL | UNEQUAL) relation -> binary
?relation: sum | relation COMPARE sum -> binary
?sum: product | sum (PLUS | MINUS) product -> binary
?product: unary | product (TIMES | DIVIDE | MOD) unary -> binary
?unary: (MINUS | NOT) unary -> unary | PLUS unary -> plus | primary
?primary: literal | postfix | "(" expression ")"
?postfix: NAME -> name
    | postfix "." NAME -> member
    | postfix "[" expression ("," expression)* "]" -> index
    | postfix "^" -> deref
    | postfix "(" (argument ("," argument)*)? ")" -> call
argument: expression -> positional
    | NAME ":=" expression -> named
    | NAME "=>" expression? -> output
literal: TYPED | BASED | REAL | INTEGER | BOOLEAN | STRING

POU_KIND.3: /(FUNCTION_BLOCK|FUNCTION|PROGRAM)\b/i
POU_END.3: /END_(FUNCTION_BLOCK|FUNCTION|PROGRAM)\b/i
MODIFIER.3: /(PUBLIC|PRIVATE|PROTECTED|INTERNAL|FINAL|ABSTRACT)\b/i
VAR_KIND.3: /VAR(_INPUT|_OUTPUT|_IN_OUT|_TEMP|_STAT|_INST|_GLOBAL)?\b/i
VAR_MODIFIER.3: /(CONSTANT|RETAIN|PERSISTENT)\b/i
POINTER.3: /(POINTER|REFERENCE)\b/i
RECORD.3: /(STRUCT|UNION)\b/i
RECORD_END.3: /END_(STRUCT|UNION)\b/i
JUMP.3: /(EXIT|CONTINUE|RETURN)\b/i
BOOLEAN.3: /(TRUE|FALSE)\b/i
OR_ELSE.4: /OR_ELSE\b/i
AND_THEN.4: /AND_THEN\b/i
OR.3: /OR\b/i
XOR.3: /XOR\b/i
AND.3: /AND\b|&/i
MOD.3: /MOD\b/i
NOT.3: /NOT\b/i
EQUAL: "="
UNEQUAL.3: "<>"
COMPARE.2: /<=|>=|<|>/
PLUS: "+"
MINUS: "-"
TIMES: "*"
DIVIDE: "/"
LOCATION: /%[IQM][XBWDL]?(\*|[0-9.]+)/i
TYPED.2: /[a-z_]+#-?[0-9a-z_#]+(\.[0-9_]+(e[+-]?[0-9]+)?)?/i
BASED.2: /(2|8|16)#[0-9a-f_]+/i
REAL.2: /[0-9][0-9_]*(\.[0-9][0-9_]*(e[+-]?[0-9]+)?|e[+-]?[0-9]+)/i
INTEGER: /[0-9][0-9_]*/
STRING: /'([^'$]|\$.)*'/
NAME: /[a-z_][a-z0-9_]*/i

%ignore /[\s\ufeff]+/
%ignore /\/\/[^\n]*/
%ignore /\(\*(.|\n)*?\*\)/
%ignore /\{[^}]*\}/
"""

_ATTRIBUTE = re.compile(r"\{\s*attribute\s+'([^']+)'\s*(?::=\s*'([^']*)')?\s*\}", re.IGNORECASE)

_PARSER = Lark(
    GRAMMAR,
    parser="lalr",
    start=["file", "pou_head", "method_head", "statements"],
    propagate_positions=True,
    maybe_placeholders=False,
)


def parse(text: str, start: str, source: str) -> Any:
    """Syntax tree of `text` by one of the grammar's starts; `source` is for the error's text."""
    try:
        return Tree().transform(_PARSER.parse(text, start=start))
    except UnexpectedInput as error:
        line = text.split("\n")[error.line - 1].strip() if 0 < error.line <= text.count("\n") + 1 else ""
        raise StSyntaxError(f"{source}: line {error.line}, column {error.column}: {line!r}") from error


def attributes(text: str) -> dict[str, str]:
    """{attribute 'pack_mode' := '1'} and the like, lower case names."""
    return {name.lower(): value or "" for name, value in _ATTRIBUTE.findall(text)}
