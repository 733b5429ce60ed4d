"""This file makes the helpers beside it (naive, snapshots, ...) importable from every test below."""

import os

# as `edged` itself does: BLAS threads on small matrices only spin; set before anything imports numpy
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
