"""Both contracts, and a page that shows them without internet access."""

from __future__ import annotations

from dataclasses import dataclass

from fastapi import APIRouter, FastAPI
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from ..protocol.documents import to_json
from . import asyncapi, page
from .answers import JSON

router = APIRouter(include_in_schema=False)
PAGE_POLICY = "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'; base-uri 'none'"


@dataclass(frozen=True, slots=True)
class Documents:
    """The documents as bytes. They are made before the first call: together they take a hundred milliseconds."""

    openapi: bytes
    asyncapi: bytes
    page: bytes

    @classmethod
    def of(cls, app: FastAPI) -> Documents:
        """Return the documents of an application that has all its routes."""
        http, stream = app.openapi(), asyncapi.document()
        return cls(to_json(http).encode(), to_json(stream).encode(), page.render(http, stream).encode())


@router.get("/openapi.json")
async def openapi_document(request: Request) -> Response:
    """Return the OpenAPI document of the HTTP calls."""
    return Response(request.app.state.documents.openapi, media_type=JSON)


@router.get("/asyncapi.json")
async def asyncapi_document(request: Request) -> Response:
    """Return the AsyncAPI document of the stream."""
    return Response(request.app.state.documents.asyncapi, media_type=JSON)


@router.get("/docs")
async def docs_page(request: Request) -> Response:
    """Return the page that shows both."""
    return HTMLResponse(request.app.state.documents.page, headers={"Content-Security-Policy": PAGE_POLICY})
