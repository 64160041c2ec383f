"""The page of ``mfcmt track --select``: over a real socket, and in a real browser with the real command."""

from __future__ import annotations

import http.client
import json
import re
import socket
import subprocess
import sys
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

from mfcmt_core import synthetic
from mfcmt_core.cli.pick import PickServer
from tests.chromium import FLAGS, chromium

SCRIPT = Path(sys.executable).with_name("mfcmt")


@pytest.fixture(scope="module")
def clip() -> synthetic.Clip:
    return synthetic.clip("motion")


@pytest.fixture
def server(clip):
    with PickServer(clip.frames[0]) as running:
        thread = threading.Thread(target=running.serve_forever, args=(0.02,))
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def ask(server, method, path, body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=10)
    headers = {k.replace("_", "-"): v for k, v in headers.items()}
    if body is not None:
        headers = {"Content-Type": "application/json", "Origin": f"http://{server.host}"} | headers
        body = body if isinstance(body, bytes) else json.dumps(body).encode()
    connection.request(method, path, body, headers)
    answer = connection.getresponse()
    data = answer.read()
    connection.close()
    return answer.status, answer.headers, data


def enter(server) -> dict[str, str]:
    status, _, data = ask(server, "POST", "/claim", {"token": server.address.partition("#")[2]})
    assert status == 200
    return {"Authorization": f"Bearer {json.loads(data)['key']}"}


def test_the_page_has_a_strict_policy_and_no_secret(server):
    for path in ("/", "/page.js", "/page.css"):
        status, headers, data = ask(server, "GET", path)
        assert status == 200
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert "unsafe" not in headers["Content-Security-Policy"]
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["Cache-Control"] == "no-store"
        assert "Python" not in headers["Server"]
        assert server.key.encode() not in data
        assert server.token.encode() not in data
    page = ask(server, "GET", "/")[2].decode()
    assert "http:" not in page
    assert not re.search(r"<script(?![^>]*src=)|style=|\son\w+=", page)
    assert ask(server, "GET", "/../__init__.py")[0] == 404


def test_the_token_works_once(server, clip):
    assert ask(server, "GET", "/frame")[0] == 401
    assert ask(server, "POST", "/claim", {"token": "guess"})[0] == 403
    assert ask(server, "POST", "/claim", {})[0] == 403
    token = server.address.partition("#")[2]
    key = enter(server)
    assert ask(server, "POST", "/claim", {"token": token})[0] == 403
    status, headers, data = ask(server, "GET", "/frame", **key)
    assert (status, headers["Content-Type"]) == (200, "image/png")
    assert np.array_equal(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), clip.frames[0])


def test_another_host_or_origin_is_refused(server):
    key = enter(server)
    port = server.server_address[1]
    assert ask(server, "GET", "/", Host="evil.example")[0] == 403
    assert ask(server, "GET", "/frame", Host=f"evil.example:{port}", **key)[0] == 403
    assert ask(server, "GET", "/frame", Origin="http://evil.example", **key)[0] == 403
    assert ask(server, "POST", "/box", {"box": [1, 1, 9, 9]}, Origin="null", **key)[0] == 403
    assert ask(server, "POST", "/box", {"box": [1, 1, 9, 9]}, Origin=f"http://127.0.0.1:{port + 1}", **key)[0] == 403
    with socket.create_connection(("127.0.0.1", port), timeout=10) as raw:  # no Origin at all
        raw.sendall(b"POST /box HTTP/1.0\r\nHost: %b\r\nContent-Length: 0\r\n\r\n" % server.host.encode())
        assert b" 403 " in raw.recv(100)
    assert not server.chosen.is_set()


def test_a_bad_box_is_refused_and_a_good_one_ends_the_server(server):
    key = enter(server)
    assert ask(server, "POST", "/box", {"box": [1, 1, 9, 9]})[0] == 401
    bad = [
        [1, 2, 3],
        [1, 2, 3, "4"],
        [1, 2, 0, 4],
        [-1, 2, 3, 4],
        [300, 2, 30, 4],
        [1, True, 3, 4],
        None,
        "1,2,3,4",
    ]
    for box in bad:
        assert ask(server, "POST", "/box", {"box": box}, **key)[0] == 422
    assert ask(server, "POST", "/box", b'{"box": [1, 2, NaN, 4]}', **key)[0] == 422
    for body in (b"no json", b"[1]", b'{"box": ', b"[" * 60_000):
        assert ask(server, "POST", "/box", body, **key)[0] == 400
    assert ask(server, "POST", "/box", {"box": [1, 2, 3, 4]}, Content_Type="text/plain", **key)[0] == 400
    assert ask(server, "POST", "/nosuch", {}, **key)[0] == 404
    assert not server.chosen.is_set()
    assert ask(server, "POST", "/box", {"box": [1.5, 2, 30, 40]}, **key)[0] == 204
    assert server.chosen.wait(5)
    assert server.box == (1.5, 2.0, 30.0, 40.0)


@pytest.fixture(scope="module")
def browser():
    path = chromium()
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=path, args=[*FLAGS, "--disable-dev-shm-usage"])
        yield running
        running.close()


@pytest.fixture
def command(clip, tmp_path):
    """Run the real command, which waits for a box; yield (process, address)."""
    for i, frame in enumerate(clip.frames[:6]):
        cv2.imwrite(str(tmp_path / f"{i}.png"), frame)
    words = [str(SCRIPT), "track", str(tmp_path), "--select", "--no-browser", "--format", "jsonl"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    line = process.stderr.readline()
    address = re.search(r"http://127\.0\.0\.1:[0-9]+/#\S+", line)
    assert address, line
    yield process, address[0]
    process.kill()
    process.communicate()


def first_box(process) -> list[float]:
    out, err = process.communicate(timeout=120)
    assert (process.returncode, err) == (0, "")
    lines = [json.loads(line) for line in out.splitlines()]
    assert len(lines) == 6
    return lines[0]["box"]


def says(page, text: str) -> None:
    page.get_by_role("status").filter(has_text=text).wait_for(timeout=20_000)


def opened(browser, address, **options):
    page = browser.new_context(**options).new_page()
    page.complaints = []
    page.on("console", lambda m: page.complaints.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda e: page.complaints.append(str(e)))
    page.goto(address)
    says(page, "Draw the box")
    return page


def test_a_box_is_drawn_with_the_mouse(browser, command, clip):
    process, address = command
    page = opened(browser, address, viewport={"width": 1000, "height": 800})
    assert "#" not in page.url
    page.reload()  # the key outlives the token
    says(page, "Draw the box")
    x, y, w, h = clip.boxes[0]
    at = page.locator("#frame").bounding_box()
    scale = at["width"] / 320
    page.mouse.move(at["x"] + x * scale, at["y"] + y * scale)
    page.mouse.down()
    page.mouse.move(at["x"] + (x + 20) * scale, at["y"] + (y + 5) * scale, steps=3)
    page.mouse.move(at["x"] + (x + w) * scale, at["y"] + (y + h) * scale, steps=3)
    page.mouse.up()
    page.get_by_role("button", name="Start tracking").click()
    says(page, "close this page")
    assert first_box(process) == pytest.approx(list(clip.boxes[0]), abs=1)
    assert page.complaints == []


def test_a_box_is_drawn_by_touch(browser, command, clip):
    process, address = command
    page = opened(browser, address, viewport={"width": 390, "height": 780}, has_touch=True, is_mobile=True)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    x, y, w, h = clip.boxes[0]
    at = page.locator("#frame").bounding_box()
    scale = at["width"] / 320
    session = page.context.new_cdp_session(page)
    corners = [(x, y), (x + w / 2, y + h / 3), (x + w, y + h)]
    for kind, (px, py) in zip(("touchStart", "touchMove", "touchMove"), corners, strict=True):
        point = {"x": at["x"] + px * scale, "y": at["y"] + py * scale}
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [point]})
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    page.wait_for_timeout(500)  # nobody is faster
    page.get_by_role("button", name="Start tracking").tap()
    says(page, "close this page")
    assert first_box(process) == pytest.approx(list(clip.boxes[0]), abs=1.5)
    assert page.complaints == []


def test_a_box_is_drawn_with_the_keyboard_alone(browser, command):
    process, address = command
    page = opened(browser, address)
    assert page.evaluate("document.activeElement.id") == "stage"
    page.keyboard.press("ArrowRight")  # a first box in the middle: 128, 96, 64, 48
    for keys in ("ArrowLeft", "Control+ArrowDown", "Shift+ArrowRight", "Shift+Control+ArrowUp"):
        page.keyboard.press(keys)
    assert page.evaluate("['x','y','w','h'].map((id) => document.getElementById(id).value)") == [
        "127",
        "106",
        "65",
        "38",
    ]
    page.locator("#w").fill("50.5")
    page.locator("#stage").focus()
    page.keyboard.press("Enter")
    assert first_box(process) == [127, 106, 50.5, 38]
    assert page.complaints == []


def test_a_used_address_says_so_and_the_first_page_goes_on(browser, command):
    process, address = command
    first, second = opened(browser, address), browser.new_context().new_page()
    second.goto(address)
    says(second, "used already")
    first.keyboard.press("ArrowRight")
    first.keyboard.press("Enter")
    assert first_box(process) == [128, 96, 64, 48]
