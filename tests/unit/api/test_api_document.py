"""The OpenAPI document as programs read it: an example of every model, and that each is what it says."""

import json
import re

import jsonschema
import pytest
from served import bench

from server.api.examples import EXAMPLES, FREE_FORM

JSON = "application/json"


@pytest.fixture(scope="module")
def document(tmp_path_factory):
    made = bench(tmp_path_factory.mktemp("served"))
    yield made.app.openapi()
    made.keeper.database.close()


def resolved(schema, document):
    """A schema that jsonschema can follow: the document's own references become local definitions."""
    text = json.dumps(schema | {"$defs": document["components"]["schemas"]})
    return json.loads(text.replace("#/components/schemas/", "#/$defs/"))


def validated(value, schema, document):
    jsonschema.Draft202012Validator(resolved(schema, document)).validate(value)


def test_every_model_has_an_example_and_no_example_is_left_over(document):
    schemas = document["components"]["schemas"]
    assert sorted(set(schemas) - set(EXAMPLES)) == []
    assert sorted(set(EXAMPLES) - set(schemas)) == []
    assert all(schemas[name]["examples"] == [EXAMPLES[name]] for name in EXAMPLES)


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_each_example_is_valid_and_complete(name, document):
    schema = document["components"]["schemas"][name]
    validated(EXAMPLES[name], {"$ref": f"#/components/schemas/{name}"}, document)
    optional = {"owner"} if name.endswith("Request") else set()
    assert set(EXAMPLES[name]) >= set(schema["properties"]) - optional, "an example shows every field"


@pytest.mark.parametrize(
    ("name", "field"), [("JobView", "state"), ("PlanView", "length_mm"), ("LeaseRequest", "owner")]
)
def test_a_wrong_example_would_be_found(name, field, document):
    for wrong in ({**EXAMPLES[name], field: [1]}, {k: v for k, v in EXAMPLES[name].items() if k != field}):
        with pytest.raises(jsonschema.ValidationError):
            validated(wrong, {"$ref": f"#/components/schemas/{name}"}, document)
    with pytest.raises(jsonschema.ValidationError):
        validated({**EXAMPLES[name], "surprise": 1}, {"$ref": f"#/components/schemas/{name}"}, document)


def bodies(document):
    """(where, media type object) of every JSON body of /v1, in and out."""
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            where = f"{method.upper()} {path}"
            contents = [operation.get("requestBody", {}).get("content", {})]
            contents += [response.get("content", {}) for response in operation["responses"].values()]
            for content in contents:
                yield from ((where, body) for kind, body in content.items() if kind.endswith("json"))


def test_every_json_body_in_and_out_is_made_of_models_with_examples(document):
    bare = []
    for where, body in bodies(document):
        names = set(json.dumps(body.get("schema", {})).split('"#/components/schemas/')[1:])
        known = {name.split('"')[0] for name in names} <= set(EXAMPLES) and names
        if not known and "example" not in body and body.get("schema") != {"type": "object"}:
            bare.append(where)
    assert bare == []
    assert all(where in {one for one, _ in bodies(document)} for where in FREE_FORM)


async def test_examples_of_requests_are_taken_by_the_server_itself(open_bench):
    """Whatever comes of it, it is not the request's form that is refused."""
    refused, held = [], open_bench.control()
    async with open_bench.client() as client:
        for name, example in EXAMPLES.items():
            if name.endswith("Request") and "kind" in example and not name.startswith(("Lease", "Take")):
                answer = await client.post("/v1/jobs", json=example, headers=held)
                await open_bench.settled()
                refused += [(name, answer.text)] if answer.status_code in (400, 422) else []
    assert refused == []


def test_every_operation_has_a_short_name_of_its_own(document):
    names = [one["operationId"] for operations in document["paths"].values() for one in operations.values()]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[a-z]+(_[a-z]+)*", name) for name in names)
    linked = re.findall(r"'operationId': '(\w+)', 'parameters'", str(document))
    assert linked
    assert set(linked) <= set(names)
