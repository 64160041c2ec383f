"""Compile to bytecode the modules under FOLDER that the service imports, and no others: they are half of all.

usage: bytecode.py FOLDER
"""

import importlib
import py_compile
import sys
from pathlib import Path

MODULES = (
    "mfcmt_core.cli.warmup",
    "service.app",
    "service.cli.health",
    "service.cli.serve",
    "service.lanes.preload",
    "service.lanes.worker",
    "service.observability.tracing",
)


def main() -> None:
    """Write the files beside the sources."""
    folder = Path(sys.argv[1]).resolve()
    for name in MODULES:
        importlib.import_module(name)
    for module in list(sys.modules.values()):
        source = Path(getattr(module, "__file__", None) or "")
        if source.suffix == ".py" and folder in source.parents:
            # Good whatever a copy does to times; what lies in a read-only tree is not checked again.
            py_compile.compile(str(source), invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH)


if __name__ == "__main__":
    main()
