"""Language lint: words that the field does not use, loop variables without a name, long lines and sentences in docs,
docstrings that describe a name which is gone.

Run by `make check`. A finding reads `file:line: found -> better`. `[tool.language.allowed]` in pyproject.toml, if
there, holds the number of findings that each directory may still have; it may only fall. `--count` prints the numbers
of today. A line whose comment begins with "old name" is passed over: it holds a wire, JSON or setting name that is
still read.
"""

import argparse
import ast
import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PRODUCT = ("server", "longreach", "recording", "protocol", "machine", "sim_plc", "web", "diagnosis")
SUFFIXES = {".py", ".js", ".html", ".st", ".md"}
GENERATED = {"docs/reference.md"}  # its words come from the code, where they are checked; its table rows may be long
LINE_MAX = 160  # characters of a line in docs
ROW_MAX = 500  # characters of a table row, which cannot be wrapped
SENTENCE_MAX = 40  # words
OLD_NAME = re.compile(r"(?:#|//) old name")
# A mark, and what closes after it: a bracket, a quotation mark, the two stars of bold text.
SENTENCE_END = r"(?<=[.!?:;])\s+|(?<=[.!?][)*\"])\s+|(?<=[.!?]\*\*)\s+"
SUBJECT_MAX = 72  # characters of a commit subject, git's convention

DESCRIBED_NAMES = re.compile(r"((?:`\w+`(?:, | and )?)+):")

_NOT_IN_A_NAME = r"(?<![A-Za-z]){}(?![A-Za-z])"  # an underscore ends a word, so that identifiers are read as well
WORDS = [
    (re.compile(_NOT_IN_A_NAME.format(f"(?:{pattern})")), better)
    for pattern, better in (
        (r"[Tt]old apart|[Tt]ells? apart", "distinguished, distinguish"),
        (r"[Tt]old|[Tt]ells?|[Uu]ntold", "reported, report, given, show"),
        (r"[Ff]oretells?|[Ff]oretold|[Ff]oretelling", "predict, predicted, predictive"),
        (r"[Ll]acking|[Ll]acks?", "missing, without"),
        (r"[Bb]eside", "in addition to, next to, given (a baseline)"),
        (r"[Ww]hoever", "the caller, the client, the user"),
        (r"[Nn]obody|[Ss]omebody|[Aa]nybody", "no client, no one; a user, a client, anyone"),
        (r"[Aa]new", "again"),
        (r"[Aa]t once", "immediately; simultaneously"),
        (r"[Uu]ndisturbed", "baseline"),
        (r"(?<![Tt]here )(?:is|are) none", "is not one of, is not"),
        (r"(?<![Tt]here )is no(?! (?:longer|more|less|further|better|worse|larger|smaller))", "is not a, is without"),
        (r"[Mm]end(?:s|ed|ing)?|[Cc]ure[sd]?", "fix"),
        (r"[Ww]ish(?:es|ed)?", "request, requested"),
        (r"asked for", "requested"),
        (r"[Ss]wings?", "oscillation, oscillates"),
        (r"[Dd]rills?", "fault-injection test"),
        (r"coming again", "re-approaching"),
        (r"comes? from below", "approaches from below"),
        (r"on the dot|at its step|on their line", "on schedule, at the controller period, on the common clock"),
        (r"steel moves", "the real machine moves"),
        (r"for (?:\w+, )*one(?:, \w+)* in", "name the loop variable after the thing"),
    )
]


@dataclass(frozen=True)
class Finding:
    """One place to improve."""

    path: str
    line: int
    text: str

    @property
    def directory(self) -> str:
        """Top-level directory of the place; README.md counts as docs."""
        return self.path.partition("/")[0] if "/" in self.path else "docs"


def words_in(text: str) -> Iterator[tuple[int, str]]:
    """Line number and message of every word that has a better one."""
    for number, line in enumerate(text.splitlines(), 1):
        if OLD_NAME.search(line):
            continue
        rest = line
        for pattern, better in WORDS:
            for match in pattern.finditer(rest):
                yield number, f"'{match[0]}' -> {better}"
            rest = pattern.sub(lambda match: "." * len(match[0]), rest)


def long_lines_in(text: str) -> Iterator[tuple[int, str]]:
    """Line number and message of every Markdown line that is too long to read, outside code blocks."""
    code = False
    for number, line in enumerate(text.splitlines(), 1):
        code ^= line.lstrip().startswith("```")
        limit = ROW_MAX if line.startswith("|") else LINE_MAX
        if not code and len(line) > limit:
            yield number, f"line of {len(line)} characters -> at most {limit}"


def long_sentences_in(text: str) -> Iterator[tuple[int, str]]:
    """Line number and message of every sentence of a Markdown text that is too long, outside tables and code blocks."""
    code, paragraph, first, before = False, [], 0, ""
    for number, line in enumerate([*text.splitlines(), ""], 1):
        fence = line.lstrip().startswith("```") or (line.startswith("    ") and not before.strip() and not code)
        code ^= line.lstrip().startswith("```")
        before = line if not line.startswith("    ") or paragraph else ""
        if code or fence or not line.strip() or re.match(r"\s*([-*+]|\d+\.) |\s*[|#>!]", line):
            yield from ((first, message) for message in _too_long(" ".join(paragraph)))
            paragraph, first = [], number
        if not (code or fence or re.match(r"\s*[|#!]", line)):
            paragraph.append(line.strip())


def _too_long(paragraph: str) -> Iterator[str]:
    for sentence in re.split(SENTENCE_END, re.sub(r"`[^`]*`", "code", paragraph)):
        words = len(sentence.split())
        if words > SENTENCE_MAX:
            yield f"sentence of {words} words ('{sentence[:40]}...') -> at most {SENTENCE_MAX}"


def names_gone_in(text: str) -> Iterator[tuple[int, str]]:
    """Line number and message of every "`name`:" in a docstring of a module that does not have the name."""
    lines, docstrings = text.splitlines(), []
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if docstring := ast.get_docstring(node):
            first, last = node.body[0].lineno, node.body[0].end_lineno or 0
            docstrings.append((first, docstring))
            lines[first - 1 : last] = [""] * (last - first + 1)
    known = set(re.findall(r"\w+", "\n".join(lines)))
    for number, docstring in docstrings:
        for group in DESCRIBED_NAMES.findall(docstring):
            for name in re.findall(r"\w+", group):
                if name not in known:
                    yield number, f"`{name}` is described -> a name of this module"


def findings_in(path: str, text: str) -> list[Finding]:
    """Everything to improve in one file, in the order of the checks."""
    found = [] if path in GENERATED else list(words_in(text))
    if path.endswith(".md") and path not in GENERATED:
        found += [*long_lines_in(text), *long_sentences_in(text)]
    if path.endswith(".py"):
        found += names_gone_in(text)
    return [Finding(path, number, message) for number, message in found]


def all_findings() -> list[Finding]:
    """Everything to improve in the product's code and texts, README.md and docs."""
    listed = subprocess.run(
        ["git", "ls-files", "README.md", "docs", *PRODUCT], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    files = [path for path in listed if Path(path).suffix in SUFFIXES and (ROOT / path).exists()]
    return [finding for path in files for finding in findings_in(path, (ROOT / path).read_text(encoding="utf-8"))]


def long_subjects() -> list[str]:
    """Commit subjects of this branch, beyond main, that are too long."""
    log = subprocess.run(["git", "log", "--format=%s", "main..HEAD"], cwd=ROOT, capture_output=True, text=True)
    return [subject for subject in log.stdout.splitlines() if len(subject) > SUBJECT_MAX]


def main() -> int:
    """0: no directory has more findings than it may."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", action="store_true", help="print only the number of findings of each directory")
    parser.add_argument("directory", nargs="*", help="print every finding in these, however many are allowed")
    asked = parser.parse_args()
    found = all_findings()
    counts = Counter(finding.directory for finding in found)
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"].get("language", {})
    allowed = Counter(settings.get("allowed", {}))
    if asked.count:
        print("\n".join(f"{directory} = {counts[directory]}" for directory in ("docs", *PRODUCT)))
        return 0
    bad = {directory for directory in counts if counts[directory] > allowed[directory]}
    for finding in found:
        if finding.directory in (asked.directory or bad):
            print(f"{finding.path}:{finding.line}: {finding.text}")
    for directory in sorted(bad):
        print(f"{directory}: {counts[directory]} findings, allowed {allowed[directory]}", file=sys.stderr)
    subjects = long_subjects()
    for subject in subjects:
        print(f"commit subject of {len(subject)} characters -> at most {SUBJECT_MAX}: {subject}", file=sys.stderr)
    return 1 if bad or subjects else 0


if __name__ == "__main__":
    sys.exit(main())
