"""Entry point of `edged` and `python -m edged`: the one place where errors become exit codes."""

from __future__ import annotations

import sys

from edged.errors import EdgedError


def main() -> None:
    """Run the command line."""
    from edged.cli import app

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
