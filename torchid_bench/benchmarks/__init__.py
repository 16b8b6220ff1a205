"""Scripts that measure torchid: `python -m torchid_bench.benchmarks.NAME`, on one thread each, which is
asked for before numpy and torch are imported."""

import os

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
