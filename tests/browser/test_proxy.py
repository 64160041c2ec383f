"""The page behind a real nginx that has the service under a path of its own."""

from __future__ import annotations

import shutil
from pathlib import Path

from service.load.own import OwnServer, free_port
from tests.conftest import require
from tests.programs import nginx_with, running

from .conftest import Open, loop

pytestmark = loop
SITE = """
server {{
  listen 127.0.0.1:{port};
  location /mfcmt/ {{
    proxy_pass http://127.0.0.1:{behind}/;
    proxy_http_version 1.1;
    proxy_set_header Host $http_host;
    proxy_set_header Upgrade $http_upgrade;
    proxy_set_header Connection "upgrade";
    client_max_body_size 32m;
  }}
}}
"""


async def test_the_page_works_under_a_path_of_a_proxy(open_page: Open, server: OwnServer, tmp_path: Path) -> None:
    require(shutil.which("nginx"), "no nginx")
    port = free_port()
    command = nginx_with(SITE.format(port=port, behind=server.port), tmp_path)
    with running(command, tmp_path, (tmp_path / "pid").exists):
        async with open_page(f"http://127.0.0.1:{port}/mfcmt/") as user:
            await user.follow_sample(20)
            assert await user.status() in ("tracking", "uncertain")
            assert all("/mfcmt/" in url or url.startswith(("blob:", "data:")) for url in user.asked)
            manifest = await (await user.page.context.new_cdp_session(user.page)).send("Page.getAppManifest")
            assert manifest["errors"] == []
