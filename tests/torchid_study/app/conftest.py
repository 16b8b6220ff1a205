"""Commands and logs, as the tests of torchid's own commands have them."""

from tests.app.conftest import command, folder

__all__ = ["command", "folder"]
