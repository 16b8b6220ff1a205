"""A stand-in for the simulator, and small sets made with it."""

from tests.torchid_bench.withheld.fakes import plant

__all__ = ["plant"]
