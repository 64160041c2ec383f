"""Both contracts, and a page to read them without internet."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from .answers import answer
from .bodies import JSON

router = APIRouter(include_in_schema=False)


@router.get("/openapi.json")
async def openapi_document(request: Request) -> Response:
    """The HTTP calls."""
    return answer(JSON, 200, request.app.openapi())
