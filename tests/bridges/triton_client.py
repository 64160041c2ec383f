"""Runs with the real tritonclient: URL KEY FRAMES_FOLDER x,y,w,h. Prints what came of each case as one JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tritonclient.http as triton
from tritonclient.utils import InferenceServerException

MODEL = "mfcmt"
url, key, folder, box_text = sys.argv[1:]
client = triton.InferenceServerClient(url)
headers = {"Authorization": f"Bearer {key}"}
frames = [path.read_bytes() for path in sorted(Path(folder).iterdir())]
box = np.array([float(v) for v in box_text.split(",")], np.float32)


def encoded(data: bytes, *, as_bytes: bool = False, binary: bool = True) -> triton.InferInput:
    """The frame as UINT8 [-1], or as BYTES [1]."""
    array = np.array([data], object) if as_bytes else np.frombuffer(data, np.uint8)
    tensor = triton.InferInput("FRAME", list(array.shape), "BYTES" if as_bytes else "UINT8")
    return tensor.set_data_from_numpy(array, binary_data=binary)


def pixels(data: bytes) -> triton.InferInput:
    """The frame as UINT8 [H, W, 3], RGB."""
    image = cv2.cvtColor(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
    return triton.InferInput("FRAME", list(image.shape), "UINT8").set_data_from_numpy(image)


def boxes(values: np.ndarray, *, binary: bool = True) -> triton.InferInput:
    return triton.InferInput("BOX", list(values.shape), "FP32").set_data_from_numpy(values, binary_data=binary)


def infer(*inputs: triton.InferInput, **more: Any) -> dict[str, Any]:
    """The outputs of a request that must not be refused."""
    result = client.infer(MODEL, list(inputs), headers=dict(headers), **more)  # the client adds to them
    status = result.as_numpy("STATUS")
    return {
        "box": result.as_numpy("BOX").tolist(),
        "confidence": result.as_numpy("CONFIDENCE").tolist(),
        "status": [one.decode() if isinstance(one, bytes) else one for one in status.tolist()],
    }


def refused(call: Callable[[], Any]) -> list[Any]:
    """The status and the message of a request that must be refused."""
    try:
        call()
    except InferenceServerException as problem:
        return [problem.status(), problem.message()]
    return ["was not refused", ""]


def follow(name: Any, start: dict[str, Any], frame: Callable[[bytes], triton.InferInput], **more: Any) -> list[Any]:
    """A whole sequence; the results of all frames."""
    found = [infer(frame(frames[0]), boxes(box), sequence_id=name, sequence_start=True, **start, **more)]
    found.extend(infer(frame(data), sequence_id=name, **more) for data in frames[1:-1])
    return [*found, infer(frame(frames[-1]), sequence_id=name, sequence_end=True, **more)]


said: dict[str, Any] = {
    "live": client.is_server_live(),
    "ready": client.is_server_ready(),
    "model_ready": client.is_model_ready(MODEL, headers=dict(headers)),
    "server": client.get_server_metadata(headers=dict(headers)),
    "model": client.get_model_metadata(MODEL, headers=dict(headers)),
    "int": follow(7, {}, encoded),
    "string": follow("cam-1", {}, lambda data: encoded(data, as_bytes=True), model_version="1"),
    "pixels": follow("pixels", {}, pixels),
    "paper": follow("paper", {"parameters": {"preset": "paper"}}, encoded),
}

x, y, w, h = box.tolist()
two = np.array([[x, y, w, h], [x, y + h / 4, w / 2, h / 2]], np.float32)
said["two"] = infer(encoded(frames[0]), boxes(two), sequence_id="two", sequence_start=True, sequence_end=True)

# JSON alone: a small frame, its box, and the answer.
whole = cv2.imdecode(np.frombuffer(frames[0], np.uint8), cv2.IMREAD_COLOR)
small = cv2.imencode(".jpg", cv2.resize(whole, None, fx=0.25, fy=0.25))[1].tobytes()
plain = [triton.InferRequestedOutput(name, binary_data=False) for name in ("BOX", "CONFIDENCE", "STATUS")]
said["json"] = infer(
    encoded(small, binary=False),
    boxes(box / 4, binary=False),
    outputs=plain,
    sequence_id="json",
    sequence_start=True,
    sequence_end=True,
)

bare = {"sequence_id": "bare", "sequence_start": True}
said["refused"] = {
    "no start": refused(lambda: infer(encoded(frames[0]), sequence_id=99)),
    "no start after the end": refused(lambda: infer(encoded(frames[0]), sequence_id=7)),
    "no sequence": refused(lambda: infer(encoded(frames[0]), boxes(box))),
    "no box": refused(lambda: infer(encoded(frames[0]), **bare)),
    "no frame": refused(lambda: infer(boxes(box), **bare)),
    "no image": refused(lambda: infer(encoded(b"no image"), boxes(box), **bare)),
    "truncated image": refused(lambda: infer(encoded(frames[0][:-2000]), boxes(box), **bare)),
    "bad box": refused(lambda: infer(encoded(frames[0]), boxes(np.array([1, 2, 0, 4], np.float32)), **bare)),
    "batch": refused(
        lambda: infer(
            triton.InferInput("FRAME", [2], "BYTES").set_data_from_numpy(np.array(frames[:2], object)),
            boxes(box),
            **bare,
        )
    ),
    "unknown option": refused(lambda: infer(encoded(frames[0]), boxes(box), parameters={"colour": 1}, **bare)),
    "unknown output": refused(
        lambda: infer(encoded(frames[0]), boxes(box), outputs=[triton.InferRequestedOutput("MASK")], **bare)
    ),
    "unknown model": refused(lambda: client.infer("other", [encoded(frames[0])], headers=dict(headers))),
    "no key": refused(lambda: client.infer(MODEL, [encoded(frames[0])])),
    "compressed": refused(lambda: infer(encoded(frames[0]), boxes(box), request_compression_algorithm="gzip", **bare)),
}

# A start on a live sequence ends it and begins another; an end with the first frame is a whole sequence.
first = infer(encoded(frames[0]), boxes(box), sequence_id="again", sequence_start=True)
infer(encoded(frames[1]), sequence_id="again")
again = infer(encoded(frames[0]), boxes(two), sequence_id="again", sequence_start=True)
said["again"] = [len(first["box"]), len(again["box"])]
infer(encoded(frames[1]), sequence_id="again", sequence_end=True)
print(json.dumps(said))
