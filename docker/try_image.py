"""The image without Docker: its very steps in a clean root, its settings, its user, and what it then does.

    python docker/try_image.py            # about two minutes, about 0.5 GB in a temporary folder
    python docker/try_image.py URL [KEY]  # only the frames, of a service that runs already

``docker/build.sh`` runs with the environment that the Dockerfile sets and nothing else; the tree is sealed; the
service starts as the image's user, who may write a temporary folder and the state folder and nothing more.
Printed: the size, the time from start to ready, and the first frame beside the median. The same again with the
kernels compiled for another CPU. As root the user is the Dockerfile's, else the caller.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from service.client import Client  # noqa: E402
from service.load.clips import sample  # noqa: E402
from service.load.own import free_port  # noqa: E402

PLACE, STATE = "/opt/mfcmt", "/var/lib/mfcmt"
OTHER_CPU = "x86-64-v2"
FRAMES = 100
START_S = 120.0


@dataclass(frozen=True)
class Image:
    """What the Dockerfile says of what runs."""

    env: dict[str, str]
    uid: int
    command: list[str]
    health: list[str]


def read_dockerfile(arch: str = "amd64") -> Image:
    """The environment, the user and the commands of the last stage."""
    text = re.sub(r"\\\n", " ", (ROOT / "docker/Dockerfile").read_text(encoding="utf-8"))
    stages: dict[str, dict[str, str]] = defaultdict(dict)
    stage, said = "", {}
    for line in text.splitlines():
        word, _, rest = line.partition(" ")
        if word == "FROM":
            parent, _, name = re.sub(r"\$\{TARGETARCH:-amd64\}", arch, rest).partition(" AS ")
            stage = name or "last"
            stages[stage] |= stages[parent]
        elif word == "ENV":
            stages[stage] |= dict(pair.split("=", 1) for pair in rest.split())
        else:
            said[word] = rest
    health = said["HEALTHCHECK"].partition("CMD ")[2]
    return Image(stages["last"], int(said["USER"].split(":")[0]), _words(said["CMD"]), _words(health))


def _words(listed: str) -> list[str]:
    return re.findall(r'"([^"]+)"', listed)


class Container:
    """A root of one's own: ``opt`` is the image's /opt/mfcmt; ``tmp`` and ``state`` can be written."""

    def __init__(self, image: Image, root: Path) -> None:
        self.image, self._root = image, root
        self.opt, self.tmp, self.state = root / "opt", root / "tmp", root / "state"
        self._as = {"user": image.uid, "group": image.uid, "extra_groups": []} if os.getuid() == 0 else {}
        root.chmod(0o755)
        for folder in (self.tmp, self.state):
            folder.mkdir()
            if self._as:
                os.chown(folder, image.uid, image.uid)

    def env(self, **changes: str) -> dict[str, str]:
        """The image's environment, in this place."""
        told = {name: value.replace(PLACE, str(self.opt)) for name, value in self.image.env.items()}
        told["PATH"] = told["PATH"].replace("$PATH", "/usr/local/bin:/usr/bin:/bin")
        for name in ("MFCMT_STATE_DIR", "XDG_CACHE_HOME"):
            told[name] = told[name].replace(STATE, str(self.state))
        return told | {"HOME": "/nonexistent", "TMPDIR": str(self.tmp)} | changes

    def build(self, *also: str) -> None:
        """docker/build.sh, and the kernels for ``also`` other CPUs; then nobody writes there any more."""
        build_env = self.env(TMPDIR=tempfile.gettempdir(), PYTHON=_python_for_all()) | _pip_settings()
        subprocess.run([ROOT / "docker/build.sh", self.opt], env=build_env, check=True)
        for cpu in also:
            subprocess.run([self.opt / "bin/mfcmt", "warmup"], env=build_env | {"NUMBA_CPU_NAME": cpu}, check=True)
        subprocess.run(["chmod", "-R", "a-w,a+rX", self.opt], check=True)

    def remove(self) -> None:
        """All of it."""
        subprocess.run(["chmod", "-R", "u+w", self._root], check=True)
        shutil.rmtree(self._root)

    def run(self, command: list[str], **changes: str) -> subprocess.CompletedProcess[str]:
        """A command of the image, to its end."""
        env = self.env(**changes)
        words = [str(self.opt / "bin" / command[0]), *command[1:]]
        return subprocess.run(
            words, env=env, cwd=self.state, capture_output=True, text=True, timeout=600, check=False, **self._as
        )

    @contextmanager
    def serving(self, **changes: str) -> Iterator[Served]:
        """The image's command, once it is ready."""
        port = free_port()
        changes = {"MFCMT_PORT": str(port), "MFCMT_HOST": "127.0.0.1"} | changes
        log_path = self.tmp.parent / "log"
        begun = time.monotonic()
        with log_path.open("wb") as log:
            process = subprocess.Popen(
                [self.opt / "bin" / self.image.command[0], *self.image.command[1:]],
                env=self.env(**changes),
                cwd=self.state,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                **self._as,
            )
        try:
            served = Served(f"http://127.0.0.1:{port}", process, log_path)
            served.wait_until_ready()
            served.ready_s = time.monotonic() - begun
            yield served
            process.send_signal(signal.SIGTERM)
            process.wait(60)
        finally:
            process.kill()
            process.wait()


def _python_for_all() -> str:
    """This interpreter, or the system's where another user could not reach this one."""
    mine = Path(sys.executable).resolve()
    return str(mine) if all(part.stat().st_mode & 1 for part in mine.parents) else "/usr/bin/python3"


def _pip_settings() -> dict[str, str]:
    """Which pip it is, and which index it asks, is the builder's business."""
    own = {name: value for name, value in os.environ.items() if name == "HOME" or name.startswith("PIP_")}
    return own | {"PIP": f"{sys.executable} -m pip"}


@dataclass
class Served:
    """A running service."""

    url: str
    process: subprocess.Popen[bytes]
    log_path: Path
    ready_s: float = 0.0

    @property
    def log(self) -> str:
        return self.log_path.read_text(encoding="utf-8", errors="replace")

    def wait_until_ready(self) -> None:
        """Asks until /readyz says 200."""
        give_up = time.monotonic() + START_S
        while time.monotonic() < give_up:
            if self.process.poll() is not None:
                raise SystemExit(f"the service ended with {self.process.returncode}\n{self.log}")
            try:
                with urllib.request.urlopen(f"{self.url}/readyz", timeout=2):
                    return
            except (urllib.error.URLError, OSError):
                time.sleep(0.01)
        raise SystemExit(f"not ready after {START_S:g} s\n{self.log}")


def first_frames(url: str, count: int = FRAMES, key: str | None = None) -> tuple[float, list[float]]:
    """Milliseconds of making a session, and of each of its frames, as a client sees them."""
    clip = sample(30)
    took = []
    with Client(url, key=key) as client:
        begun = time.perf_counter()
        session = client.create(clip.frames[0], box=clip.box)
        made = time.perf_counter() - begun
        for index in range(1, count + 1):
            begun = time.perf_counter()
            session.track(clip.frames[index % len(clip.frames)])
            took.append((time.perf_counter() - begun) * 1e3)
        session.close()
    return made * 1e3, took


def sizes(folder: Path) -> tuple[float, list[tuple[str, float]]]:
    """MB on disk, of all and of the largest packages."""
    parts: defaultdict[str, float] = defaultdict(float)
    for path in folder.rglob("*"):
        if path.is_file() and not path.is_symlink():
            inside = path.relative_to(folder).parts
            at = inside.index("site-packages") + 1 if "site-packages" in inside else 0
            parts[inside[at].removesuffix(".libs")] += path.stat().st_size / 1e6
    return sum(parts.values()), sorted(parts.items(), key=lambda part: -part[1])


def told(url: str, key: str | None = None) -> str:
    """What a client sees of the first frames, in words."""
    made, took = first_frames(url, key=key)
    middle = statistics.median(took)
    return f"session {made:.1f} ms, first frame {took[0]:.1f} ms, median of {len(took)} {middle:.1f} ms"


def main() -> None:
    """Build, seal, serve, measure, remove; or measure what runs at the URL given."""
    if len(sys.argv) > 1:
        print(told(*sys.argv[1:3]))
        return
    container = Container(read_dockerfile(), Path(tempfile.mkdtemp(prefix="mfcmt-image-")))
    try:
        begun = time.monotonic()
        container.build(OTHER_CPU)
        total, parts = sizes(container.opt)
        print(f"built in {time.monotonic() - begun:.0f} s as {container.opt}")
        print(f"size {total:.0f} MB: " + ", ".join(f"{name} {size:.0f}" for name, size in parts[:8]))
        for cpu in (container.image.env["NUMBA_CPU_NAME"], OTHER_CPU):
            print(container.run(["mfcmt", "warmup"], NUMBA_CPU_NAME=cpu).stdout.strip())
            with container.serving(NUMBA_CPU_NAME=cpu) as served:
                print(f"{cpu}: ready {served.ready_s:.2f} s after the start; {told(served.url)}")
    finally:
        container.remove()


if __name__ == "__main__":
    main()
