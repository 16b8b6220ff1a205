"""The launcher: `python cli.py ...` does what the installed `torchid ...` does."""

from torchid.app import main

main()
