"""What every test below runs under: one BLAS thread, and which may be skipped.

pytest makes the helpers beside this file (naive, snapshots, ...) importable from every test.
"""

import os

# as `edged` itself does: BLAS threads on small matrices only spin; set before anything imports numpy
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

pytest_plugins = ["skips"]
