"""Programs that tests run beside the service, such as proxies."""

from __future__ import annotations

import getpass
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

START_S = 60.0
NGINX = """
user {user};
pid {folder}/pid; error_log {folder}/log; daemon off;
events {{}}
http {{
  access_log off; client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy;
  fastcgi_temp_path {folder}/f; uwsgi_temp_path {folder}/u; scgi_temp_path {folder}/s;
  include {folder}/site.conf;
}}
"""


@contextmanager
def running(command: Sequence[str], folder: Path, ready: Callable[[], bool]) -> Iterator[None]:
    """Run a program until the block ends; ``ready`` says whether it serves. What it prints is in ``folder``."""
    with (folder / "out").open("wb") as out:
        process = subprocess.Popen(command, stdout=out, stderr=out)
    try:
        give_up = time.monotonic() + START_S
        while not ready():
            assert process.poll() is None, (folder / "out").read_text()
            assert time.monotonic() < give_up, (folder / "out").read_text()
            time.sleep(0.05)
        yield
    finally:
        process.terminate()
        process.wait(20)


def nginx_with(site: str, folder: Path) -> list[str]:
    """Return the command of an nginx that keeps all its files in ``folder``; ``site`` is the text of its servers."""
    (folder / "site.conf").write_text(site)
    (folder / "nginx.conf").write_text(NGINX.format(user=getpass.getuser(), folder=folder))
    return ["nginx", "-e", f"{folder}/log", "-c", f"{folder}/nginx.conf"]
