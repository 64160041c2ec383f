"""Requests and answers of KServe v2 as bytes: a JSON head, then the contents of binary tensors."""

from __future__ import annotations

import asyncio
import base64
import binascii
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

from ..protocol.documents import Unreadable, from_json
from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..protocol.values import check_box
from ..settings import Settings

HEAD_LENGTH = "Inference-Header-Content-Length"
MAX_TENSORS = 8
MAX_DIMENSIONS = 4
BYTES_OF = {"UINT8": 1, "FP32": 4}
Data = bytes | memoryview


@dataclass(frozen=True, slots=True)
class Call:
    """A request. ``outputs`` says of each output that was asked for by name whether it goes in binary."""

    id: str | None
    parameters: dict[str, Any]
    frame: Data
    boxes: list[list[float]] | None
    outputs: dict[str, bool]

    def flag(self, name: str) -> bool:
        """Return a parameter that is true or false, False if it is not given. Raises bad-request."""
        value = self.parameters.get(name, False)
        if type(value) is not bool:
            raise _bad(f"{name} is true or false")
        return value


@dataclass(frozen=True, slots=True)
class Tensor:
    """An input: its contents in binary, or as the values of its JSON in one list."""

    name: str
    datatype: str
    shape: list[int]
    data: Data | list[Any]


async def read_call(body: Data, head_length: str | None, settings: Settings) -> Call:
    """Return the request in ``body``. Raises bad-request, frame-too-large."""
    head, rest = _split(body, head_length)
    if len(head) > settings.max_body_bytes:
        detail = f"at most {settings.max_body_bytes} bytes of JSON; send frames as binary tensors (binary_data=True)"
        raise ProblemError(ProblemCode.BODY_TOO_LARGE, detail)
    try:
        document = from_json(bytes(head), settings.max_body_bytes)
    except Unreadable as unreadable:
        raise _bad(str(unreadable)) from unreadable
    if not isinstance(document, dict):
        raise _bad("the request is a map with inputs")
    parameters = _map(document.get("parameters", {}), "parameters")
    inputs = _inputs(document.get("inputs"), rest)
    if (frame := inputs.pop("FRAME", None)) is None:
        raise _bad("the input FRAME is missing: a JPEG, PNG or WebP image as UINT8 [-1] or BYTES [1]")
    boxes = _boxes(inputs.pop("BOX", None))
    if inputs:
        raise _bad(f"no input {next(iter(inputs))[:40]!r}; there are FRAME and BOX")
    image = await _image(frame)
    if len(image) > settings.max_frame_bytes:
        detail = f"{len(image)} bytes; at most {settings.max_frame_bytes}"
        raise ProblemError(ProblemCode.FRAME_TOO_LARGE, detail)
    call_id = document.get("id")
    if call_id is not None and not (type(call_id) is str and len(call_id) <= 128):
        raise _bad("id is a text of at most 128 characters")
    wanted = _list(document.get("outputs", []), "outputs")
    usual = bool(parameters.get("binary_data_output"))
    return Call(call_id, parameters, image, boxes, dict(_output(one, usual) for one in wanted))


def write_tensors(
    values: Mapping[str, tuple[str, list[int], Sequence[Any]]], binary: Mapping[str, bool]
) -> tuple[list[dict[str, Any]], bytes]:
    """Return the JSON of outputs (datatype, shape and values by name), and the contents of those that are binary."""
    outputs, tail = [], b""
    for name, (datatype, shape, contents) in values.items():
        output: dict[str, Any] = {"name": name, "datatype": datatype, "shape": shape}
        if binary[name]:
            data = _packed(datatype, contents)
            output["parameters"] = {"binary_data_size": len(data)}
            tail += data
        else:
            output["data"] = contents
        outputs.append(output)
    return outputs, tail


def _packed(datatype: str, contents: Sequence[Any]) -> bytes:
    if datatype == "BYTES":
        return b"".join(struct.pack("<I", len(text)) + text.encode() for text in contents)
    return struct.pack(f"<{len(contents)}f", *contents)


def _split(body: Data, head_length: str | None) -> tuple[Data, memoryview]:
    if head_length is None:
        return body, memoryview(b"")
    if not (head_length.isdecimal() and int(head_length[:20]) <= len(body)):
        raise _bad(f"{HEAD_LENGTH} is the number of bytes of the JSON before the binary tensors")
    view, length = memoryview(body), int(head_length)
    return view[:length], view[length:]


def _inputs(sent: Any, rest: memoryview) -> dict[str, Tensor]:
    """Return the inputs by name; ``rest`` has the contents of the binary ones, one after the other."""
    inputs: dict[str, Tensor] = {}
    for one in _list(sent, "inputs"):
        tensor = _map(one, "an input")
        name, datatype, shape = tensor.get("name"), tensor.get("datatype"), tensor.get("shape")
        if type(name) is not str or type(datatype) is not str or name in inputs:
            raise _bad("an input has a name of its own, a datatype and a shape")
        if not (type(shape) is list and len(shape) <= MAX_DIMENSIONS and all(type(n) is int and n >= 0 for n in shape)):
            raise _bad(f"the shape of {name[:40]} is a list of at most {MAX_DIMENSIONS} whole numbers")
        size = _map(tensor.get("parameters", {}), "parameters").get("binary_data_size")
        data: Data | list[Any]
        if size is None:
            data = list(_flat(_list(tensor.get("data"), f"data of {name[:40]}", most=None)))
            fits = len(data) == prod(shape)
        elif type(size) is int and 0 <= size <= len(rest):
            data, rest = rest[:size], rest[size:]
            fits = datatype == "BYTES" or size == prod(shape) * BYTES_OF.get(datatype, 0)
        else:
            raise _bad(f"binary_data_size of {name[:40]} is the number of its bytes behind the JSON")
        if not fits:
            raise _bad(f"{name[:40]} does not have as many values of {datatype[:10]} as its shape says")
        inputs[name] = Tensor(name, datatype, shape, data)
    if rest:
        raise _bad("there are more bytes than binary_data_size says of all inputs")
    return inputs


def _flat(values: list[Any], depth: int = MAX_DIMENSIONS) -> list[Any]:
    """Return nested lists as one, row by row."""
    if not values or type(values[0]) is not list:
        return values  # a list among its values is refused where they are used
    if depth < 2 or not all(type(value) is list for value in values):
        raise _bad("data is a list of values, or of lists for each dimension")
    return [one for value in values for one in _flat(value, depth - 1)]


async def _image(tensor: Tensor) -> Data:
    """Return the encoded image: what the tensor holds, or a PNG of the pixels that it holds."""
    data = tensor.data
    if tensor.datatype == "BYTES" and prod(tensor.shape) == 1:
        return _from_text(data[0]) if isinstance(data, list) else _only_element(data)
    if tensor.datatype != "UINT8":
        raise _bad("FRAME is one frame: an image file as UINT8 [-1] or BYTES [1], or RGB pixels as UINT8 [H, W, 3]")
    if isinstance(data, list):
        try:
            data = bytes(data)
        except (TypeError, ValueError):
            raise _bad("data of FRAME are whole numbers from 0 to 255") from None
    shape = tensor.shape[1:] if len(tensor.shape) in (2, 4) and tensor.shape[0] == 1 else tensor.shape
    if len(shape) == 1:
        return data
    if len(shape) != 3 or shape[2] != 3 or not all(shape):
        raise _bad(
            "FRAME has the shape [-1] (an image file) or [H, W, 3] (RGB); a request is one frame of one sequence"
        )
    return await asyncio.to_thread(_png, data, shape[1], shape[0])


def _png(pixels: Data, width: int, height: int) -> bytes:
    """Return RGB pixels, row by row, as a PNG (RFC 2083)."""
    view, row = memoryview(pixels), 3 * width
    rows = b"".join(part for y in range(height) for part in (b"\0", view[y * row : (y + 1) * row]))
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(rows, 1)),
        (b"IEND", b""),
    )
    parts = [b"\x89PNG\r\n\x1a\n"]
    for kind, data in chunks:
        parts += struct.pack(">I", len(data)), kind, data, struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))
    return b"".join(parts)


def _only_element(data: Data) -> memoryview:
    """Return the one element of a binary BYTES tensor, which stands behind its length."""
    if len(data) < 4 or struct.unpack_from("<I", data)[0] != len(data) - 4:
        raise _bad("a BYTES tensor has before each element its length, as four bytes, least first")
    return memoryview(data)[4:]


def _from_text(text: Any) -> bytes:
    try:
        return base64.b64decode(text, validate=True)
    except (TypeError, ValueError, binascii.Error):
        raise _bad("a BYTES tensor in JSON has the image in base64; better send it in binary") from None


def _boxes(tensor: Tensor | None) -> list[list[float]] | None:
    if tensor is None:
        return None
    if tensor.datatype != "FP32" or tensor.shape[-1:] != [4] or len(tensor.shape) > 2 or not prod(tensor.shape):
        raise _bad("BOX is FP32, [4] or [N, 4]: x, y, w, h in pixels")
    data = tensor.data
    values = data if isinstance(data, list) else list(struct.unpack(f"<{len(data) // 4}f", data))
    return [check_box(values[at : at + 4]) for at in range(0, len(values), 4)]


def _output(sent: Any, usual: bool) -> tuple[str, bool]:
    output = _map(sent, "an output")
    parameters = _map(output.get("parameters", {}), "parameters")
    name, binary = output.get("name"), parameters.get("binary_data", usual)
    if type(name) is not str or type(binary) is not bool:
        raise _bad("an output has a name; binary_data is true or false")
    return name, binary


def _map(value: Any, what: str) -> dict[str, Any]:
    if type(value) is not dict:
        raise _bad(f"{what}: not a map")
    return value


def _list(value: Any, what: str, most: int | None = MAX_TENSORS) -> list[Any]:
    if type(value) is not list or (most is not None and len(value) > most):
        raise _bad(f"{what}: not a list" + (f" of at most {most}" if most else ""))
    return value


def _bad(detail: str) -> ProblemError:
    return ProblemError(ProblemCode.BAD_REQUEST, detail)
