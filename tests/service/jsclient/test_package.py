"""The client as a package: its types, its contents, what it vendors."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tests.conftest import require
from tests.docs import typescript

from .conftest import HERE, PACKAGE

VENDOR = PACKAGE / "vendor"


def output(*call: str, cwd: Path = HERE) -> str:
    done = subprocess.run(call, cwd=cwd, capture_output=True, text=True, timeout=180, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_types_fit_what_people_write(node: str) -> None:
    """Strict, with the checks of the declaration file itself."""
    assert output(node, "node_modules/typescript/bin/tsc", "-p", ".") == ""


def test_types_name_what_is_there(node: str) -> None:
    names = json.loads(output(node, "surface.mjs"))
    assert names["declared"] == names["present"]


def test_the_npm_package_is_complete_and_can_be_imported(node: str, tmp_path: Path) -> None:
    """What would be published is complete and has nothing else in it; it can be imported from there."""
    npm = shutil.which("npm")
    require(npm is not None, "no npm")
    assert npm is not None
    packed: dict[str, Any] = json.loads(output(npm, "pack", "--dry-run", "--json", "--silent", cwd=PACKAGE))[0]
    listed = {file["path"] for file in packed["files"]}
    there = {str(path.relative_to(PACKAGE)) for path in PACKAGE.rglob("*") if path.is_file()}
    assert listed == there
    manifest = json.loads((PACKAGE / "package.json").read_text())
    assert not any("ependencies" in field for field in manifest)
    assert manifest["version"] == version("mfcmt")
    assert f'VERSION = "{manifest["version"]}"' in (PACKAGE / "mfcmt.js").read_text()
    for field in (manifest["main"], manifest["types"], *manifest["exports"]["."].values()):
        assert field.removeprefix("./") in listed
    installed = tmp_path / "node_modules" / "mfcmt-client"
    shutil.copytree(PACKAGE, installed)
    (tmp_path / "main.mjs").write_text(
        'import * as all from "mfcmt-client"; console.log(Object.keys(all).sort().join());'
    )
    expected = "Client,MFCMTError,Session,Stream,VERSION,encodeFrame,fittedSize,regionsByDefault"
    assert output(node, "main.mjs", cwd=tmp_path).strip() == expected


def test_vendored_files_are_those_of_the_package() -> None:
    digests = dict(
        reversed(line.split()) for line in re.findall(r"^[0-9a-f]{64} .*$", (VENDOR / "README.md").read_text(), re.M)
    )
    there = {str(path.relative_to(VENDOR)) for path in (VENDOR / "msgpack").rglob("*") if path.is_file()}
    assert set(digests) == there
    for name, digest in digests.items():
        assert hashlib.sha256((VENDOR / name).read_bytes()).hexdigest() == digest
    assert "msgpack/LICENSE" in digests


def test_no_module_is_long_or_reaches_outside() -> None:
    """Imports stay in the folder, so that it can be served from anywhere under `script-src 'self'`."""
    for path in [PACKAGE / "mfcmt.js", *(PACKAGE / "lib").glob("*.js")]:
        text = path.read_text()
        for wanted in re.findall(r'(?:from|import\(|new URL\()\s*"([^"]+)"', text):
            assert (path.parent / wanted).resolve().is_relative_to(PACKAGE)
        assert not re.search(r"\beval\(|new Function|https?://(?!127\.0\.0\.1)", text)


def test_the_types_are_those_of_the_protocol() -> None:
    """`make guide` writes them."""
    text = typescript.DECLARATIONS.read_text()
    assert typescript.fresh(text) == text
    assert "export interface Result {" in typescript.generated()
