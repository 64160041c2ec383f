"""Firefox, driven by its own WebDriver BiDi port: Debian has no geckodriver, and Playwright no plain Firefox."""

from __future__ import annotations

import asyncio
import base64
import itertools
import json
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import websockets

from service.load.own import free_port
from tests.conftest import require

PREFERENCES = {
    "browser.download.alwaysOpenPanel": False,
    "browser.shell.checkDefaultBrowser": False,
    "datareporting.policy.dataSubmissionEnabled": False,
    "dom.disable_beforeunload": True,
    "media.navigator.permission.disabled": True,
    "media.navigator.streams.fake": True,
    "toolkit.telemetry.enabled": False,
    "app.update.enabled": False,
}
START_S = 60
NAMES = ("firefox-esr", "firefox")


class Firefox:
    """One page. ``said`` are the errors of its console."""

    def __init__(self, socket: Any) -> None:
        self._socket, self._ids = socket, itertools.count(1)
        self._answers: dict[int, asyncio.Future[Any]] = {}
        self._reader = asyncio.create_task(self._read())
        self.said: list[str] = []
        self.context = ""

    async def begin(self) -> None:
        """Open a session with a page."""
        await self.call("session.new", capabilities={})
        await self.call("session.subscribe", events=["log.entryAdded"])
        tree = await self.call("browsingContext.getTree")
        self.context = tree["contexts"][0]["context"]

    async def call(self, method: str, **params: Any) -> Any:
        """One command of the protocol."""
        number = next(self._ids)
        self._answers[number] = asyncio.get_running_loop().create_future()
        await self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        try:
            return await asyncio.wait_for(self._answers[number], START_S)
        finally:
            del self._answers[number]

    async def goto(self, url: str) -> None:
        await self.call("browsingContext.navigate", context=self.context, url=url, wait="complete")

    async def evaluate(self, expression: str) -> Any:
        """What a JavaScript expression gives, as JSON carries it."""
        wrapped = f"(async () => JSON.stringify(await ({expression})) ?? 'null')()"
        target = {"context": self.context}
        found = await self.call("script.evaluate", expression=wrapped, target=target, awaitPromise=True)
        assert found["type"] == "success", found["exceptionDetails"]["text"]
        return json.loads(found["result"]["value"])

    async def until(self, condition: str, patience_s: float = 60) -> None:
        """Wait until an expression is true."""
        give_up = asyncio.get_running_loop().time() + patience_s
        while not await self.evaluate(condition):
            assert asyncio.get_running_loop().time() < give_up, (condition, self.said)
            await asyncio.sleep(0.1)

    async def click(self, selector: str) -> None:
        await self.evaluate(f"document.querySelector({selector!r}).click()")

    async def choose_files(self, selector: str, *paths: Path) -> None:
        """Give files to an input."""
        found = await self.call(
            "browsingContext.locateNodes", context=self.context, locator={"type": "css", "value": selector}
        )
        element = {"sharedId": found["nodes"][0]["sharedId"]}
        await self.call("input.setFiles", context=self.context, element=element, files=[str(path) for path in paths])

    async def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag the mouse between two points of the window."""
        steps: list[dict[str, Any]] = [{"type": "pointerMove", "x": round(start[0]), "y": round(start[1])}]
        steps.append({"type": "pointerDown", "button": 0})
        middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
        steps += [{"type": "pointerMove", "x": round(x), "y": round(y), "duration": 50} for x, y in (middle, end)]
        steps.append({"type": "pointerUp", "button": 0})
        mouse = {"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": steps}
        await self.call("input.performActions", context=self.context, actions=[mouse])

    async def screenshot(self, path: Path) -> None:
        shot = await self.call("browsingContext.captureScreenshot", context=self.context)
        path.write_bytes(base64.b64decode(shot["data"]))

    async def close(self) -> None:
        self._reader.cancel()

    async def _read(self) -> None:
        async for text in self._socket:
            message = json.loads(text)
            if message.get("type") == "event":
                entry = message["params"]
                if entry.get("level") in ("error", "warn"):
                    self.said.append(entry.get("text") or "")
            elif (answer := self._answers.get(message.get("id"))) and not answer.done():
                if message["type"] == "error":
                    answer.set_exception(AssertionError(f"{message['error']}: {message['message']}"))
                else:
                    answer.set_result(message["result"])


@asynccontextmanager
async def firefox(profile: Path) -> AsyncIterator[Firefox]:
    """Firefox without a window, with a profile of its own in the folder ``profile``."""
    found = next((path for name in NAMES if (path := shutil.which(name))), None)
    require(found, "no Firefox is installed")
    assert found
    profile.mkdir(parents=True, exist_ok=True)
    lines = [f"user_pref({json.dumps(name)}, {json.dumps(value)});" for name, value in PREFERENCES.items()]
    (profile / "user.js").write_text("\n".join(lines))
    port = free_port()
    flags = [
        "--headless",
        "--no-remote",
        "--width",
        "1280",
        "--height",
        "800",
        "--profile",
        str(profile),
        "--remote-debugging-port",
        str(port),
    ]
    quiet = asyncio.subprocess.DEVNULL
    process = await asyncio.create_subprocess_exec(found, *flags, stdout=quiet, stderr=quiet)
    try:
        async with await _connected(port) as socket:
            page = Firefox(socket)
            await page.begin()
            yield page
            await page.close()
    finally:
        process.terminate()
        await process.wait()


async def _connected(port: int) -> Any:
    for _ in range(START_S * 4):
        try:
            return await websockets.connect(f"ws://127.0.0.1:{port}/session", max_size=None, ping_interval=None)
        except OSError:
            await asyncio.sleep(0.25)
    raise AssertionError("Firefox does not listen")
