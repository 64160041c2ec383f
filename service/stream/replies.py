"""The answers of a stream that are no results: targets and refusals."""

from __future__ import annotations

from typing import Any

import structlog

from ..observability.metrics import Metrics
from ..observability.sampled import Sampled
from ..protocol.answers import Error, Targets, message
from ..protocol.problems import ProblemError
from ..protocol.requests import Control
from ..protocol.values import Echo
from ..sessions.session import Session

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.stream")
refusals = Sampled(log)


class Replies:
    """Makes messages for one connection; refusals are counted and logged as they are made."""

    def __init__(self, session: Session, metrics: Metrics, request_id: str) -> None:
        self._session, self._metrics, self._request_id = session, metrics, request_id

    def targets(self, control: Control) -> dict[str, Any]:
        """Return the answer to a control that was done."""
        session = self._session
        return message(Targets, ref=control.ref, region=session.region, targets=session.target_maps())

    def error(self, problem: ProblemError, *, seq: int | None = None, ref: Echo | None = None) -> dict[str, Any]:
        """Return the refusal of one message: of the frame ``seq``, or of the message with ``ref``."""
        self._metrics.refused_message(problem.code, frame=seq is not None)
        refusals.info("message refused", session=self._session.id, seq=seq, code=problem.code, detail=problem.detail)
        return message(Error, problem=problem.body(self._request_id), seq=seq, ref=ref)

    def errors(self, problem: ProblemError, seq: int | None, controls: list[Control]) -> list[dict[str, Any]]:
        """Return one refusal for the frame ``seq``, if there is one, and one for each of its controls."""
        first = [self.error(problem, seq=seq)] if seq is not None or not controls else []
        return first + [self.error(problem, ref=control.ref) for control in controls]
