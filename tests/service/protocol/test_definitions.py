"""The protocol is defined once, without the weight of the service or the tracker."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields
from typing import Any

import pytest
from jsonschema_rs import Draft202012Validator

from service.protocol import answers, examples, requests
from service.protocol.answers import SessionInfo, message
from service.protocol.enums import CloseCode, Preset, ProblemCode, Status
from service.protocol.problems import CATALOGUE, CLOSE_OF_REFUSAL
from service.protocol.schema import REF, adapter, name_of, schemas
from service.protocol.target import (
    ROW_FIELDS,
    Flags,
    Scores,
    Target,
    complete,
    row_to_map,
    rows_to_maps,
)

FLAGS, SCORES = [True, True, False], [1.0, 0.5, 2.0]
ROW: list[Any] = [3, [1.5, 2.0, 30.0, 40.0], "tracking", True, FLAGS, SCORES, 12.5, True, 1.25, 0.75]
HEAVY = ("numpy", "cv2", "numba", "fastapi", "starlette", "uvicorn")


@pytest.mark.parametrize("module", ["schema", "examples", "codecs"])
def test_the_protocol_needs_neither_numpy_nor_a_web_framework(module: str) -> None:
    script = f"import service.protocol.{module}, sys; print([name for name in {HEAVY!r} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_lanes_can_use_targets_and_problems_without_pydantic() -> None:
    script = "import service.protocol.target, service.protocol.problems, sys; print('pydantic' in sys.modules)"
    assert (
        subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout == "False\n"
    )


def test_every_problem_has_a_row_and_every_refused_handshake_a_close_code() -> None:
    assert set(CATALOGUE) == set(ProblemCode)
    assert all(300 <= kind.status < 600 and kind.title and kind.example and kind.when for kind in CATALOGUE.values())
    assert set(CLOSE_OF_REFUSAL) <= set(CATALOGUE)
    assert set(CLOSE_OF_REFUSAL.values()) <= set(CloseCode)


def test_a_row_is_the_target_that_a_message_shows() -> None:
    shown = row_to_map(ROW)
    assert tuple(shown) == ROW_FIELDS
    assert adapter(Target).validate_python(shown) == Target(
        3,
        (1.5, 2.0, 30.0, 40.0),
        Status.TRACKING,
        True,
        Flags(True, True, False),
        Scores(1.0, 0.5, 2.0),
        12.5,
        True,
        1.25,
        0.75,
    )
    assert rows_to_maps([ROW], [{"fused": b"png"}])[0] == {**shown, "maps": {"fused": b"png"}}


def test_a_target_that_has_just_started_has_neither_flags_nor_scores() -> None:
    shown = row_to_map([0, [0.0, 0.0, 1.0, 1.0], "tracking", None, None, None, None, True, 1.0])
    assert shown["flags"] is shown["scores"] is shown["psr"] is shown["reliable"] is None


def test_a_row_from_before_a_field_was_added_is_read_with_its_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.protocol.target.ROW_FIELDS", (*ROW_FIELDS, "added"))
    monkeypatch.setattr("service.protocol.target._DEFAULTS", (*[None] * len(ROW_FIELDS), 0.5))
    assert complete(ROW) == [*ROW, 0.5]
    assert row_to_map(ROW)["added"] == 0.5


def test_a_field_of_a_row_that_others_follow_has_no_default() -> None:
    """Rows are read by position, so what is added goes to the end and has a default."""
    nine = ("id", "box", "status", "reliable", "flags", "scores", "psr", "updated", "scale")
    assert ROW_FIELDS[:9] == nine
    added = [one for one in fields(Target) if one.name in ROW_FIELDS[9:]]
    assert all(one.default is not None or "None" in str(one.type) for one in added)


def test_a_message_has_its_type_first_and_its_fields_in_order() -> None:
    made = message(answers.Draining, url=None, resumable=True, reconnect_in_s=1.5)
    assert list(made.items()) == [("type", "draining"), ("reconnect_in_s", 1.5), ("resumable", True)]
    assert list(message(answers.Targets, targets=[], region=None, ref=None)) == ["type", "region", "targets"]
    assert list(message(answers.Targets, targets=[], region=None, ref="a")) == ["type", "ref", "region", "targets"]
    with pytest.raises(KeyError):
        message(answers.Draining, resumable=True)


def test_the_examples_fit_the_schemas() -> None:
    kinds = (*requests.STREAM_MESSAGES, *answers.STREAM_MESSAGES)
    found = schemas(kinds)
    for kind in kinds:
        schema = {"$ref": REF.format(model=name_of(kind)), "components": {"schemas": found}}
        for example in examples.STREAM[kind.__name__]:
            Draft202012Validator(schema).validate(example)
            assert not Draft202012Validator(schema).is_valid(example | {"more": 1})


def test_what_the_service_sends_is_read_as_the_clients_types() -> None:
    session = adapter(SessionInfo).validate_python(examples.SESSION | {"of a newer service": 1})
    assert session.stream_url == examples.SESSION["stream"]["url"]
    assert session.created_at.tzinfo is not None
    assert session.preset == Preset.DEFAULT
    result = adapter(answers.Result).validate_python(examples.RESULT)
    assert result.target.scores == Scores(**examples.TARGET["scores"])
    assert result.ts == 1712.5
