"""The client as a package: its types, its contents, the archive that the service serves."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tarfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

from service.api import web
from tests.conftest import require
from tests.docs import typescript

from .conftest import HERE, PACKAGE


def output(*call: str, cwd: Path = HERE) -> str:
    done = subprocess.run(call, cwd=cwd, capture_output=True, text=True, timeout=180, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


DOM = ["dom", "dom.iterable"]
# Versions of TypeScript, the oldest and the newest that are promised among them, by what is checked with each.
EVERY = ("typescript-5.0", "typescript-5.4", "typescript", "typescript-7.0")
CHECKED = [
    *(("bare.ts", version, [], []) for version in EVERY),
    *(("page.ts", version, DOM, []) for version in EVERY),
    *((name, version, [], ["node"]) for name in ("bare.ts",) for version in EVERY[2:]),
    *(("app.tsx", version, DOM, []) for version in EVERY[2:]),
]


@pytest.mark.parametrize(("name", "version", "libraries", "types"), CHECKED)
def test_types_fit_what_people_write(
    node: str, tmp_path: Path, name: str, version: str, libraries: list[str], types: list[str]
) -> None:
    """Strict, with the checks of the declaration files themselves; a project without the DOM gets none."""
    modules = tmp_path / "node_modules"
    (modules / "@mfcmt").mkdir(parents=True)
    shutil.copytree(PACKAGE, modules / "@mfcmt" / "client")
    for there in (HERE / "node_modules").iterdir():
        (modules / there.name).symlink_to(there)
    shutil.copy(HERE / "types" / name, tmp_path)
    (tmp_path / "package.json").write_text('{"type": "module"}')
    options = {
        "target": "es2022",
        "lib": ["es2022", *libraries],
        "types": types,
        "module": "nodenext",
        "moduleResolution": "nodenext",
        **({"jsx": "react-jsx"} if name.endswith(".tsx") else {}),
        "strict": True,
        "noUncheckedIndexedAccess": True,
        "exactOptionalPropertyTypes": True,
        "noEmit": True,
        "skipLibCheck": False,
    }
    (tmp_path / "tsconfig.json").write_text(json.dumps({"compilerOptions": options, "files": [name]}))
    assert output(node, f"node_modules/{version}/bin/tsc", "-p", ".", cwd=tmp_path) == ""


def test_types_name_what_is_there(node: str) -> None:
    names = json.loads(output(node, "surface.mjs"))
    assert names["declared"] == names["present"]


def packed(npm: str) -> set[str]:
    """The files that npm packs."""
    told: dict[str, Any] = json.loads(output(npm, "pack", "--dry-run", "--json", "--silent", cwd=PACKAGE))
    (one,) = told if isinstance(told, list) else told.values()
    return {file["path"] for file in one["files"]}


@pytest.fixture
def npm() -> str:
    found = shutil.which("npm")
    require(found is not None, "no npm")
    assert found is not None
    return found


def test_the_npm_package_is_complete(npm: str) -> None:
    """What would be published is complete and has nothing else in it; it needs no other package."""
    listed = packed(npm)
    assert listed == {str(path.relative_to(PACKAGE)) for path in PACKAGE.rglob("*") if path.is_file()}
    manifest = json.loads((PACKAGE / "package.json").read_text())
    assert manifest["name"] == "@mfcmt/client"
    assert "dependencies" not in manifest
    assert all(manifest["peerDependenciesMeta"][name]["optional"] for name in manifest["peerDependencies"])
    assert manifest["version"] == version("mfcmt")
    assert f'VERSION = "{manifest["version"]}"' in (PACKAGE / "lib" / "exports.js").read_text()
    named = [
        entry for way in manifest["exports"].values() for entry in (way.values() if isinstance(way, dict) else [way])
    ]
    for field in (manifest["main"], manifest["types"], manifest["react-native"], *named):
        assert field.removeprefix("./") in listed


def test_the_service_serves_what_npm_packs(npm: str, node: str, tmp_path: Path) -> None:
    """The very files, in an archive that npm installs and Node imports; React Native's entry has the same names."""
    archive = tmp_path / web.PACKAGE
    archive.write_bytes(web.load()[web.PACKAGE].body)
    with tarfile.open(archive) as tar:
        bodies = {one.name.removeprefix("package/"): tar.extractfile(one).read() for one in tar}  # type: ignore[union-attr]
    assert set(bodies) == packed(npm)
    assert all(body == (PACKAGE / name).read_bytes() for name, body in bodies.items())
    assert web.load()[web.PACKAGE].body == archive.read_bytes()
    app = tmp_path / "app"
    app.mkdir()
    (app / "package.json").write_text('{"private": true, "type": "module"}')
    output(npm, "install", "--offline", "--no-audit", "--no-fund", "--omit=peer", str(archive), cwd=app)
    told = "console.log(Object.keys(all).sort().join());"
    (app / "main.mjs").write_text(f'import * as all from "@mfcmt/client"; {told}')
    expected = "Client,MFCMTError,Session,Stream,VERSION,encodeFrame,fittedSize,regionsByDefault"
    assert output(node, "main.mjs", cwd=app).strip() == expected
    assert output(node, "--conditions=react-native", "main.mjs", cwd=app).strip() == expected


def test_no_module_reaches_outside() -> None:
    """Imports stay in the folder, so that it can be served from anywhere under `script-src 'self'`."""
    for path in [*PACKAGE.glob("*.js"), *(PACKAGE / "lib").glob("*.js")]:
        text = path.read_text()
        if path.name == "react.js":
            text = text.replace('from "react"', "")
        for wanted in re.findall(r'(?:from|import\(|new URL\()\s*"([^"]+)"', text):
            assert (path.parent / wanted).resolve().is_relative_to(PACKAGE)
        assert not re.search(r"\beval\(|new Function|https?://(?!127\.0\.0\.1|www\.w3\.org)", text)


def test_the_types_are_those_of_the_protocol() -> None:
    """`make guide` writes them."""
    text = typescript.DECLARATIONS.read_text()
    assert typescript.fresh(text) == text
    assert "export interface Result {" in typescript.generated()
