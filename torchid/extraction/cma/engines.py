"""The search engines by name."""

from torchid.errors import TorchidError
from torchid.extraction.cma.batched import BatchedCmaEs
from torchid.extraction.cma.pycma import PycmaEngine
from torchid.extraction.cma.search import Engine

ENGINES: dict[str, Engine] = {"batched": BatchedCmaEs(), "cma": PycmaEngine()}


def engine(name: str) -> Engine:
    """The engine of that name: `batched` (ours, all runs at once) or `cma` (pycma, run by run).

    Raises:
        TorchidError: no such engine.
    """
    if name not in ENGINES:
        raise TorchidError("there is no such search engine.", got=name, available=sorted(ENGINES))
    return ENGINES[name]
