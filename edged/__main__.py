"""Entry point of `edged` and `python -m edged`: the one place where errors become exit codes."""

from __future__ import annotations

import os
import sys

# Matrices here are small: BLAS threads only spin against the vision thread (measured: 7 x slower beside a
# busy core). Must be set before numpy is imported; an operator's own setting wins.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from edged.errors import EdgedError


def main() -> None:
    """Run the command line."""
    from edged.cli.main import app

    try:
        app()
    except EdgedError as error:
        sys.stderr.write(f"edged: {error}\n")
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:  # `edged registers | head`
        sys.stderr.close()
        sys.exit(141)


if __name__ == "__main__":
    main()
