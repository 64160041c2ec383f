"""The ``mfcmt`` command in this process: what it does is the same, and nothing is imported again."""

from __future__ import annotations

import os
import subprocess
import tempfile
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path

import cv2

from mfcmt_core.cli import main


def run_command(*words: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run ``mfcmt`` with these arguments and return its exit code and what reached both outputs.

    Libraries that write to file descriptors 1 and 2 are heard, too.
    """
    arguments = [str(word) for word in words]
    threads = cv2.getNumThreads()
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        before = os.dup(1), os.dup(2)
        os.dup2(out.fileno(), 1)
        os.dup2(err.fileno(), 2)
        try:
            with redirect_stdout(out), redirect_stderr(err), chdir(cwd or Path.cwd()):
                code = main(arguments)
        except SystemExit as ended:
            code = int(ended.code or 0)
        finally:
            for number, kept in enumerate(before, 1):
                os.dup2(kept, number)
                os.close(kept)
            cv2.setNumThreads(threads)
        said = []
        for file in (out, err):
            file.flush()
            file.seek(0)
            said.append(file.read())
    return subprocess.CompletedProcess(arguments, code, *said)
