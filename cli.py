"""The launcher: `python cli.py ...` does what the installed `torchid ...` does."""

from torchid.app import main

if __name__ == "__main__":  # processes of --jobs import this file
    main()
