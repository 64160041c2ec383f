"""Trackers by name, for the command line: presets, configuration files, folders of results."""

from __future__ import annotations

import dataclasses
import json
import tomllib
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

from ..config import MFCMTConfig
from ..errors import BadConfig
from .errors import DataError
from .peers import PEERS, Peer
from .protocol import PROTOCOLS
from .trackers import Engine, Entry, ResultFolder

PRESETS: dict[str, Callable[[], MFCMTConfig]] = {"default": MFCMTConfig.default, "paper": MFCMTConfig.paper}


def resolve(text: str, results: Path | None = None) -> Entry | ResultFolder:
    """The tracker that ``text`` (``NAME``, ``PATH`` or ``LABEL=NAME``, ``LABEL=PATH``) means.

    A peer whose library is not installed takes part by what another environment left in ``results``.
    Raises DataError for an unknown name and for a configuration that is not valid.
    """
    label, _, what = text.rpartition("=")
    if what in PRESETS:
        return Engine(label or what, PRESETS[what]())
    if what in PEERS:
        peer = Peer(label or what, what)
        if peer.lacks:
            if results is not None and any((results / p / peer.name).is_dir() for p in PROTOCOLS):
                return ResultFolder(peer.name, results / "{protocol}" / peer.name)
            raise DataError(f"{what}: needs {peer.lacks} (make bench-peers sets up an environment with it)")
        return peer
    path = Path(what)
    if path.is_dir() or "{protocol}" in what:
        return ResultFolder(label or path.resolve().name, path)
    if path.is_file():
        return Engine(label or path.stem, read_config(path))
    raise DataError(f"no tracker {what!r}: neither a file, nor a folder, nor one of {', '.join([*PRESETS, *PEERS])}")


def read_config(path: Path) -> MFCMTConfig:
    """A configuration in TOML or JSON: fields of MFCMTConfig, and ``base``, the preset to start from."""
    try:
        text = path.read_text(encoding="utf-8")
        given: dict[str, Any] = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except (OSError, ValueError) as failed:
        raise DataError(f"{path}: {failed}") from None
    base = given.pop("base", "default")
    if base not in PRESETS:
        raise DataError(f"{path}: no preset {base!r}; there is {', '.join(PRESETS)}")
    known = {f.name for f in fields(MFCMTConfig)}
    if unknown := sorted(set(given) - known):
        raise DataError(f"{path}: MFCMTConfig has no {', '.join(unknown)}")
    values = {name: tuple(v) if isinstance(v, list) else v for name, v in given.items()}
    try:
        return dataclasses.replace(PRESETS[base](), **values)
    except BadConfig as bad:
        raise DataError(f"{path}: {bad}") from None
