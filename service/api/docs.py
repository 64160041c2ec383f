"""Both contracts, and a page to read them without internet."""

from __future__ import annotations

from dataclasses import dataclass

from fastapi import APIRouter, FastAPI
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from ..schemas.packed import to_json
from . import asyncapi, page
from .bodies import JSON

router = APIRouter(include_in_schema=False)
PAGE_POLICY = "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'; base-uri 'none'"


@dataclass(frozen=True, slots=True)
class Documents:
    """Made once, before the first call: together they take a hundred milliseconds."""

    openapi: bytes
    asyncapi: bytes
    page: bytes

    @classmethod
    def of(cls, app: FastAPI) -> Documents:
        """The documents of an application whose calls are all there."""
        calls, stream = app.openapi(), asyncapi.document()
        return cls(to_json(calls).encode(), to_json(stream).encode(), page.render(calls, stream).encode())


@router.get("/openapi.json")
async def openapi_document(request: Request) -> Response:
    """The HTTP calls."""
    return Response(request.app.state.documents.openapi, media_type=JSON)


@router.get("/asyncapi.json")
async def asyncapi_document(request: Request) -> Response:
    """The stream."""
    return Response(request.app.state.documents.asyncapi, media_type=JSON)


@router.get("/docs")
async def read(request: Request) -> Response:
    """Both, to read."""
    return HTMLResponse(request.app.state.documents.page, headers={"Content-Security-Policy": PAGE_POLICY})
