"""Compile to bytecode the modules under FOLDER that the service imports, and no others: they are half of all.

usage: bytecode.py FOLDER
"""

import py_compile
import sys
from pathlib import Path

import mfcmt_core.cli.warmup
import service.app
import service.cli.health
import service.cli.serve
import service.lanes.preload
import service.lanes.worker
import service.observability.tracing  # noqa: F401


def main() -> None:
    """Write the files beside the sources."""
    folder = Path(sys.argv[1]).resolve()
    for module in list(sys.modules.values()):
        source = Path(getattr(module, "__file__", None) or "")
        if source.suffix == ".py" and folder in source.parents:
            # Good whatever a copy does to times; what lies in a read-only tree is not checked again.
            py_compile.compile(str(source), invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH)


if __name__ == "__main__":
    main()
