"""Both contracts: complete, valid, and their examples are what they say."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from jsonschema_rs import Draft202012Validator, ValidationError
from pydantic import SecretStr

from service.api import asyncapi, capabilities, page
from service.app import create_app
from service.protocol import answers, examples
from service.protocol.capabilities import Capabilities
from service.protocol.problems import CATALOGUE, ProblemError
from service.protocol.schema import adapter
from service.settings import Settings

PROTOCOL = Path(__file__).resolve().parents[3] / "docs" / "protocol.md"


@pytest.fixture(scope="module")
def openapi() -> dict[str, Any]:
    document: dict[str, Any] = create_app(Settings()).openapi()
    return document


def check(document: dict[str, Any], schema: dict[str, Any], value: Any) -> None:
    Draft202012Validator({**schema, "components": document["components"]}).validate(value)


def test_every_call_of_the_protocol_is_documented(openapi: dict[str, Any]) -> None:
    rows = re.findall(r"^\| `(GET|POST|PUT|DELETE) (/v1[^`?]*)", PROTOCOL.read_text(), re.M)
    documented = {
        (method.upper(), path.replace("session_id", "id").replace("target_id", "tid"))
        for path, calls in openapi["paths"].items()
        for method in calls
        if path.startswith("/v1")
    }
    assert set(rows) == documented


def test_names_of_calls_are_plain(openapi: dict[str, Any]) -> None:
    """They become the names of functions in generated clients."""
    names = [call["operationId"] for calls in openapi["paths"].values() for call in calls.values()]
    assert len(set(names)) == len(names)
    assert {"create_session", "get_session", "delete_session", "post_frame", "get_snapshot"} <= set(names)
    assert all(re.fullmatch(r"[a-z]+(_[a-z]+)?", name) for name in names)


def test_what_a_caller_may_leave_out_is_optional_in_generated_types(openapi: dict[str, Any]) -> None:
    """openapi-typescript demands what has a default."""
    for name in ("Options", "TicketBody", "CreateBody", "CreateForm", "FrameBody"):
        schema = openapi["components"]["schemas"][name]
        assert set(schema.get("required", ())) <= {"frame"}
        assert not any("default" in one for one in schema["properties"].values())


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"frame": ""},
        {"box": examples.BOX},
        {"frame": "", "box": examples.BOX, "boxes": [examples.BOX]},
        {"frame": "", "boxes": []},
        {"frame": "", "box": examples.BOX, "options": {"idle_timeout_s": 0.5}},
        {"frame": "", "box": examples.BOX, "other": 1},
    ],
)
def test_a_wrong_body_does_not_fit_its_schema(openapi: dict[str, Any], body: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        check(openapi, {"$ref": "#/components/schemas/CreateBody"}, body)


@pytest.mark.parametrize("kind", ["keys", "file", "none"])
def test_security_follows_the_settings(tmp_path: Path, kind: str) -> None:
    """Keys of the file count too; the metrics have a key of their own."""
    file = tmp_path / "keys"
    file.write_text("a-key-of-one-tenant\n")
    given: dict[str, Any] = {
        "keys": {"api_keys": ("a-key-of-one-tenant",)},
        "file": {"api_keys_file": file},
        "none": {},
    }
    document = create_app(Settings(**given[kind])).openapi()
    secured = {path for path, calls in document["paths"].items() for call in calls.values() if "security" in call}
    assert ("securitySchemes" in document["components"]) == (kind != "none")
    assert secured == ({path for path in document["paths"] if path.startswith("/v1/")} if kind != "none" else set())
    document = create_app(Settings(admin_key=SecretStr("the-key-of-who-watches"))).openapi()
    assert document["paths"]["/metrics"]["get"]["security"]
    assert "security" not in document["paths"]["/v1/sessions"]["get"]


def test_a_repeated_creation_can_meet_an_ended_session(openapi: dict[str, Any]) -> None:
    assert "410" in openapi["paths"]["/v1/sessions"]["post"]["responses"]


def test_every_answer_and_body_has_an_example_that_fits(openapi: dict[str, Any]) -> None:
    seen = 0
    for path, calls in openapi["paths"].items():
        for method, call in calls.items():
            contents = [answer.get("content", {}) for answer in call["responses"].values()]
            contents.append(call.get("requestBody", {}).get("content", {}))
            for content in contents:
                for kind, media in content.items():
                    shown = [media["example"]] if "example" in media else []
                    shown += [example["value"] for example in media.get("examples", {}).values()]
                    assert shown, (method, path, kind)
                    for value in shown:
                        if kind not in ("multipart/form-data",):
                            check(openapi, media["schema"], value)
                        seen += 1
            assert call["description"]
            assert all("description" in parameter for parameter in call.get("parameters", ())) or path
    assert seen > 100


def test_every_problem_is_documented_with_its_example(openapi: dict[str, Any]) -> None:
    shown = {
        code: example["value"]
        for calls in openapi["paths"].values()
        for call in calls.values()
        for answer in call["responses"].values()
        for code, example in answer.get("content", {}).get("application/problem+json", {}).get("examples", {}).items()
    }
    # The first two are of no call in particular.
    assert set(CATALOGUE) - set(shown) == {"not-found", "method-not-allowed"}
    for code, body in shown.items():
        assert adapter(answers.ProblemDocument).validate_python(body).code == code
        assert body["status"] == CATALOGUE[code].status


def test_examples_fit_their_models() -> None:
    adapter(answers.SessionInfo).validate_python(examples.SESSION)
    adapter(answers.Result).validate_python(examples.RESULT)
    adapter(answers.Trajectory).validate_python(examples.TRAJECTORY)
    adapter(Capabilities).validate_python(examples.CAPABILITIES)
    document = asyncapi.document()
    for kind in asyncapi.MESSAGES:
        for example in examples.STREAM[kind.__name__]:
            check(document, {"$ref": f"#/components/schemas/{kind.__name__}"}, example)


def test_what_the_service_says_of_itself_is_the_example() -> None:
    app = create_app(Settings(lanes=2))
    answer = capabilities.capabilities(app.state.service)
    adapter(Capabilities).validate_python(answer)
    # The other packages are known once a lane is ready.
    assert answer | {"software": ...} == examples.CAPABILITIES | {"software": ...}
    assert answer["software"].items() <= examples.CAPABILITIES["software"].items()


def test_the_asyncapi_document_holds_together() -> None:
    document = asyncapi.document()
    assert document["asyncapi"] == "3.0.0"
    text = str(document)
    for ref in set(re.findall(r"'\$ref': '#/([^']+)'", text)):
        node: Any = document
        for part in ref.split("/"):
            node = node[part]
    assert {op["action"] for op in document["operations"].values()} == {"send", "receive"}


def test_the_page_shows_all(openapi: dict[str, Any]) -> None:
    html = page.render(openapi, asyncapi.document())
    for code in CATALOGUE:
        assert f'id="{code}"' in html
        assert ProblemError(code, "d").body()["type"] == f"/docs#{code}"
    for path in openapi["paths"]:
        assert path in html
    for kind in asyncapi.MESSAGES:
        assert f"<code>{kind.__name__}</code>" in html
    assert "http://" not in re.sub(r"ws?://127|http://127", "", html)
    assert "https://" not in html
