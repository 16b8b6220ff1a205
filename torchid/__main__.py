"""`python -m torchid`."""

from torchid.app import main

main()
