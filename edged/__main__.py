"""Entry point of `edged` and `python -m edged`: the only place where errors become exit codes."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

if sys.argv[1:2] == ["run"]:
    # Before anything that takes time: a reload requested while the daemon starts waits until `serve` handles
    # it, and would otherwise end the process; for a stop, there is nothing to shut down yet.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    signal.signal(signal.SIGTERM, lambda *_: os._exit(0))

# Matrices here are small: BLAS threads only compete with the vision thread (measured: 7 x slower beside a
# busy core). Must be set before numpy is imported; an operator's own setting has precedence.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from edged.errors import EdgedError, printable


def main() -> None:
    """Run the command line."""
    from edged.cli.main import app

    try:
        _leave_others_code_alone()
        app()
    except EdgedError as error:
        # the text may contain names and values from untrusted files
        sys.stderr.write("\n".join(map(printable, f"edged: {error}".split("\n"))) + "\n")
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:  # `edged registers | head`
        sys.stderr.close()
        sys.exit(141)


def _leave_others_code_alone() -> None:
    """Do not let root use a kernel cache that another user may write: numba runs whatever it finds there."""
    folder = os.environ.get("NUMBA_CACHE_DIR")
    if folder and os.geteuid() == 0:
        from edged.owners import other_owner  # rarely needed

        user = other_owner(Path(folder))
        if user is not None:
            del os.environ["NUMBA_CACHE_DIR"]
            sys.stderr.write(
                f"edged: NUMBA_CACHE_DIR {folder} belongs to user {user}: root runs no code from there\n"
            )


if __name__ == "__main__":
    main()
