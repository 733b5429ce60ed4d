#!/usr/bin/env python3
"""Simulate days of handshakes with faults, restarts and reloads in virtual time and look for violations.

Run it with the project's Python: `.venv/bin/python tools/soak_handshake.py --hours 24`. The simulation and
the rules that it checks are in `tests/helpers/soak.py`. Exit code 1 if any rule was broken; a seed repeats a
run.
"""

from __future__ import annotations

import argparse
import logging
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from helpers.soak import Soak


def main(hours: float, seed: int, block_hours: float, image_hours: float) -> int:
    """Print what happened, and any violations."""
    logging.disable(logging.CRITICAL)  # thousands of refused and failed commands are simulated
    start_s = time.monotonic()
    book = Soak(seed, block_hours * 3600, image_s=image_hours * 3600).run(hours * 3600)
    print(f"{hours:g} h of handshakes in {time.monotonic() - start_s:.0f} s, seed {seed}")
    for what, count in sorted(book.counts.items()):
        print(f"  {count:9d}  {what}")
    print(f"  {len(book.violations):9d}  violations")
    print(
        f"{book.counts['accepted']:,} commands, {book.counts['starts'] - 1:,} restarts, "
        f"{book.counts['sections reloaded']:,} reloads, {len(book.violations)} violations"
    )
    for violation in book.violations[:20]:
        print(f"             {violation}")
    return 1 if book.violations else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--hours", type=float, default=24.0, help="of virtual time")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--block-hours",
        type=float,
        default=0.5,
        help="of them, with the generated function block, scan by scan",
    )
    parser.add_argument(
        "--image-hours", type=float, default=2.0, help="of them, with a scanner of EtherNet/IP every 50 ms"
    )
    arguments = parser.parse_args()
    sys.exit(main(arguments.hours, arguments.seed, arguments.block_hours, arguments.image_hours))
