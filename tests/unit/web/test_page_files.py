"""The page's files belong together: every text exists, nothing is inline, nothing comes from elsewhere."""

import json
import re
from html.parser import HTMLParser
from typing import get_args

import pytest

from server.api.panel_alarm_catalogue import CATALOGUE
from server.api.panel_view import PanelView, SafetyView
from server.link.contracts import LinkPhase
from web import STATIC_FOLDER

SCRIPTS = sorted(STATIC_FOLDER.glob("*.js"))
PAGE = (STATIC_FOLDER / "index.html").read_text(encoding="utf-8")
STYLE = (STATIC_FOLDER / "style.css").read_text(encoding="utf-8")
TEXTS = (STATIC_FOLDER / "texts.js").read_text(encoding="utf-8")
LANGUAGES = sorted(STATIC_FOLDER.glob("texts.*.json"))
#: names of texts that are put together: t(`step_${kind}`) and the like
MADE_UP = ("step_", "about_", "tour_", "priority_", "why_plc_", "hint_", "gap_", "jog_", "target_reach_")


class Tags(HTMLParser):
    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))


@pytest.fixture(scope="module")
def tags():
    parser = Tags()
    parser.feed(PAGE)
    return parser.found


def known_texts():
    body = TEXTS[TEXTS.index("{") : TEXTS.index("};")]
    return set(re.findall(r'(?:^|[\s,{])([a-z]\w*): "', body))


def english():
    body = TEXTS[TEXTS.index("{") : TEXTS.index("};")]
    return dict(re.findall(r'(?:^|[\s,{])([a-z]\w*): "([^"]*)"', body))


def fixed_phrases():
    """What the server sends as a fixed word or sentence, and the page shows."""
    states = {
        str(value) for field in ("estop", "enable") for value in get_args(SafetyView.model_fields[field].annotation)
    }
    return states | {phase.value for phase in LinkPhase} | {kind.clears for kind in CATALOGUE.values()}


@pytest.fixture(params=LANGUAGES, ids=lambda path: path.stem)
def catalogue(request):
    return json.loads(request.param.read_text("utf-8"))


def test_every_language_has_every_text(catalogue):
    """The page shows English for what is missing; the difference of the sets lists it."""
    assert set(english()) - set(catalogue["panel"]) == set()
    assert set(CATALOGUE) - set(catalogue["alarms"]) == set()
    assert fixed_phrases() - set(catalogue["phrases"]) == set()
    assert [code for code, alarm in catalogue["alarms"].items() if set(alarm) != {"title", "cause", "remedy"}] == []


def test_no_language_has_a_text_that_the_page_does_not_use(catalogue):
    assert set(catalogue["panel"]) - set(english()) == set()
    assert set(catalogue["alarms"]) - set(CATALOGUE) == set()


def test_a_translation_has_the_figures_of_the_english_text(catalogue):
    def figures(text):
        return set(re.findall(r"\{(\w+)\}", text))

    texts = english()
    wrong = {key for key, text in catalogue["panel"].items() if figures(text) != figures(texts.get(key, ""))}
    assert wrong == set()


def test_a_language_on_the_page_has_its_catalogue_and_the_other_way_round():
    script = (STATIC_FOLDER / "language.js").read_text("utf-8")
    offered = set(re.findall(r"(\w\w): \"", script[script.index("LANGUAGES = {") :].split("}")[0]))
    assert offered - {"en"} == {path.name.split(".")[1] for path in LANGUAGES}


def used_in_scripts():
    return {(script.name, key) for script in SCRIPTS for key in re.findall(r'\bt\("(\w+)"', script.read_text("utf-8"))}


def test_every_text_that_is_asked_for_exists(tags):
    known = known_texts()
    asked = used_in_scripts() | {
        ("index.html", attributes[name])
        for _, attributes in tags
        for name in ("data-t", "data-label")
        if name in attributes
    }
    assert len(asked) > 100
    assert {one for one in asked if one[1] not in known} == set()


def test_what_the_page_reads_of_its_own_part_is_sent():
    read = {name for one in SCRIPTS for name in re.findall(r"\bstate\.panel\.(\w+)", one.read_text("utf-8"))}
    assert {"look_moved_max_deg", "look_age_max_s"} <= read  # the server's limits, none of the page's own
    assert read - set(PanelView.model_fields) == set()


def test_no_text_stands_unused(tags):
    everything = PAGE + "".join(script.read_text("utf-8") for script in SCRIPTS if script.name != "texts.js")
    unused = [key for key in known_texts() if not key.startswith(MADE_UP) and not re.search(rf'"{key}"', everything)]
    assert unused == []


def test_the_page_needs_no_inline_script_or_style(tags):
    for tag, attributes in tags:
        assert "style" not in attributes, tag
        assert not any(name.startswith("on") for name in attributes), tag
        assert tag != "style"
        assert tag != "script" or attributes.get("src", "").startswith("static/")


def test_nothing_is_loaded_from_elsewhere():
    for text in (PAGE, STYLE, *(script.read_text("utf-8") for script in SCRIPTS)):
        assert re.findall(r"(?:https?:)?//[a-z0-9-]+\.[a-z]{2,}", text.replace("http://www.w3.org/2000/svg", "")) == []


def test_every_element_that_scripts_name_is_there(tags):
    ids = {attributes["id"] for _, attributes in tags if "id" in attributes}
    named = {key for script in SCRIPTS for key in re.findall(r'byId\("([\w-]+)"\)', script.read_text("utf-8"))}
    assert named - ids == set()
    assert len(ids) == sum("id" in attributes for _, attributes in tags)


def test_every_field_has_a_name(tags):
    """A label around it, or a text of its own; checked once more by axe-core in the browser."""
    fields = [attributes["id"] for tag, attributes in tags if tag == "input"]
    bare = [name for name in fields if not re.search(rf'<label[^>]*>(?:(?!</label>).)*id="{name}"', PAGE)]
    assert bare == []


def test_the_stop_button_stands_in_the_bar_and_nothing_lies_above_the_bar():
    bar = PAGE[PAGE.index("<header") : PAGE.index("</header>")]
    assert 'id="stop"' in bar
    layers = [int(value) for value in re.findall(r"z-index: (\d+)", STYLE)]
    assert max(layers) == int(re.search(r"header \{[^}]*z-index: (\d+)", STYLE).group(1))
    assert layers.count(max(layers)) == 1


def test_stop_needs_no_other_part_of_the_page():
    script = (STATIC_FOLDER / "stop.js").read_text("utf-8")
    assert "import" not in re.sub(r"//.*", "", script)
    assert PAGE.index("static/stop.js") < PAGE.index("static/main.js")
    assert "data-t" not in PAGE[PAGE.index('id="stop"') : PAGE.index("</header>")]


def test_every_address_of_the_page_is_seen_from_where_the_page_lies():
    """A proxy may put the server under a path of its own; what begins with a slash would leave it."""
    assert not re.findall(r"(?:href|src|action)=\"/[^\"]*", PAGE)
    for script in STATIC_FOLDER.glob("*.js"):
        text = script.read_text("utf-8")
        assert not re.findall(
            r"(?:fetch\(|assign\(|new URL\(|new WebSocket\(|(?:href|src)\s*[:=]\s*)[\"'`]/.*", text
        ), script.name
        assert not re.findall(r"location\.(?:host|origin)\}", text), script.name
