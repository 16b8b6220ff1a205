"""A stand-in for the simulator, and small sets made with it."""

from tests.withheld.fakes import plant

__all__ = ["plant"]
