"""Programs that need a process of their own."""

import os
import subprocess
import sys


def printed_by(code: str, *arguments: str, timeout: float = 300.0, **environment: str) -> str:
    """Run code in a fresh interpreter and return what it prints."""
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        text=True,
        env=os.environ | environment,
        timeout=timeout,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout
